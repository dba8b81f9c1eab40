"""What the example scripts share: their options and their last line."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path


def options(description: str, **extra):
    """`--quick` and `--save DIR`, and what the script adds as name=(default, help)."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="a smaller run of under a minute")
    parser.add_argument("--save", type=Path, metavar="DIR", help="write figures here")
    for name, (default, text) in extra.items():
        parser.add_argument(f"--{name}", default=default, type=type(default), help=text)
    chosen = parser.parse_args()
    if chosen.save:
        chosen.save.mkdir(parents=True, exist_ok=True)
    return chosen


def recordings(*names: str) -> Path:
    """A file below the folder that PWAID_DATA names, or a clear end."""
    root = os.environ.get("PWAID_DATA")
    path = Path(root or "PWAID_DATA", *names)
    if not root or not path.exists():
        print(f"{path} is missing: set PWAID_DATA to the folder of recordings", file=sys.stderr)
        raise SystemExit(2)
    return path


def result(**figures) -> None:
    """The last line: RESULT and the figures as JSON."""
    print("RESULT " + json.dumps(figures))
