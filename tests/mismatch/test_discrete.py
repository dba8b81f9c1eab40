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


def _recordings(step, start, u_of, names, units, samples=700, noise=2e-3, of=-1):
    found = []
    for seed in (1, 2, 3):
        rng = np.random.default_rng(seed)
        t, x, y = np.arange(samples) * STEP, np.array(start, float), []
        u = u_of(rng, t)
        for value in u:
            y.append(x[of])
            x = step(x, value)
        found.append(Recording(t, u[:, None], (np.array(y) + noise * rng.normal(size=samples))[:, None], names[:1],
                               names[1:], dict(zip(names, units, strict=True)), name=f"r{seed}.csv"))
    return found


def _named(simulator, recordings, free, *ids):
    report = explain(simulator, recordings[:2], recordings[2:], free, effects=[e for i in ids for e in effect_by_id(i)])
    assert report.verdict == "named", report.verdict
    return report.effects


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
                                           ("N", "m/s")), ["b"], id)[0]
    found = next(iter(effect["parameters"].values()))
    assert effect["id"] == id and found["value"] == pytest.approx(0.45, rel=0.03)
    assert found["unit"] == ("N" if id == "coulomb_friction" else "N s^2/m^2")


K, D = 90.0, 1.2  # of a mass on a spring and a damper, per kilogram


def exact(t, x, u, params):
    """The next state of the mass when the force rests in between, as a series of the matrix exponential."""
    m = np.array([[0.0, 1.0, 0.0], [-params["k"], -params["d"], 1.0], [0.0, 0.0, 0.0]]) * STEP
    e = np.eye(3)
    for i in range(9, 0, -1):
        e = np.eye(3) + m @ e / i
    return e[:2, :2] @ x + e[:2, 2] * u[0]


@pytest.mark.parametrize("drag, cubic", [(3.0, 0.0), (3.0, 450.0)])
def test_forces_act_during_the_step_of_a_simulator_that_steps_exactly(drag, cubic):
    def moved(x, u):  # the machine: 20 short steps
        for _ in range(20):
            force = u - D * x[1] - drag * x[1] * abs(x[1]) - K * x[0] - cubic * x[0] ** 3
            middle = x + STEP / 40 * np.array([x[1], force])
            force = u - D * middle[1] - drag * middle[1] * abs(middle[1]) - K * middle[0] - cubic * middle[0] ** 3
            x = x + STEP / 20 * np.array([middle[1], force])
        return x

    recordings = _recordings(moved, (0.0, 0.0), lambda rng, t: np.repeat(rng.uniform(-30, 30, 28), 25),
                             ("a", "x"), ("m/s^2", "m"), of=0)
    simulator = control.nlsys(exact, lambda t, x, u, params: x[:1], inputs=["a"], outputs=["x"], states=["x", "v"],
                              params={"k": 1.1 * K, "d": D}, dt=STEP)
    found = _named(simulator, recordings, ["k", "d"], "quadratic_drag", "cubic_stiffness")
    sizes = {e["id"]: e["parameters"]["coefficient"]["value"] for e in found}
    want = {"quadratic_drag": drag} | ({"cubic_stiffness": cubic} if cubic else {})
    assert sizes == pytest.approx(want, rel=0.03)


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
    effect = _named(simulator, recordings, ["outlet"], id, "sensor_saturation")[0]
    truth = {"leakage": 0.3, "overflow": 1.5}[id]
    assert effect["id"] == id
    assert next(iter(effect["parameters"].values()))["value"] == pytest.approx(truth, rel=0.03)
