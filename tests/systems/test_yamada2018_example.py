"""The example that redraws Figs. 3-8 runs, and its figures are those of the project's targets."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import pwaid

SCRIPT = Path(__file__).parents[2] / "examples" / "yamada2018_backlash.py"


def test_example_result(tmp_path):
    source = str(Path(pwaid.__file__).parents[1])
    done = subprocess.run([sys.executable, str(SCRIPT), "--quick", "--save", str(tmp_path)],
                          cwd=tmp_path, env={**os.environ, "PYTHONPATH": source},
                          capture_output=True, text=True)  # fmt: skip
    assert done.returncode == 0, done.stderr
    last = done.stdout.strip().splitlines()[-1]
    assert last.startswith("RESULT ")
    result = json.loads(last.removeprefix("RESULT "))
    expected = {
        "K_P": (10.2813, 1e-4), "K_D": (0.054709, 1e-5), "tau_D_ms": (5.8281, 1e-4),
        "reduction_percent": (42.7, 0.1), "reduction_motor_damping_percent": (44.1, 0.1),
        "overshoot_none_mrad": (16.7, 0.1), "overshoot_linear_mrad": (69.1, 0.1),
        "overshoot_switched_mrad": (7.0, 0.1),
        "limit_cycle_mrad": (8.67, 0.0867), "limit_cycle_ms": (102.4, 0.2),
    }  # fmt: skip
    assert set(result) == set(expected)
    for key, (value, tolerance) in expected.items():
        assert result[key] == pytest.approx(value, abs=tolerance), key
    assert {p.name for p in tmp_path.glob("*.png")} == {"yamada_step.png", "yamada_disturbance.png",
                                                        "yamada_phase.png"}
