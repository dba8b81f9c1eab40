"""Real recordings: the examples say which file is missing, and a PWARX model beats the linear one on hardware."""

from __future__ import annotations

import os
import runpy
from pathlib import Path

import numpy as np
import pytest

from pwaid.dynamics.narx import NARX
from pwaid.recording import Recording

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize(
    ("script", "file"),
    [
        ("emps_friction_map", "emps/DATA_EMPS.mat"),
        ("pick_place_pwarx", "pick_place/headdata_1v6.mat"),
        ("cascaded_tanks_narx", "cascaded_tanks/dataBenchmark.mat"),
    ],
)
@pytest.mark.parametrize("folder", [None, "nowhere"])
def test_an_example_without_its_recording_ends_with_one_clear_line(script, file, folder, monkeypatch):
    monkeypatch.delenv("PWAID_DATA", raising=False)
    if folder:
        monkeypatch.setenv("PWAID_DATA", folder)
    load = runpy.run_path(str(EXAMPLES / f"{script}.py"), run_name="script")["load"]
    with pytest.raises(SystemExit, match=f"{file} is missing: set PWAID_DATA") as caught:
        load()
    assert "\n" not in str(caught.value)


def test_pick_and_place_free_run_beats_the_linear_model():
    file = "pick_place/headdata_1v6.mat"
    folder = os.environ.get("PWAID_DATA")
    if not folder or not (Path(folder) / file).is_file():
        pytest.skip(f"{file} is missing: PWAID_DATA is not set to the folder that holds it")
    whole = Recording.from_mat(Path(folder) / file, ["u"], ["y"]).decimate(10)
    train, choose, test = whole[:3750], whole[3748:5000], whole[4998:]
    narx = NARX(2, 1, True, nonlinear=[[1, 0, 0, 0], [1, -1, 0, 0]])
    problem = narx.problem(train, n_points=100, rng=0)
    path = problem.path(problem.lambda_max() * np.logspace(-1, -3, 3), choose, tol=1e-3)
    fit = path.best.simulate(test).fit_percent(test.outputs)
    assert fit > problem.linear().simulate(test).fit_percent(test.outputs) + 5
