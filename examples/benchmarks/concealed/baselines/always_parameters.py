"""Baseline: always "only parameters are wrong". Right on every case without an effect, useless on the
others."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from concealed.baselines.common import main, report


def diagnose(folder, without):
    """The same verdict whatever the recordings say."""
    return report("parameters_only")


if __name__ == "__main__":
    main(diagnose, __doc__)
