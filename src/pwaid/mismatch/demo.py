"""The packaged case of `pwaid demo`."""

from __future__ import annotations

from pathlib import Path

__all__ = ["demo_case_path"]


def demo_case_path() -> Path:
    """Folder of the packaged demo case: case.toml, simulator.py and recordings with a concealed effect."""
    return Path(__file__).parent / "demo_case"
