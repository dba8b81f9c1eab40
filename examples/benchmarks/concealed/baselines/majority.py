"""Baseline: always the most common effect. The catalogue is drawn evenly, so any fixed id does; Coulomb
friction."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from concealed.baselines.common import main, report

MAJORITY = ("coulomb_friction", "actuator_saturation")


def diagnose(folder, without):
    """The first of the common ids that is still in the catalogue."""
    allowed = [e for e in MAJORITY if e not in without]
    return report("named", [{"id": allowed[0], "parameters": {}}]) if allowed else report("parameters_only")


if __name__ == "__main__":
    main(diagnose, __doc__)
