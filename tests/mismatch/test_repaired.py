"""The repaired simulator's file simulates what the engine simulates, for every law of the catalogue."""

from __future__ import annotations

from math import tanh

import control
import numba
import numpy as np
import pytest
from tests_support import oscillator, record

from pwaid.errors import InputError
from pwaid.mismatch.accelerometers import rates_shown
from pwaid.mismatch.built import with_arguments
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.effects.base import Effect, Quantity, push
from pwaid.mismatch.effects.registry import CATALOGUE
from pwaid.mismatch.fit import Fit
from pwaid.mismatch.hypotheses import Hypothesis
from pwaid.mismatch.model import Model, Settings
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.probing import find_structure
from pwaid.mismatch.repaired import repaired_source, repaired_system
from pwaid.mismatch.screen import locate_effects

STRETCH, TABLE = 1.5, (1.0, 2.0)
DATA = Dataset.from_recordings([record(1, samples=80)])


def two_masses(t, x, u, params):
    twist, rate = x[0] - x[2], x[1] - x[3]
    torque = params["k"] * twist + params["d"] * rate
    return np.array([x[1], (u[0] - torque) / params["Jm"], x[3], (torque - params["b"] * x[3]) / params["Jl"]])


def twisted(t, x, u, params):
    torque = params["k"] * x[2] + params["d"] * (x[0] - 2.0 * x[1])
    return np.array([(u[0] - torque) / params["Jm"], (2.0 * torque - params["b"] * x[1]) / params["Jl"],
                     x[0] - 2.0 * x[1]])


def turntable(t, x, u, params):
    return np.array([x[1], 9.0 * (0.2 - x[0]) - 4.0 * x[1], (u[0] - params["b"] * x[2]) / (params["J"] + x[0] ** 2)])


def sprung(t, x, u, params):
    return np.array([x[1], (u[0] - params["k"] * x[0] - params["b"] * x[1]) / params["m"]])


def tanks(t, x, u, params):
    upper, lower = np.sqrt(np.maximum(x[0], 0.0)), np.sqrt(np.maximum(x[1], 0.0))
    return np.array([params["a"] * (u[0] + 3.0) - params["b"] * upper, params["b"] * upper - params["c"] * lower])


def both_angles(t, x, u, params):
    return np.array([x[0], x[2]])


def linked_tanks(t, x, u, params):
    link, drain = params["link"] * (x[0] - x[1]), params["drain"] * x[1]
    return np.array([params["pump"] * (u[0] + 3.0) - link, link - drain])


def lower_level(t, x, u, params):
    return np.array([x[1]])


def stepped(rates, dt=0.02):
    """The same equations as a discrete simulator, one Euler step a sample."""
    return lambda t, x, u, params: x + dt * rates(t, x, u, params)


def exactly(rates, dt=0.02):
    """The same equations as a discrete simulator that steps as a machine moves: a Runge-Kutta step a sample."""
    def update(t, x, u, params):
        k1 = rates(t, x, u, params)
        k2 = rates(t, x + dt / 2 * k1, u, params)
        k3 = rates(t, x + dt / 2 * k2, u, params)
        return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + rates(t, x + dt * k3, u, params))

    return update


def _linear(dt):
    A, B = np.array([[0.0, 1.0], [-3.0, -0.4]]), np.array([[0.0], [0.9]])
    if dt:
        A, B = np.eye(2) + dt * A, dt * B
    return control.ss(A, B, [[1.0, 0.0]], 0, dt or 0, inputs=["F"], outputs=["x"], states=["x", "v"])


