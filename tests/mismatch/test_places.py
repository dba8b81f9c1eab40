"""Laws where the simulator is written another way: a twist as a state, a gain that is not free, a length that turns."""

from __future__ import annotations

import control
import numpy as np
import pytest
from tests_support import multisine, oscillator, record

from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import explain
from pwaid.recording import Recording


def _recordings(rates, start, columns, sigma, ranges, units, samples=1200, dt=0.02, fine=20):
    """Three recordings of dx/dt = rates(x, u); `ranges` holds mean and amplitude of every input."""
    found = []
    for seed in (1, 2, 3):
        rng = np.random.default_rng(seed)
        t = np.arange(samples) * dt
        U = np.column_stack([mean + amplitude * multisine(rng, t, 1.5) for mean, amplitude in ranges])
        x, Y = np.array(start, dtype=float), np.empty((samples, len(columns)))
        for k in range(samples):
            Y[k] = x[list(columns)]
            for _ in range(fine):
                x = x + dt / fine * rates(x + 0.5 * dt / fine * rates(x, U[k]), U[k])
        Y += sigma * rng.normal(size=Y.shape)
        inputs, outputs = (tuple(n for n in units if n.startswith(c)) for c in "uy")
        found.append(Recording(t, U, Y, inputs, outputs, units, name=f"r{seed}.csv"))
    return found


def _shaft(x, u, k, gap):
    twist = np.sign(x[2]) * max(abs(x[2]) - gap, 0.0)
    torque = k * twist + (0.4 * (x[0] - x[1]) if twist else 0.0)
    return np.array([(u[0] - torque - 0.2 * x[0]) / 0.5, (torque - 0.3 * x[1]) / 1.5, x[0] - x[1]])


def test_a_gap_is_found_where_the_twist_is_a_state():
    def linear(t, x, u, params):
        torque = params["k"] * x[2] + 0.4 * (x[0] - x[1])
        return np.array([(u[0] - torque - 0.2 * x[0]) / 0.5, (torque - 0.3 * x[1]) / 1.5, x[0] - x[1]])

    simulator = control.nlsys(
        linear, lambda t, x, u, p: x[:2], inputs=["uT"], outputs=["yM", "yL"],
        states=["wm", "wl", "twist"], params={"k": 33.0})
    train = _recordings(lambda x, u: _shaft(x, u, 30.0, 0.05), (0, 0, 0), (0, 1), 0.01, [(0.0, 2.0)],
                        {"uT": "N m", "yM": "rad/s", "yL": "rad/s"})
    report = explain(simulator, train[:2], train[2:], ["k"],
                     effects=[e for i in ("backlash", "coulomb_friction", "compliance") for e in effect_by_id(i)])
    assert report.verdict == "named"
    (effect,) = report.effects
    assert (effect["id"], effect["where"]["signal"]) == ("backlash", "twist")
    assert effect["parameters"]["half_gap"]["value"] == pytest.approx(0.05, rel=0.05)
    assert effect["parameters"]["half_gap"]["unit"] == "rad"
    assert report.to_dict()["parameters"]["k"]["refitted"] == pytest.approx(30.0, rel=0.02)


def test_one_weak_direction_of_an_amplifier_is_found_where_no_free_parameter_is_its_gain():
    def amplified(recording, gain):
        u = np.where(recording.inputs < 0, recording.inputs / gain, recording.inputs)
        return recording.replace(inputs=u)

    recordings = [amplified(record(s), 0.7) for s in (1, 2, 3)]
    report = explain(oscillator(m=1.0, k=3.0), recordings[:2], recordings[2:], ["b"],
                     effects=[e for i in ("actuator_gain_asymmetry", "constant_load") for e in effect_by_id(i)])
    (effect,) = report.effects
    assert report.verdict == "named" and effect["id"] == "actuator_gain_asymmetry"
    assert effect["parameters"]["change"]["value"] == pytest.approx(-0.3, abs=0.01)
    assert effect["where"]["note"] == "negative"


def _table(x, u, coriolis):
    r, rate, w = x
    return np.array([rate, 16.0 * (u[0] - r) - 7.0 * rate,
                     (u[1] - 0.06 * w - coriolis * r * rate * w) / (0.1 + 1.8 * r**2)])


def test_a_length_times_two_speeds_is_a_coriolis_torque():
    simulator = control.nlsys(
        lambda t, x, u, p: _table(x, u, 0.0) * np.array([1, 1, p["s"]]), lambda t, x, u, p: x[[0, 2]],
        inputs=["uR", "uT"], outputs=["yR", "yW"], states=["r", "rdot", "w"], params={"s": 1.1})
    train = _recordings(lambda x, u: _table(x, u, 3.6), (0.2, 0, 0.5), (0, 2), 0.005, [(0.25, 0.06), (0.1, 0.05)],
                        {"uR": "m", "uT": "N m", "yR": "m", "yW": "rad/s"})
    report = explain(simulator, train[:2], train[2:], ["s"],
                     effects=[e for i in ("coriolis_torque", "quadratic_drag") for e in effect_by_id(i)])
    (effect,) = report.effects
    assert report.verdict == "named" and effect["where"]["variables"] == ["rdot", "w", "r"]
    assert effect["parameters"]["coefficient"]["value"] == pytest.approx(3.6, rel=0.03)
