"""Rounded readings: the law is the mean over the noise before rounding, and a fit finds it though steps are coarse."""

from __future__ import annotations

import numpy as np
import pytest
from tests_support import TRUE, gathered, record

from pwaid.mismatch.effects.sensor import quantization

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