PLANTS = {  # simulator, input unit, output unit
    "oscillator": (oscillator(), "N", "m"),
    "two masses": (control.nlsys(two_masses, both_angles, inputs=["T"],
                                 outputs=["a", "c"], states=["a", "wa", "c", "wc"],
                                 params={"Jm": 1.0, "Jl": 2.0, "k": 40.0, "d": 0.3, "b": 0.2}), "N m", "rad"),
    "twisted shaft": (control.nlsys(twisted, lambda t, x, u, params: x[:1], inputs=["T"], outputs=["wm"],
                                    states=["wm", "wl", "twist"],
                                    params={"k": 40.0, "Jm": 1.0, "Jl": 2.0, "d": 0.3, "b": 0.2}), "N m", "rad/s"),
    "turntable": (control.nlsys(turntable, lambda t, x, u, params: x[2:], inputs=["T"], outputs=["w"],
                                states=["r", "rdot", "w"], params={"J": 0.3, "b": 0.1}), "N m", "rad/s"),
    "tanks": (control.nlsys(tanks, lower_level, inputs=["pump"], outputs=["level"],
                            states=["h1", "h2"], params={"a": 0.3, "b": 0.5, "c": 0.4}), "V", "m"),
    "linked tanks": (control.nlsys(linked_tanks, lower_level, inputs=["pump"], outputs=["level"],
                                   states=["h1", "h2"], params={"link": 0.5, "drain": 0.4, "pump": 0.2}), "V", "m"),
    "accelerometer": (control.nlsys(sprung, lambda t, x, u, params: sprung(t, x, u, params)[1:] / 9.81, inputs=["F"],
                                    outputs=["a"], states=["s", "v"], params={"m": 0.8, "k": 6.0, "b": 0.2}), "N", "g"),
    "linear": (_linear(0.0), "N", "m"),
    "discrete": (_linear(0.02), "N", "m"),
    "stepped mass": (control.nlsys(stepped(sprung), lambda t, x, u, params: x[:1], inputs=["F"], outputs=["x"],
                                   states=["x", "v"], params={"m": 0.8, "k": 6.0, "b": 0.2}, dt=0.02), "N", "m"),
    "exact mass": (control.nlsys(exactly(sprung), lambda t, x, u, params: x[:1], inputs=["F"], outputs=["x"],
                                 states=["x", "v"], params={"m": 0.8, "k": 6.0, "b": 0.2}, dt=0.02), "N", "m"),
    "stepped tanks": (control.nlsys(stepped(tanks), lower_level, inputs=["pump"], outputs=["level"],
                                    states=["h1", "h2"], params={"a": 0.3, "b": 0.5, "c": 0.4}, dt=0.02), "V", "m"),
}


def _setting(name):
    simulator, input_unit, output_unit = PLANTS[name]
    plant = as_plant(simulator)
    nx, _, ny = plant.sizes
    rng = np.random.default_rng(0)
    data = Dataset(DATA.names, DATA.U, np.repeat(DATA.Y, ny, axis=1), DATA.segments, DATA.sample_time)
    states = rng.uniform(0.2, 1.0, (64, nx)) if "tanks" in name else rng.normal(size=(64, nx))
    free = tuple(plant.parameters)[:2]
    s = find_structure(plant, states, data.U, data.Y, [input_unit], [output_unit] * ny, data.sample_time, 1.6, free)
    return plant, data, s, Settings(plant, s.partner, s.ratio, free, np.full(len(free), 0.3), substeps=2,
                                   rates_shown=rates_shown(s), share=s.share)


def _hypothesis(settings, located, data):
    model = Model(settings, located)
    z = [e.internal([q.probes[0] if q.probes else 1.0 for q in e.effect.quantities]) for e in located]
    theta = np.concatenate([[0.05, -0.03], *z])
    start = np.linspace(0.3, 0.4, model.nx)[None]
    Y, X = model.simulate(theta, start, data)
    fit = Fit(model, theta, start, 0.0, Y, X, 0)
    return Hypothesis(tuple(located), fit, fit, 0.0, 0.0, 0.0)


def _run_file(hypothesis, plant_object, data):
    """The file's simulate(), with the simulator handed in as its nominal build."""
    space = {"build": lambda: plant_object}
    source = repaired_source(hypothesis, data.sample_time, "# nominal simulator")
    assert "pwaid." not in source.replace("written by pwaid.", "")
    exec(compile(source, "repaired_simulator.py", "exec"), space)
    return space["simulate"](np.arange(len(data.U)) * data.sample_time, data.U, hypothesis.fit.X0[0])


