"""Rounded readings: the law is the mean over the noise before rounding, and a fit finds it though steps are coarse."""

from __future__ import annotations

import control
import numpy as np
import pytest
from tests_support import TRUE, gathered, record

from pwaid.mismatch.decide import decide
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.effects.sensor import quantization
from pwaid.mismatch.explain import collect
from pwaid.recording import Recording

STEP = 0.06  # 30 times the noise


def rounded(seed: int):
    r = record(seed)
    return r.replace(outputs=STEP * np.round(r.outputs / STEP))


def reading(y: float, dither: float) -> float:
    out = np.array([y])
    quantization(3, 0.0, 0.0, None, None, None, None, out, [0] * 8, [STEP, dither])
    return float(out[0])


@pytest.mark.parametrize("dither", [0.05, 0.2, 0.5])
def test_the_law_is_the_mean_of_rounded_noisy_readings(dither):
    n = np.random.default_rng(0).normal(size=200_000)
    for y in STEP * np.linspace(-1.3, 1.3, 9):
        assert reading(y, dither) == pytest.approx(np.mean(STEP * np.round(y / STEP + dither * n)), abs=4e-3 * STEP)


def test_without_noise_it_rounds():
    y = STEP * np.linspace(-3.4, 3.4, 18)
    np.testing.assert_allclose([reading(v, 0.01) for v in y], STEP * np.round(y / STEP), atol=1e-9)


def test_a_coarse_step_is_found_and_parameters_with_it():
    best = gathered([rounded(s) for s in (1, 2, 3)], "sensor_quantization", "coulomb_friction", "cubic_stiffness",
                    "sensor_nonlinearity").singles[0]
    assert best.ids == ("sensor_quantization",)
    assert best.share > 0.6
    assert best.values()[0][0] == pytest.approx(STEP, rel=0.005)
    found = dict(zip(best.fit.model.settings.free, np.exp(best.fit.theta[:3]), strict=True))
    nominal = {"m": 1.1, "b": 0.5, "k": 3.2}
    assert all(nominal[n] * found[n] == pytest.approx(TRUE[n], rel=0.02) for n in TRUE)


def heated(seed: int, step: float, noise: float) -> Recording:
    """An oven heated in steps of two minutes; its reading shows multiples of a step."""
    rng, t = np.random.default_rng(seed), 2.0 * np.arange(600)
    u, T, y = np.repeat(rng.uniform(2.0, 12.0, 10), 60), 22.0, np.empty(600)
    for k in range(600):
        y[k] = T
        T = 20.0 + u[k] / 0.5 + (T - 20.0 - u[k] / 0.5) * np.exp(-0.5 / 100.0 * 2.0)
    y = step * np.round((y + noise * rng.normal(size=600)) / step)
    return Recording(t, u[:, None], y[:, None], ("P",), ("T",), {"P": "W", "T": "degC"}, name=f"r{seed}.csv")


@pytest.mark.parametrize(("step", "noise", "named"), [(0.25, 0.005, True), (0.25, 0.08, False), (0.01, 0.05, False)])
def test_rounding_that_hides_in_the_floor_is_named_where_it_is_all_there_is(step, noise, named):
    oven = control.nlsys(lambda t, x, u, p: np.array([(u[0] - p["k"] * (x[0] - 20.0)) / p["C"]]),
                         lambda t, x, u, p: x, inputs=["P"], outputs=["T"], states=["T"],
                         params={"k": 0.55, "C": 110.0})
    effects = [e for i in ("sensor_quantization", "constant_load", "sensor_lag", "radiation") for e in effect_by_id(i)]
    runs = [heated(s, step, noise) for s in (1, 2, 3)]
    evidence = collect(oven, runs[:2], runs[2:], ["k", "C"], effects=effects)
    decision = decide(evidence.problem, evidence.null, evidence.singles, evidence.pairs)
    assert any("multiples of 0.25" in note for note in evidence.notes) == named
    if named:
        assert (decision.verdict, decision.chosen.ids) == ("named", ("sensor_quantization",))
        assert decision.chosen.values()[0][0] == pytest.approx(step, rel=0.005)
    else:
        assert decision.verdict == "parameters_only"
