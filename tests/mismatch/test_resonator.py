"""Strong and strange springs: a hardening resonator read in volts from trusted matrices, hysteresis of any shape."""

from __future__ import annotations

import control
import numpy as np
import pytest
from tests_support import TRUE, gathered, multisine, recorded

from pwaid.mismatch import evidence, scout
from pwaid.mismatch.decide import decide
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import collect
from pwaid.recording import Recording

MASS, DAMPING, SPRING, CUBE = 1.2e-6, 5e-5, 0.222, 0.4  # V s²/V, V s/V, V/V, V/V³: 68 Hz, 610 samples a second
PERIOD = 1 / 610.0
RESONATOR = control.ss([[0, 1], [-SPRING / MASS, -DAMPING / MASS]], [[0], [1 / MASS]], [[1, 0]], [[0]], inputs=["u"],
                       outputs=["y"], states=["y", "ydot"])


def ringing(seed: int, samples: int) -> Recording:
    """Noise of growing size below 200 Hz on the resonator with a spring that hardens up to threefold."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * PERIOD
    phases = rng.uniform(0, 2 * np.pi, 150)
    u = np.sin(2 * np.pi * np.outer(t, np.linspace(1.0, 200.0, 150)) + phases).sum(axis=1)
    u *= 0.07 * np.linspace(0.1, 1.0, samples) / np.std(u)
    y, v, h, out = 0.0, 0.0, PERIOD / 16, np.empty(samples)
    for k in range(samples):
        out[k] = y
        for _ in range(16):
            half = v + 0.5 * h * (u[k] - DAMPING * v - (SPRING + CUBE * y * y) * y) / MASS
            y += h * half
            v = half + 0.5 * h * (u[k] - DAMPING * half - (SPRING + CUBE * y * y) * y) / MASS
    out += 2e-3 * rng.normal(size=samples)
    return Recording(t, u[:, None], out[:, None], ("u",), ("y",), {"u": "V", "y": "V"}, name=f"r{seed}.csv")


def test_a_cubic_spring_stronger_than_the_linear_one_is_named_in_volts(monkeypatch):
    """Found on stretches, where it begins with other states than the null; a law that errs far more there keeps the
    parameters found there."""
    monkeypatch.setattr(scout, "SAMPLES", 900)
    recordings, asked = [ringing(s, n) for s, n in ((1, 2400), (2, 1600), (3, 1600))], []
    original = evidence._promoted
    monkeypatch.setattr(evidence, "_promoted", lambda problem, fitted, *more: asked.append(fitted) or original(
        problem, fitted, *more))
    found = collect(RESONATOR, recordings[:2], recordings[2:], [], effects=[
        e for i in ("cubic_stiffness", "linear_stiffness", "viscous_friction") for e in effect_by_id(i)])
    decision = decide(found.problem, found.null, found.singles, found.pairs)
    assert (decision.verdict, decision.chosen.ids) == ("named", ("cubic_stiffness",))
    assert decision.chosen.values()[0][0] == pytest.approx(CUBE / MASS, rel=0.02)
    assert not found.pairs
    before, after = ({h.ids: h for h in fitted} for fitted in (asked[0], found.singles))
    far, near = ("viscous_friction",), ("cubic_stiffness",)
    assert before[far].train_error > 9 * before[near].train_error
    np.testing.assert_array_equal(after[far].fit.theta, before[far].fit.theta)
    assert len(after[far].fit.Y) == len(found.problem.train.U) == 4000
    assert not np.array_equal(after[near].fit.theta, before[near].fit.theta)


def hysteretic(seed: int, beta: float, gamma: float, samples: int = 900, dt: float = 0.02) -> Recording:
    """The oscillator of the other tests with dz/dt = v - beta |v| z - gamma v |z| and a force of -3 z."""
    rng = np.random.default_rng(seed)
    t, y = np.arange(samples) * dt, np.empty(samples)
    u = multisine(rng, t, 1.5)
    x, v, z, h = 0.0, 0.0, 0.0, dt / 20
    for k in range(samples):
        y[k] = x
        for _ in range(20):
            z += h * (v - beta * abs(v) * z - gamma * v * abs(z))
            v += h * (u[k] - TRUE["b"] * v - TRUE["k"] * x - 3.0 * z) / TRUE["m"]
            x += h * v
    return recorded(t, u, y, 2e-3, rng, seed)


def test_hysteresis_that_narrows_while_unloading_is_no_presliding_friction():
    """Of Bouc and Wen's two numbers the second may be negative: their law with gamma = -beta/2."""
    found = gathered([hysteretic(s, 4.0, -2.0) for s in (1, 2, 3)], "hysteretic_spring", "presliding_friction")
    decision = decide(found.problem, found.null, found.singles, found.pairs)
    assert (decision.verdict, decision.chosen.ids) == ("named", ("hysteretic_spring",))
    force, yielding, order, shape = decision.chosen.values()[0]
    assert force / yielding == pytest.approx(3.0, rel=0.15)
    assert shape < -0.4 and order == pytest.approx(1.0, abs=0.3)
