"""Laws in a discrete nonlinear simulator act as rates: their sizes have the units that they have in continuous time."""

from __future__ import annotations

import control
import numpy as np
import pytest
from tests_support import multisine

from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import explain
from pwaid.recording import Recording

STEP = 0.02


def _recordings(step, start, u_of, names, units, samples=700, noise=2e-3):
    found = []
    for seed in (1, 2, 3):
        rng = np.random.default_rng(seed)
        t, x, y = np.arange(samples) * STEP, np.array(start, float), []
        u = u_of(rng, t)
        for value in u:
            y.append(x[-1])
            x = step(x, value)
        found.append(Recording(t, u[:, None], (np.array(y) + noise * rng.normal(size=samples))[:, None], names[:1],
                               names[1:], dict(zip(names, units, strict=True)), name=f"r{seed}.csv"))
    return found


def _named(simulator, recordings, free, *ids):
    report = explain(simulator, recordings[:2], recordings[2:], free, effects=[e for i in ids for e in effect_by_id(i)])
    assert report.verdict == "named", report.verdict
    return report.effects[0]


def mass(t, x, u, params):
    return np.array([x[0] + STEP * x[1], x[1] + STEP / params["m"] * (u[0] - params["b"] * x[1] - 3.0 * x[0])])


@pytest.mark.parametrize("id, law", [
    ("coulomb_friction", lambda v, free: np.sign(free) * max(abs(free) - STEP * 0.45, 0.0)),
    ("quadratic_drag", lambda v, free: free - STEP * 0.45 * v * abs(v)),
])
def test_forces_have_their_size(id, law):
    def step(x, u):
        return np.array([x[0] + STEP * x[1], law(x[1], x[1] + STEP * (u - 0.45 * x[1] - 3.0 * x[0]))])

    simulator = control.nlsys(mass, lambda t, x, u, params: x[1:], inputs=["F"], outputs=["v"], states=["x", "v"],
                              params={"m": 1.0, "b": 0.5}, dt=STEP)
    effect = _named(simulator, _recordings(step, (0.0, 0.0), lambda rng, t: multisine(rng, t, 1.5), ("F", "v"),
                                           ("N", "m/s")), ["b"], id)
    found = next(iter(effect["parameters"].values()))
    assert effect["id"] == id and found["value"] == pytest.approx(0.45, rel=0.03)
    assert found["unit"] == ("N" if id == "coulomb_friction" else "N s^2/m^2")


@pytest.mark.parametrize("id, law", [("leakage", lambda h, new: new - STEP * 0.3 * h),
                                     ("overflow", lambda h, new: min(new, 1.5))])
def test_stores_leak_and_spill(id, law):
    def flow(h, u, outlet):
        return h + STEP * 3.0 * (0.5 * u - outlet * np.sqrt(max(h, 0.0)))

    def drawn(rng, t):
        return np.repeat(rng.uniform(0.0, 2.0, len(t) // 50), 50)

    recordings = _recordings(lambda x, u: np.array([law(x[0], flow(x[0], u, 0.4))]), (0.5,), drawn, ("q", "h"),
                             ("V", "m"))
    simulator = control.nlsys(lambda t, x, u, params: np.array([flow(x[0], u[0], params["outlet"])]),
                              lambda t, x, u, params: x, inputs=["q"], outputs=["h"], states=["h"],
                              params={"outlet": 0.42}, dt=STEP)
    effect = _named(simulator, recordings, ["outlet"], id, "sensor_saturation")
    truth = {"leakage": 0.3, "overflow": 1.5}[id]
    assert effect["id"] == id
    assert next(iter(effect["parameters"].values()))["value"] == pytest.approx(truth, rel=0.03)
