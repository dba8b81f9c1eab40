"""A limited rate under one sine: the command it meets is held from sample to sample, so the error has many hollows."""

from __future__ import annotations

import control
import numpy as np
import pytest

from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import collect
from pwaid.mismatch.hypotheses import floor_square
from pwaid.recording import Recording

STEP, RATE, MASS, DAMPING, GAIN = 0.02, 7.0, 87.0, 237.0, 29.6


def recording(seed: int, amplitude: float, frequency: float, samples: int = 600) -> Recording:
    """Position of a cart whose amplifier follows 7 V/s at most, 2 % of noise."""
    rng, t = np.random.default_rng(seed), STEP * np.arange(samples)
    u = amplitude * np.sin(frequency * t)
    x, applied, y = np.zeros(2), 0.0, np.empty(samples)
    for k in range(samples):
        y[k] = x[0]
        for _ in range(20):
            applied += np.clip(u[k] - applied, -RATE * STEP / 20, RATE * STEP / 20)
            x = x + STEP / 20 * np.array([x[1], (GAIN * applied - DAMPING * x[1]) / MASS])
    y += 0.02 * np.std(y) * rng.standard_normal(samples)
    return Recording(t, u[:, None], y[:, None], ("voltage",), ("x",), {"voltage": "V", "x": "m"}, name=f"r{seed}.csv")


@pytest.mark.parametrize("amplitude, frequency", [(6.0, 3.0), (10.0, 2.0)])
def test_the_rate_is_found_among_the_hollows(amplitude, frequency):
    def cart(t, x, u, params):
        return np.array([x[1], (params["gain"] * u[0] - params["b"] * x[1]) / params["m"]])

    simulator = control.nlsys(cart, lambda t, x, u, params: x[:1], inputs=["voltage"], outputs=["x"],
                              states=["x", "v"], params={"m": 109.5, "b": 299.7, "gain": GAIN})
    runs = [recording(seed, share * amplitude, frequency) for seed, share in enumerate((1.0, 0.8, 1.0, 0.9))]
    found = collect(simulator, runs[:2], runs[2:], ["m", "b"], effects=effect_by_id("actuator_rate_limit"))
    best = found.singles[0]
    assert best.values()[0][0] == pytest.approx(RATE, rel=0.005)
    assert best.train_error < 1.1 * floor_square(found.problem)