@pytest.mark.parametrize("name", PLANTS)
def test_the_file_simulates_every_law_as_the_engine_does(name):
    plant, data, structure, settings = _setting(name)
    seen = set()
    for located in locate_effects(CATALOGUE, structure):
        key = (located.effect.id, located.effect.law, located.place.ii[1], located.place.ii[10])
        if key in seen:
            continue
        seen.add(key)
        hypothesis = _hypothesis(settings, (located,), data)
        got = _run_file(hypothesis, PLANTS[name][0], data)
        scale = np.max(np.abs(hypothesis.fit.Y))
        np.testing.assert_allclose(got, hypothesis.fit.Y, rtol=1e-8, atol=1e-9 * scale, err_msg=located.label)
    assert len(seen) > 15


@pytest.mark.parametrize("ids", [("coulomb_friction", "input_play"), ("actuator_lag", "presliding_friction"),
                                 ("input_delay", "coulomb_friction"), ("coulomb_friction", "sensor_lag"),
                                 ("actuator_saturation", "actuator_lag"), ("actuator_lag", "actuator_rate_limit"),
                                 ("constant_load", "input_play"), ("actuator_saturation", "load_dependent_friction"),
                                 ("load_dependent_friction", "input_play"), ("missing_inertia", "coulomb_friction"),
                                 ("coulomb_friction", "compliance"), ("compliance", "viscous_friction")])
def test_pairs_keep_their_memories_apart(ids):
    _, data, structure, settings = _setting("oscillator")
    everywhere = locate_effects(CATALOGUE, structure)
    pair = [next(e for e in everywhere if e.effect.id == i) for i in ids]
    hypothesis = _hypothesis(settings, pair, data)
    np.testing.assert_allclose(_run_file(hypothesis, PLANTS["oscillator"][0], data), hypothesis.fit.Y, rtol=1e-8,
                               atol=1e-9)


def test_interpolated_inputs_are_followed_as_fitted():
    _, data, structure, settings = _setting("oscillator")
    held = Settings(**{**settings.__dict__, "first_order_hold": True})
    law = next(e for e in locate_effects(CATALOGUE, structure) if e.effect.id == "cubic_stiffness")
    hypothesis = _hypothesis(held, (law,), data)
    np.testing.assert_allclose(_run_file(hypothesis, PLANTS["oscillator"][0], data), hypothesis.fit.Y, rtol=1e-8,
                               atol=1e-9)


def _by_arguments(m=1.1, b=0.5, k=3.2):
    return control.ss([[0.0, 1.0], [-k / m, -b / m]], [[0.0], [1.0 / m]], [[1.0, 0.0]], 0, inputs=["F"], outputs=["x"])


def _curve_by_arguments(b=0.5):
    def update(t, x, u, params):
        return [x[1], (u[0] - b * x[1] - params["k"] * np.sinh(x[0])) / params["m"]]

    return control.nlsys(update, lambda t, x, u, params: [x[0]], inputs=["F"], outputs=["x"], states=["x", "v"],
                         params={"m": 1.1, "k": 3.2})


@pytest.mark.parametrize("build", [_by_arguments, _curve_by_arguments])
def test_parameters_that_build_takes_are_refitted_in_the_file(build):
    _, data, structure, _ = _setting("oscillator")
    plant = with_arguments(as_plant(build()), build, ["b", "m"])
    assert set(plant.parameters) == {"m", "b", "k"} and plant.rhs is not None
    settings = Settings(plant, structure.partner, structure.ratio, ("b", "m"), np.full(2, 0.3), substeps=2)
    located = locate_effects(CATALOGUE, find_structure(plant, np.random.default_rng(0).normal(size=(64, 2)), data.U,
                                                       data.Y, ["N"], ["m"], data.sample_time, 1.6, ("b", "m")))
    law = next(e for e in located if e.effect.id == "quadratic_drag")
    hypothesis = _hypothesis(settings, (law,), data)
    space = {"build": build}
    exec(compile(repaired_source(hypothesis, data.sample_time, "# nominal simulator"), "repaired.py", "exec"), space)
    got = space["simulate"](np.arange(len(data.U)) * data.sample_time, data.U, hypothesis.fit.X0[0])
    np.testing.assert_allclose(got, hypothesis.fit.Y, rtol=1e-8, atol=1e-9)


