"""Clock shifts and the hold are found from recording and simulation, and said in plain words."""

from __future__ import annotations

import re
from types import SimpleNamespace

import control
import numpy as np
import pytest
from scipy.linalg import expm
from tests_support import TRUE, multisine, oscillator, recorded

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import collect, explain
from pwaid.mismatch.hygiene import _sign
from pwaid.mismatch.timing import shift_between, timing_notes
from pwaid.recording import Recording

H, N = 0.01, 2000
T = np.arange(N) * H


def signal(t):
    return np.sin(2.1 * t) + 0.6 * np.sin(5.3 * t + 1) + 0.3 * np.sin(9.7 * t + 2)


def problem(recorded_at, interpolated=False, noise=1e-3):
    """A recording of `signal` at the given times beside its simulation at the sample times."""
    rng = np.random.default_rng(0)
    y = signal(recorded_at) + noise * rng.normal(size=N)
    data = Dataset.from_recordings([Recording(T, T[:, None], y[:, None], ("u",), ("x",), {}, name="r.csv")])
    return SimpleNamespace(train=data, null=SimpleNamespace(Y=signal(T)[:, None]),
                           plant=SimpleNamespace(output_names=("x",)),
                           settings=SimpleNamespace(first_order_hold=interpolated))


@pytest.mark.parametrize("shift", [-3.3, -0.5, 0.5, 1.0, 4.7])
def test_shift_is_found_to_a_fraction_of_a_sample(shift):
    got, alike, gain = shift_between(signal(T - shift * H), signal(T), 20)
    assert got == pytest.approx(shift, abs=0.02)
    assert alike > 0.999
    assert gain > 0.99


def test_equal_clocks_say_nothing():
    assert timing_notes(problem(T)) == []


def test_two_clocks_that_run_apart():
    (note,) = timing_notes(problem(T * (1 - 0.004)))
    assert "two clocks" in note
    assert float(re.search(r"by ([0-9.]+) %", note).group(1)) == pytest.approx(0.4, abs=0.02)


def test_half_a_sample_early_points_to_the_hold():
    (note,) = timing_notes(problem(T + 0.5 * H))
    assert 'hold = "first"' in note
    (note,) = timing_notes(problem(T - 0.5 * H, interpolated=True))
    assert 'hold = "zero"' in note


def test_late_and_early_outputs_are_told_apart():
    (late,) = timing_notes(problem(T - 3 * H))
    (early,) = timing_notes(problem(T + 3 * H))
    assert "3 samples (0.03 s) after its simulation" in late
    assert "no cause can do that" in early


def test_a_factor_that_units_explain_is_named():
    y = signal(T)
    assert "degrees and radians" in _sign("x", 57.3 * y, y, "deg")[0]
    assert "mirrored" in _sign("x", -y, y, "")[0]
    assert _sign("x", 1.3 * y, y, "") == []


def interpolated(seed: int) -> Recording:
    """The true oscillator under a force that runs straight from one sample to the next, exact but for 1 mm of noise."""
    rng, dt, p = np.random.default_rng(seed), 0.1, TRUE
    t = dt * np.arange(250)
    u = multisine(rng, t, 2.5)
    M = expm(dt * np.array([[0, 1, 0, 0], [-p["k"] / p["m"], -p["b"] / p["m"], 1 / p["m"], 0],
                            [0, 0, 0, 1], [0, 0, 0, 0]]))
    x, y = np.zeros(2), np.empty(t.size)
    for k, slope in enumerate(np.diff(u, append=u[-1]) / dt):
        y[k] = x[0]
        x = (M @ [*x, u[k], slope])[:2]
    return recorded(t, u, y, 1e-3, rng, seed)


def test_a_first_order_hold_is_simulated_as_stated():
    runs, error = [interpolated(s) for s in (1, 2, 3)], {}
    for hold in ("zero", "first"):
        problem = collect(oscillator(), runs[:2], runs[2:], hold=hold, effects=effect_by_id("coulomb_friction")).problem
        error[hold] = np.sqrt(np.mean(problem.null.residual(problem.train) ** 2))
    assert error["first"] < 1.2e-3 < 5e-3 < error["zero"]


def test_the_held_out_part_of_the_only_recording_keeps_its_clock():
    """A simulator that knows a wave of the time is exact, on the last third too."""
    def force(t, u):
        return u + np.sin(1.7 * t)

    def update(t, x, u, params):
        return np.array([x[1], force(t, u[0]) - params["b"] * x[1] - params["k"] * x[0]])

    rng, h = np.random.default_rng(5), 1e-3
    t = 0.02 * np.arange(1200)
    u, x, y = multisine(rng, t, 1.5), np.zeros(2), []
    for start, value in zip(t, u, strict=True):
        y.append(x[0])
        for i in range(20):
            middle = x + h / 2 * update(start + i * h, x, [value], {"b": 0.5, "k": 3.0})
            x = x + h * update(start + (i + 0.5) * h, middle, [value], {"b": 0.5, "k": 3.0})
    only = recorded(t, u, np.array(y), 2e-3, rng, 1)
    simulator = control.nlsys(update, lambda t, x, u, params: x[:1], inputs=["F"], outputs=["x"], states=["x", "v"],
                              params={"b": 0.5, "k": 3.0})
    for params in ({}, {"b": 0.55}):
        simulator.params.update(params)
        report = explain(simulator, only, None, ["b", "k"], effects=effect_by_id("constant_load"))
        assert report.verdict == ("parameters_only" if params else "agreement")
