"""Callables simulate(u): effects in front of them and behind them, their start, their hooks, and refusals."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy.signal import lfilter
from tests_support import record

from pwaid.errors import InputError
from pwaid.mismatch import explain, explain_case
from pwaid.mismatch.case import write_case
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.effects.registry import CATALOGUE, effect_by_id
from pwaid.mismatch.explain import collect, conclude
from pwaid.mismatch.fit import Fit
from pwaid.mismatch.hypotheses import Hypothesis, floor_square
from pwaid.mismatch.model import Model, Settings
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.probing import find_structure
from pwaid.mismatch.repaired_blackbox import repaired_black_box
from pwaid.mismatch.screen import locate_effects

SIMULATOR = '''"""Mass, spring and damper, closed in a function."""
import numpy as np
from scipy.signal import lfilter

DEN = [1.0, -1.990, 0.9911]


def simulate(u):
    return lfilter([0.0, 2.0e-4, 2.0e-4], DEN, u[:, 0])


def build():
    return simulate
'''
NUM, DEN = [0.0, 2.0e-4, 2.0e-4], [1.0, -1.990, 0.9911]


def simulate(u):
    return lfilter(NUM, DEN, u[:, 0])


def recordings(change=lambda u: u, measure=lambda y: y, force=0.0, noise=1e-4, samples=600):
    """The multisine recordings with the effect `change` at the command, `measure` at the sensor."""
    found = []
    for seed in (1, 2, 3):
        r = record(seed, samples=samples)
        y = measure(simulate(change(r.inputs) + force))
        rng = np.random.default_rng(seed)
        found.append(r.replace(outputs=(y + noise * rng.standard_normal(samples))[:, None]))
    return found


def dead(u):
    return np.sign(u) * np.maximum(np.abs(u) - 0.25, 0.0)


def named(simulator, recs, **options):
    report = explain(simulator, recs[:2], recs[2:], **options)
    return report, [e["id"] for e in report.effects]


def test_a_dead_zone_is_named_and_written_down(tmp_path):
    a, b, c = recordings(dead)
    folder = write_case(tmp_path / "case", SIMULATOR, {"a.csv": a, "b.csv": b}, {"c.csv": c}, ["gain_F"])
    report = explain_case(folder, tmp_path / "out")
    assert report.verdict == "named" and [e["id"] for e in report.effects] == ["actuator_deadzone"]
    assert report.effects[0]["parameters"]["half_width"]["value"] == pytest.approx(0.25, rel=0.02)
    assert report.content["parameters"]["gain_F"]["refitted"] == pytest.approx(1.0, abs=0.02)
    assert any("black box" in w and "state" in w for w in report.content["warnings"])
    np.save(tmp_path / "u.npy", c.inputs)
    code = ("import sys, numpy as np; sys.modules['pwaid'] = None; sys.path.insert(0, 'out'); "
            "import repaired_simulator as r; np.save('y.npy', r.simulate(np.load('u.npy')))")
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)
    np.testing.assert_allclose(np.load(tmp_path / "y.npy"), report.simulator(c.inputs), atol=1e-12)
    assert np.sqrt(np.mean((report.simulator(c.inputs) - c.outputs) ** 2)) < 2e-4


@pytest.mark.parametrize(("effect", "parameter", "value", "recs"), [
    ("sensor_saturation", "limit", 0.3, {"measure": lambda y: np.clip(y, -0.3, 0.3)}),
    ("actuator_saturation", "limit", 0.9, {"change": lambda u: np.clip(u, -0.9, 0.9)}),
    ("input_delay", "delay", 0.08, {"change": lambda u: np.vstack([np.repeat(u[:1], 4, axis=0), u[:-4]])}),
])
def test_laws_in_front_and_behind_are_named(effect, parameter, value, recs):
    report, ids = named(simulate, recordings(**recs))
    assert report.verdict == "named" and ids == [effect]
    assert report.effects[0]["parameters"][parameter]["value"] == pytest.approx(value, rel=0.02)


def test_friction_inside_is_not_given_another_name(friction_recordings):
    poles = np.roots([1.0, 0.45, 3.0])
    den = np.real(np.poly(np.exp(0.02 * poles)))

    def linear(u):
        return lfilter([0.0, 0.5 * 4e-4, 0.5 * 4e-4], den, u[:, 0])

    report, _ = named(linear, friction_recordings)
    assert report.verdict == "unexplained"


def test_a_constant_force_goes_through_the_hook():
    def hooked(u, force=None):
        return lfilter(NUM, DEN, u[:, 0] ** 3 + (0.0 if force is None else force))

    recs = []
    for r in recordings():
        y = hooked(r.inputs, 0.2 * np.ones(len(r))) + 1e-4 * np.random.default_rng(4).standard_normal(len(r))
        recs.append(r.replace(outputs=y[:, None]))
    hooked.forces = {"load": "N"}
    report, ids = named(hooked, recs)
    entry = next(e for e in report.effects if e["where"]["kind"] == "force")
    assert entry["id"] == "constant_load" and entry["where"]["signal"] == "load"
    assert set(ids) <= {"constant_load", "sensor_offset"}  # a free start leaves only their static gains apart
    level = entry["parameters"]["level"]
    assert level["value"] == pytest.approx(0.2, rel=0.02) and level["unit"] == "N"


def test_parameters_and_start_are_fitted_where_the_callable_takes_them():
    def slow(u, params, x0=(0.0,)):
        a, y, x = params["pole"], np.empty(len(u)), x0[0]
        for k, v in enumerate(u[:, 0]):
            y[k] = x
            x = a * x + (1 - a) * params["gain"] * v
        return y

    slow.params = {"pole": 0.93, "gain": 1.2}
    true = {"pole": 0.95, "gain": 1.0}
    recs = []
    for r, start in zip(recordings(), (0.5, -0.3, 0.8), strict=True):
        y = slow(r.inputs, true, (start,)) + 1e-3 * np.random.default_rng(5).standard_normal(len(r))
        recs.append(r.replace(outputs=y[:, None]))
    report, _ = named(slow, recs)
    assert report.verdict == "parameters_only"
    for name, value in true.items():
        assert report.content["parameters"][name]["refitted"] == pytest.approx(value, rel=0.01)
    assert report.null.test.X0[0, 0] == pytest.approx(0.8, abs=0.01)


def test_another_start_is_not_an_effect():
    free = lfilter([0.3], DEN, np.eye(1, 600)[0])  # how it comes to rest
    report, _ = named(simulate, recordings(measure=lambda y: y + free))
    assert report.verdict == "agreement"
    assert any("pulses of the inputs" in w for w in report.content["warnings"])


def test_a_start_that_inputs_cannot_set_is_left_out():
    def falling(u):
        return lfilter(NUM, DEN, u[:, 0]) + np.exp(-np.arange(len(u)) / 20.0)

    report, _ = named(falling, recordings())
    assert report.verdict == "agreement"
    assert any("not compared" in w for w in report.content["warnings"])
    assert len(report.problem.test.Y) < 600


@pytest.mark.parametrize("name", ["actuator_lag", "input_play", "actuator_rate_limit", "input_delay", "sensor_lag",
                                  "actuator_gain_asymmetry", "sensor_quantization", "sensor_drift", "parameter_drift",
                                  "constant_load", "periodic_disturbance"])
def test_the_written_laws_are_the_fitted_ones(name):
    plant = as_plant(simulate, ("F",), ("x",))
    data = Dataset.from_recordings([recordings(samples=200)[0]])
    structure = find_structure(plant, np.zeros((4, 0)), data.U, data.Y, ["N"], ["m"], 0.02, 4.0, ("gain_F",))
    located = next(e for e in locate_effects(CATALOGUE, structure) if e.effect.id == name)
    model = Model(Settings(plant, np.zeros(0, dtype=np.int64), np.zeros(0), ("gain_F",), np.array([0.3])), (located,))
    z = located.internal([q.probes[0] if q.probes else 2.0 for q in located.effect.quantities])
    theta = np.concatenate([[0.1], z])
    Y, X = model.simulate(theta, np.zeros((1, 0)), data)
    fit = Fit(model, theta, np.zeros((1, 0)), 0.0, Y, X, 0)
    again = repaired_black_box(Hypothesis((located,), fit, fit, 0.0, 0.0, 0.0), 0.02)(data.U)
    assert np.max(np.abs(Y[:, 0] - 1.1 * simulate(data.U))) > 1e-6
    np.testing.assert_allclose(again, Y, atol=1e-12)


def failing(u):
    raise ValueError("no licence")


@pytest.mark.parametrize(("simulator", "message"), [
    (failing, "raised ValueError: no licence"),
    (lambda u: np.zeros((len(u), 2)), r"expected y of shape \(600, 1\)"),
    (lambda u: np.zeros(len(u) - 1), r"expected y of shape \(600, 1\)"),
    (lambda u: "late", "returned str"),
    (lambda u: u[:, 0] * np.inf, "not finite from sample 0"),
    (lambda u: np.random.default_rng().standard_normal(len(u)), "expected the same outputs for the same inputs"),
    (lambda u, params: u[:, 0], "gives no nominal ones"),
    (lambda u, x0: u[:, 0], "gives no nominal one"),
    (lambda u, params={"a": "b"}: u[:, 0], "one number per name"),
    (lambda u, t: u[:, 0], "needs 't'"),
    (lambda: 0, "takes no argument"),
])
def test_a_callable_that_breaks_the_contract_gets_one_line(simulator, message):
    recs = recordings()
    with pytest.raises(InputError, match=message):
        explain(simulator, recs[:2], recs[2:])


def test_a_callable_that_fails_at_some_inputs_only_is_reported():
    def careful(u):
        if 0 < np.std(u) < low:
            raise FloatingPointError("beyond the table")
        return simulate(u)

    recs = recordings(dead)
    low = 0.7 * min(np.std(r.inputs) for r in recs)
    report, ids = named(careful, recs)
    assert ids == ["actuator_deadzone"]
    assert any("beyond the table" in w for w in report.content["warnings"])


def test_a_callable_that_fills_one_array_again_and_again():
    """What it returned before must not change with the next call."""
    kept = np.zeros((600, 1))

    def reusing(u, params={"gain": 1.0}):  # noqa: B006 - the contract asks for defaults
        kept[:] = params["gain"] * simulate(u).reshape(-1, 1)
        return kept

    box = as_plant(reusing, ("u",), ("y",)).black_box
    u = recordings()[0].inputs
    first = box.run(u, {"gain": 0.5}, np.zeros(box.n_starts)).copy()
    box.run(u, {"gain": 2.0}, np.zeros(box.n_starts))
    np.testing.assert_array_equal(box.run(u, {"gain": 0.5}, np.zeros(box.n_starts)), first)


def test_what_a_black_box_leaves_far_above_the_noise_is_no_disturbance():
    """Friction inside, small beside the travel: without a look at states nothing says that it is no physics."""
    def spring(u, params={"b": 0.45}):  # noqa: B006 - the contract asks for defaults
        x, v, y = 0.0, 0.0, []
        for value in np.ravel(u):
            y.append(x)
            for _ in range(4):
                v += 0.005 * (value - params["b"] * v - 3.0 * x)
                x += 0.005 * v
        return np.array(y)

    recs = [record(seed, level=0.1, samples=400, noise=1e-3) for seed in (1, 2, 3)]
    evidence = collect(spring, recs[:2], recs[2:], ["b"], effects=effect_by_id("sensor_offset"))
    assert evidence.null.test_error > 4 * floor_square(evidence.problem)
    assert conclude(evidence, brief=True).verdict == "unexplained"
