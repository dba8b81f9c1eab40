"""The whole chain on recordings whose answer is known."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from tests_support import TRUE, oscillator, record

from pwaid.errors import InputError
from pwaid.mismatch import effects_table, explain, explain_case
from pwaid.mismatch.case import load_case, write_case
from pwaid.mismatch.effects.registry import effect_by_id

SIMULATOR = '''"""Mass, spring, damper."""
import control
import numpy as np


def update(t, x, u, params):
    return np.array([x[1], (u[0] - params["b"] * x[1] - params["k"] * x[0]) / params["m"]])


def output(t, x, u, params):
    return np.array([x[0]])


def build():
    return control.nlsys(update, output, inputs=["F"], outputs=["x"], states=["x", "v"],
                         params={"m": 1.1, "b": 0.5, "k": 3.2})
'''
FREE = ["m", "b", "k"]


def case(folder, recordings, **more):
    *train, test = recordings
    return write_case(folder, SIMULATOR, {r.name: r for r in train}, {test.name: test}, FREE, **more)


def test_dry_friction_is_named_and_written_down(tmp_path, friction_recordings):
    folder = case(tmp_path / "case", friction_recordings)
    report = explain_case(folder, tmp_path / "out", without=("position_ripple",))
    assert report.verdict == "named"
    assert [e["id"] for e in report.effects] == ["coulomb_friction"]
    level = report.effects[0]["parameters"]["level"]
    assert level["unit"] == "N"
    assert level["value"] == pytest.approx(0.4, rel=0.03)
    for name, value in TRUE.items():
        assert report.content["parameters"][name]["refitted"] == pytest.approx(value, rel=0.03)
    content = json.loads((tmp_path / "out" / "report.json").read_text())
    assert content["schema"] == "pwaid.mismatch/1"
    stages = content["fit"]["r3.csv"]["x"]
    assert stages["repaired"]["rmse"] < 0.1 * stages["refitted"]["rmse"]
    assert "coulomb friction" in report.summary
    assert (tmp_path / "out" / "report.html").read_text().count("data:image/png;base64,") >= 1
    _repaired_file_runs(tmp_path, report, friction_recordings[-1])


def _repaired_file_runs(tmp_path, report, recording):
    """repaired_simulator.py runs without pwaid and reproduces the fitted simulation."""
    np.savez(tmp_path / "data.npz", t=recording.time, u=recording.inputs, x0=report.best.test.X0[0])
    code = ("import sys, numpy as np; sys.modules['pwaid'] = None; sys.path.insert(0, 'out'); "
            "import repaired_simulator as r; d = np.load('data.npz'); "
            "np.save('y.npy', r.simulate(d['t'], d['u'], d['x0']))")
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)
    got = np.load(tmp_path / "y.npy")
    np.testing.assert_allclose(got, report.best.test.Y, atol=1e-6)
    system = report.simulator
    assert system.ninputs == 1 and system.noutputs == 1 and system.dt == recording.sample_time


def test_parameter_errors_alone_are_called_that(clean_recordings):
    report = explain(oscillator(), clean_recordings[:2], clean_recordings[2:], FREE,
                     without=("position_ripple",))
    assert report.verdict == "parameters_only"
    assert report.effects == []


def test_a_right_simulator_agrees(clean_recordings):
    report = explain(oscillator(**TRUE), clean_recordings[:2], clean_recordings[2:], FREE,
                     without=("position_ripple",))
    assert report.verdict == "agreement"


def test_recordings_of_one_name_in_several_folders_are_told_apart(tmp_path, clean_recordings):
    names = [f"run{k}/log.csv" for k in range(4)]
    for name in names:
        (tmp_path / name).parent.mkdir()
    recordings = dict(zip(names, [*clean_recordings, record(9)], strict=True))
    write_case(tmp_path, SIMULATOR, {n: recordings[n] for n in names[:2]}, {n: recordings[n] for n in names[2:]}, FREE,
               extra='repeats = [["run0/log.csv", "run1/log.csv"]]')
    found = load_case(tmp_path)
    assert [r.name for r in (*found.train, *found.test)] == names
    assert found.repeats == (("run0/log.csv", "run1/log.csv"),)


def test_every_id_of_the_contract_is_in_the_catalogue():
    ids = {row["id"] for row in effects_table()}
    wanted = [
        "coulomb_friction", "asymmetric_coulomb_friction", "stribeck_friction", "presliding_friction",
        "load_dependent_friction", "viscous_friction", "asymmetric_viscous_friction", "quadratic_drag",
        "linear_stiffness", "cubic_stiffness", "quadratic_stiffness", "gravity_torque", "position_ripple",
        "end_stop", "hysteretic_spring", "backlash", "compliance", "missing_inertia", "coriolis_torque",
        "actuator_saturation", "actuator_rate_limit", "actuator_deadzone", "input_play",
        "actuator_gain_asymmetry", "constant_load", "actuator_lag", "input_delay", "sensor_saturation",
        "sensor_rectification", "sensor_quantization", "sensor_offset", "sensor_lag", "sensor_nonlinearity",
        "square_root_outflow", "head_offset", "leakage", "overflow", "radiation", "second_thermal_mass",
        "periodic_disturbance", "sensor_drift", "parameter_drift",
    ]
    assert set(wanted) <= ids


@pytest.mark.parametrize(("change", "message"), [
    (lambda f: (f / "train.csv").unlink(), "does not exist"),
    (lambda f: _edit(f, 'x = "m"', 'x = "furlong"'), "unknown unit"),
    (lambda f: _edit(f, 'test = ["test.csv"]', 'test = ["train.csv"]'), "listed as training and as test"),
    (lambda f: _edit(f, 'free_parameters = ["m", "b", "k"]', 'free_parameters = ["mass"]'),
     "not a parameter"),
    (lambda f: _edit(f, 'F = "N"', 'F = "N"\nG = "N"'), "has 1 inputs, case.toml lists 2"),
    (lambda f: (f / "simulator.py").write_text("1/0"), "ZeroDivisionError"),
    (lambda f: (f / "simulator.py").write_text("x = 1"), "no build"),
    (lambda f: _edit(f, "simulator =", "simulatr ="), "lacks 'simulator'"),
])
def test_bad_cases_get_one_clear_line(tmp_path, change, message):
    train, test = record(1, samples=60), record(2, samples=60)
    folder = write_case(tmp_path / "case", SIMULATOR, {"train.csv": train}, {"test.csv": test}, FREE)
    change(folder)
    with pytest.raises(InputError, match=message):
        explain_case(folder, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def _edit(folder, old, new):
    path = folder / "case.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_constant_output_and_mixed_sampling_are_refused():
    a, b = record(1, samples=60), record(2, samples=60)
    flat = a.replace(outputs=np.ones_like(a.outputs))
    with pytest.raises(InputError, match="constant"):
        explain(oscillator(), [flat], [b], FREE)
    with pytest.raises(InputError, match="resample"):
        explain(oscillator(), [a], [b.replace(time=2 * b.time)], FREE)
    with pytest.raises(InputError, match="also a training recording"):
        explain(oscillator(), [a], [a], FREE)


def test_recordings_of_one_name_keep_apart():
    runs = [record(s, samples=300).replace(name="log") for s in (1, 2, 3)]
    report = explain(oscillator(), runs[:1], runs[1:], ["b"], effects=effect_by_id("constant_load"))
    assert list(report.fit) == ["log (2)", "log (3)"]


def test_columns_in_another_order_than_the_simulators_own_names(tmp_path):
    def recording(seed):
        r = record(seed, samples=100)
        return r.replace(outputs=np.hstack([np.gradient(r.outputs[:, 0], r.time)[:, None], r.outputs]),
                         output_names=("v", "x"), units={"F": "N", "v": "m/s", "x": "m"})

    source = SIMULATOR.replace("return np.array([x[0]])", "return x").replace('outputs=["x"]', 'outputs=["x", "v"]')
    case = load_case(write_case(tmp_path, source, {"a.csv": recording(1)}, {"b.csv": recording(2)}, FREE))
    assert case.plant.output_names == ("x", "v") and case.output_units == ("m", "m/s")
    assert case.train[0].output_names == ("x", "v")


def test_a_simulator_may_import_its_neighbours(tmp_path):
    for folder, stiffness in (("one", 3.0), ("two", 4.0)):
        source = SIMULATOR.replace("import numpy as np", "import numpy as np\nfrom helper import STIFFNESS").replace(
            '"k": 3.2', '"k": STIFFNESS')
        write_case(tmp_path / folder, source, {"a.csv": record(1, samples=60)}, {"b.csv": record(2, samples=60)}, FREE)
        (tmp_path / folder / "helper.py").write_text(f"STIFFNESS = {stiffness}\n")
        assert load_case(tmp_path / folder).plant.parameters["k"] == stiffness


def test_a_folder_that_cannot_hold_results_is_found_out_first(tmp_path, clean_recordings):
    folder = case(tmp_path / "case", clean_recordings)
    with pytest.raises(InputError, match="cannot be written"):
        explain_case(folder, folder / "case.toml" / "out")
    assert not (folder / "explained").exists()