@numba.njit
def _smooth_sign(x):
    return tanh(x)


def _soft(phase, t, h, x, xs, u, p, dx, ii, q):
    push(phase, -q[0] * _smooth_sign(x[ii[4]] / (STRETCH * q[1])) * np.exp(-x[ii[4]] ** 2), ii, u, p, dx)


def test_a_law_takes_along_what_it_uses_of_its_module():
    _, data, structure, settings = _setting("oscillator")
    effect = Effect("soft_friction", "dry_friction", "F = c * tanh(v / (1.5 v0)) * exp(-v^2)",
                    (Quantity("c", "force", 1e-4, 5.0, (0.4,)), Quantity("v0", "speed", 1e-3, 1.0, (0.05,))), _soft,
                    lambda s: s.moving(), cached=False)
    hypothesis = _hypothesis(settings, locate_effects([effect], structure), data)
    np.testing.assert_allclose(_run_file(hypothesis, PLANTS["oscillator"][0], data), hypothesis.fit.Y, rtol=1e-8,
                               atol=1e-9)


def test_what_cannot_go_into_the_file_is_named():
    _, data, structure, settings = _setting("oscillator")
    effect = Effect("strange", "dry_friction", "F = table", (Quantity("c", "force", 1e-4, 5.0, (0.4,)),), _tabled,
                    lambda s: s.moving(), cached=False)
    with pytest.raises(InputError, match="_tabled uses 'TABLE' of its module"):
        _run_file(_hypothesis(settings, locate_effects([effect], structure), data), PLANTS["oscillator"][0], data)


def _tabled(phase, t, h, x, xs, u, p, dx, ii, q):
    push(phase, -q[0] * TABLE[0] * x[ii[4]], ii, u, p, dx)


def test_a_right_hand_side_as_simulator_has_its_file_too():
    plant, data, structure, settings = _setting("oscillator")
    bare = as_plant(sprung, ("F",), ("s", "v"), {"m": 0.8, "k": 6.0, "b": 0.2})
    data = Dataset(data.names, data.U, np.repeat(data.Y, 2, axis=1), data.segments, data.sample_time)
    hypothesis = _hypothesis(Settings(bare, structure.partner, structure.ratio, ("m", "b"), np.full(2, 0.3),
                                      substeps=2), (), data)
    got = _run_file(hypothesis, sprung, data)
    np.testing.assert_allclose(got, hypothesis.fit.Y, rtol=1e-8, atol=1e-9)


def test_the_law_reads_as_physics():
    _, data, structure, settings = _setting("oscillator")
    law = next(e for e in locate_effects(CATALOGUE, structure) if e.effect.id == "quadratic_drag")
    source = repaired_source(_hypothesis(settings, (law,), data), data.sample_time, "", {"0.coefficient": "N s2/m2"})
    assert "rates[1] -= coefficient * v * abs(v) / params['m']  # dv/dt" in source
    assert "# N s2/m2" in source
    assert "dry_friction" not in source  # only what this law needs


def test_the_object_has_the_simulators_channels():
    _, data, structure, settings = _setting("oscillator")
    law = next(e for e in locate_effects(CATALOGUE, structure) if e.effect.id == "presliding_friction")
    system = repaired_system(_hypothesis(settings, (law,), data), data.sample_time)
    assert (system.ninputs, system.noutputs, system.nstates) == (1, 1, 4)
    assert system.dt == data.sample_time
