"""Places that probing must find however the simulator is written: through a step, by speed alone, between volumes."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from tests_support import record

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.model import Model, Settings
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.probing import find_structure
from pwaid.mismatch.screen import locate_effects
from pwaid.mismatch.signatures import TEETH, _per_turn

DATA = Dataset.from_recordings([record(1, samples=300)])


def structure(simulator, input_unit, output_units, states, outputs=None):
    plant = as_plant(simulator)
    Y = np.repeat(DATA.Y, len(output_units), axis=1) if outputs is None else outputs
    return find_structure(plant, states, DATA.U, Y, [input_unit], output_units, DATA.sample_time, 6.0, ())


def stepped_motor(dt: float = 1e-3):
    """Current, angle and speed, each step by Runge and Kutta's rule inside the simulator."""
    def rate(x, u, p):
        return np.array([(u - 1.4 * x[0] - 0.08 * x[2]) / 6e-3, x[2], (0.08 * x[0] - 3e-4 * x[2]) / p["J"]])

    def update(t, x, u, p):
        k1 = rate(x, u[0], p)
        k2 = rate(x + dt / 2 * k1, u[0], p)
        k3 = rate(x + dt / 2 * k2, u[0], p)
        k4 = rate(x + dt * k3, u[0], p)
        return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    return control.nlsys(update, lambda t, x, u, p: x[:2], dt=dt, inputs=["u"], outputs=["i", "phi"],
                         states=["i", "phi", "w"], params={"J": 4.6e-4})


def turning():
    """States of a motor that turns fourteen times."""
    return np.random.default_rng(0).normal(size=(64, 3)) * [1.0, 40.0, 50.0]


def test_a_position_shows_through_a_step_of_a_discrete_simulator():
    s = structure(stepped_motor(), "V", ["A", "rad"], turning())
    assert s.kinds == ("electrical", "position", "velocity") and s.partner[1] == 2
    assert s.ratio[1] == pytest.approx(1.0, rel=1e-2)
    assert s.entry[2] == (1, 2, 0)  # a torque on the speed, over the inertia J


def test_an_axis_that_turns_on_has_ripples_with_whole_periods_per_turn():
    s = structure(stepped_motor(), "V", ["A", "rad"], turning())
    ripple = next(e for e in locate_effects(effect_by_id("position_ripple"), s))
    found = _per_turn(ripple, s, 50.0) / ripple.place.scales["position"]
    assert found == pytest.approx(np.arange(1, TEETH + 1))  # all of them lie beyond 50 per reach
    swinging = structure(stepped_motor(), "V", ["A", "rad"], 0.01 * turning(), 0.1 * np.repeat(DATA.Y, 2, axis=1))
    ripple = next(e for e in locate_effects(effect_by_id("position_ripple"), swinging))
    assert len(_per_turn(ripple, swinging, 50.0)) == 0


def test_a_load_may_hide_behind_a_motor_whose_speed_alone_is_known():
    motor = control.nlsys(lambda t, x, u, p: [(u[0] - p["b"] * x[0]) / p["J"]], lambda t, x, u, p: x,
                          inputs=["T"], outputs=["w"], states=["w"], params={"J": 0.3, "b": 0.1})
    s = structure(motor, "N m", ["rad/s"], np.random.default_rng(0).normal(size=(64, 1)))
    places = locate_effects(effect_by_id("compliance"), s)
    assert [e.place.note for e in places] == ["motor side measured", "load side measured"]
    gap = locate_effects(effect_by_id("backlash"), s)[0]
    assert gap.place.units["position"] == {"rad": 1} and gap.place.scales["position"] > 0


def test_a_leak_between_two_volumes_moves_one_level_down_and_the_other_up():
    tanks = control.nlsys(lambda t, x, u, p: [p["k"] * u[0], 0.0 * x[1]], lambda t, x, u, p: x, inputs=["q"],
                          outputs=["h1", "h2"], states=["h1", "h2"], params={"k": 1.0})
    s = structure(tanks, "m^3/s", ["m", "m"], np.random.default_rng(0).uniform(0.1, 1.0, (64, 2)))
    leak = next(e for e in locate_effects(effect_by_id("leakage"), s) if e.place.signal == "h1-h2")
    settings = Settings(s.plant, s.partner, s.ratio, (), np.zeros(0), substeps=8)
    still = replace(DATA, U=0 * DATA.U, Y=np.repeat(DATA.Y, 2, axis=1))
    Y = Model(settings, (leak,)).simulate_with(s.plant.vector(), [np.array([0.6, 0.3])], np.array([[1.0, 0.1]]),
                                               still)[0]
    gone = 1 - np.exp(-0.9 * np.arange(len(Y)) * DATA.sample_time)  # 0.9 m of head at 0.9/s, all told
    np.testing.assert_allclose(Y, np.column_stack([1.0 - 0.6 * gone, 0.1 + 0.3 * gone]), atol=1e-6)


def test_stops_are_looked_for_where_the_machine_went():
    mass = control.nlsys(lambda t, x, u, p: [x[1], (u[0] - p["b"] * x[1]) / p["m"]], lambda t, x, u, p: x[:1],
                         inputs=["F"], outputs=["x"], states=["x", "v"], params={"m": 1.0, "b": 0.5})
    short = np.random.default_rng(0).uniform(-0.5, 0.5, (64, 2))  # a simulator bent by what it lacks
    s = structure(mass, "N", ["m"], short, np.linspace(-2.0, 2.0, 300)[:, None])
    assert s.low[0] < -1.9 and s.high[0] > 1.9
