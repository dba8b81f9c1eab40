"""Every example runs in its quick version and prints figures that hold."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
NEEDS_DATA = {
    "emps_friction_map": "emps",
    "pick_place_pwarx": "pick_place",
    "cascaded_tanks_narx": "cascaded_tanks",
    "explain_emps": "emps",
    "explain_tanks": "cascaded_tanks",
    "explain_hair_dryer": "hair_dryer",
}

# What must hold of each script's RESULT line (quick versions; the full sizes are in docs/).
HOLDS = {
    "pyramid_path": lambda r: r["rmse_truth_htv"] < 0.0195 and 3e-3 < r["best_lambda_ratio"] < 2e-2,
    "emps_friction_map": lambda r: r["heldout_force_error_percent"] < 4.1 < 14 < r["viscous_force_error_percent"] < 18,
    "pick_place_pwarx": lambda r: r["one_step_fit_percent"] > 99 and r["free_run_fit_percent"] > 60,
    "cascaded_tanks_narx": lambda r: r["free_run_rmse_v"] < 0.6,
    "maruta2011_dc_motor": lambda r: r["rmse_pwa"] < 0.2 * r["rmse_linear"],
    "maruta2014_rotary_actuator": lambda r: r["explained_percent"] > r["linear_explained_percent"] + 10,
    "vizer2014_flexible_arm": lambda r: r["local_bft_min_percent"] > 99 and min(r["coriolis_bft_percent"]) > 99,
    "backlash_identification": lambda r: max(
        r["half_gap_error_percent"], r["stiffness_error_percent"], r["damping_error_percent"]
    ) < 3.0,
    "explain_emps": lambda r: r["effects"] == ["coulomb_friction"] and r["error_repaired"] < 8 < r["error_refitted"],
    "explain_tanks": lambda r: "overflow" in r["effects"] and r["error_repaired"] <= 0.36 < r["error_refitted"],
    "explain_hair_dryer": lambda r: r["verdict"] in ("agreement", "parameters_only") and not r["effects"],
    "explain_flexible_arm": lambda r: (
        r["effects"] == ["coriolis_torque"] and abs(r["laws"][0][2]["coefficient"] - 1) < 0.05
        and r["error_repaired"] < 0.1 * r["error_refitted"]),
    "explain_rotary_actuator": lambda r: all(
        s["verdict"] == "named" and {"stribeck_friction", "coulomb_friction"} & set(s["effects"])
        and s["friction_error_percent"] < 10 and s["error_repaired"] < 0.15 * s["error_refitted"]
        for s in (r, r["dc_motor"])),
    "explain_backlash": lambda r: r["effects"] == ["backlash"] and r["half_gap_error_percent"] < 3,
    "explain_bench": lambda r: (
        r["verdict"] == "named" and set(r["channels"]) == {"state:omega_M"} and r["overshoot_error_mrad"] < 1
        and r["impact_error_percent"] < 3 and r["limit_cycle_right"]),
}


def run(name: str, *options: str) -> dict:
    missing = NEEDS_DATA.get(name)
    root = os.environ.get("PWAID_DATA")
    if missing and (not root or not Path(root, missing).exists()):
        pytest.skip(f"{Path(root or 'PWAID_DATA', missing)} is missing; set PWAID_DATA to the folder of recordings")
    process = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py"), "--quick", *options],
        capture_output=True,
        text=True,
        timeout=570,
        check=False,
    )
    assert process.returncode == 0, process.stderr[-2000:]
    last = process.stdout.strip().splitlines()[-1]
    assert last.startswith("RESULT "), last
    return json.loads(last.removeprefix("RESULT "))


EXPLAINED_AGAIN = {"explain_hair_dryer", "explain_tanks"}  # by the command line, with the same answer


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(HOLDS))
def test_example(name, tmp_path):
    again = name in EXPLAINED_AGAIN
    result = run(name, *(["--save", str(tmp_path)] if again else []))
    assert HOLDS[name](result), result
    if again:
        the_command_line_agrees(result, tmp_path)


def the_command_line_agrees(result: dict, folder: Path) -> None:
    """`pwaid explain` with one thread, on the case that an example saved, comes to its answer and figures with two."""
    command = [sys.executable, "-m", "pwaid", "explain", result["case"], "-o", str(folder / "again"), "--jobs", "1"]
    process = subprocess.run(command, capture_output=True, text=True, timeout=570, check=False)
    assert process.returncode == 0, process.stderr[-2000:]
    first, again = (json.loads((folder / name / "report.json").read_text(encoding="utf-8"))
                    for name in ("explained", "again"))
    assert again["verdict"] == result["verdict"]
    assert [e["id"] for e in again["effects"]] == result["effects"]
    assert again["fit"] == first["fit"]


def test_every_example_is_tested_here_or_in_its_own_file():
    others = (p for p in Path(__file__).parent.rglob("test_*.py") if p != Path(__file__))
    elsewhere = "\n".join(p.read_text(encoding="utf-8") for p in others)
    names = [p.stem for p in EXAMPLES.glob("*.py") if not p.stem.startswith(("_", "make_"))]
    untested = [n for n in names if n not in HOLDS and n not in elsewhere]
    assert not untested, f"examples without a test: {untested}"
