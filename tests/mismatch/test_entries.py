"""How a force enters: through an input that counts the other way, or through the one that drives its joint."""

from __future__ import annotations

import control
import numpy as np
import pytest
from tests_support import TRUE, pushed

from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import explain
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.probing import find_structure
from pwaid.mismatch.vessels import stores
from pwaid.recording import Recording


def _structure(simulator, units_in, units_out):
    plant = as_plant(simulator)
    nx, nu, ny = plant.sizes
    rng = np.random.default_rng(0)
    states = 0.4 * rng.normal(size=(200, nx))
    return find_structure(plant, states, rng.normal(size=(200, nu)), rng.normal(size=(200, ny)), units_in, units_out,
                          0.02, 4.0)


def test_an_input_that_counts_the_other_way_turns_no_law_round():
    """Extension positive, flexion measured: a spring must still pull back."""
    def update(t, x, u, params):
        return np.array([x[1], -u[0] - params["b"] * x[1] - params["k"] * x[0]])

    simulator = control.nlsys(update, lambda t, x, u, p: x[:1], inputs=["F"], outputs=["x"], states=["x", "v"],
                              params={"b": 0.5, "k": 3.2})
    assert _structure(simulator, ["N"], ["m"]).entry[1] == (2, 0, -1)
    recordings = [r.replace(inputs=-r.inputs) for r in (pushed(s, lambda x, v: -2.0 * x**3) for s in (1, 2, 3))]
    report = explain(simulator, recordings[:2], recordings[2:], ["b", "k"], effects=effect_by_id("cubic_stiffness"))
    (effect,) = report.effects
    assert report.verdict == "named" and TRUE["m"] == 1.0
    assert effect["parameters"]["coefficient"]["value"] == pytest.approx(2.0, rel=0.05)


def _crane(t, x, u, params):
    s, c = np.sin(x[2]), np.cos(x[2])
    mass = np.array([[11.0, 2.4 * c], [c, 0.8]])
    forces = np.array([params["ku"] * u[0] - params["b"] * x[1] + 2.4 * x[3] ** 2 * s, -9.81 * s - 0.03 * x[3]])
    a = np.linalg.solve(mass, forces)
    return np.array([x[1], a[0], x[3], a[1]])


def test_a_force_on_a_coupled_body_enters_where_its_drive_does():
    """The rope pulls back at a trolley that is pushed; a torque at the rope is no push of the trolley."""
    crane = control.nlsys(_crane, lambda t, x, u, p: x[[0, 2]], inputs=["u"], outputs=["pos", "swing"],
                          states=["pos_", "vel", "ang", "angvel"], params={"ku": 10.6, "b": 10.0})
    structure = _structure(crane, ["V"], ["m", "rad"])
    assert structure.entry[1] == (0, 0, -1) and structure.entry[3][0] == 1
    assert structure.force_units[1] == {"V": 1}


def test_a_start_state_that_only_the_whole_recording_loses_is_no_missing_physics():
    """A charge is counted and never read; from an empty cell nothing leads to where it began."""
    def update(t, x, u, params):
        return np.array([x[0] - 0.001 * u[0], 0.9 * x[1] + 0.1 * params["R"] * u[0]])

    def output(t, x, u, params):
        return np.array([np.interp(x[0], [0.0, 0.3, 1.0], [3.0, 3.6, 4.2]) - x[1]])

    rng, recordings = np.random.default_rng(2), []
    for k, start in enumerate((0.9, 0.55, 0.8)):
        u, x, y = np.repeat(rng.uniform(-0.5, 1.0, 30), 20), np.array([start, 0.0]), []
        for value in u:
            y.append(output(0, x, [value], {})[0])
            x = update(0, x, [value], {"R": 0.05})
        y = np.array(y) + 0.002 * rng.normal(size=len(u))
        recordings.append(Recording(np.arange(len(u)) * 1.0, u[:, None], y[:, None], ("I",), ("U",),
                                    {"I": "A", "U": "V"}, name=f"r{k}.csv"))
    cell = control.nlsys(update, output, inputs=["I"], outputs=["U"], states=["soc", "v1"], params={"R": 0.055}, dt=1.0)
    report = explain(cell, recordings[:2], recordings[2:], ["R"],
                     effects=[e for i in ("sensor_offset", "constant_load", "sensor_drift") for e in effect_by_id(i)])
    assert report.verdict == "parameters_only"


def test_what_acts_on_a_first_order_model_has_the_unit_of_its_state():
    def motor(t, x, u, params):
        return np.array([(params["K"] * u[0] - x[0]) / params["tau"]])

    def driven(t, x, u, params):
        return np.array([(u[0] - params["d"] * x[0]) / params["J"]])

    for rates, params, unit, force, inertia in ((motor, {"K": 10.0, "tau": 0.3}, "V", {"rad": 1, "s": -1}, {"s": 1}),
                                                (driven, {"J": 0.5, "d": 1.0}, "N m", {"N": 1, "m": 1},
                                                 {"kg": 1, "m": 2})):
        simulator = control.nlsys(rates, lambda t, x, u, params: x, inputs=["u"], outputs=["w"], states=["w"],
                                  params=params)
        s = _structure(simulator, [unit], ["rad/s"])
        assert s.kinds == ("velocity",) and s.entry[0][0] == 1
        assert (s.force_units[0], s.inertia_units[0]) == (force, inertia)


def test_states_behind_a_mean_reading_are_of_its_kind():
    A = np.array([[-0.006, 0.005], [0.003, -0.0036]])
    plate = control.ss(A, [[0.001], [0.0]], [[0.0, 1.0], [0.6, 0.4]], 0, inputs=["P"], outputs=["part", "mean"],
                       states=["a", "b"])
    s = _structure(plate, ["W"], ["degC", "degC"])
    assert s.kinds == ("thermal", "thermal") and all(unit == {"degC": 1} for unit in s.state_units)
    apart = control.ss(A, [[0.001], [0.0]], [[0.0, 1.0], [0.6, 0.5]], 0, inputs=["P"], outputs=["part", "mean"],
                       states=["a", "b"])
    assert _structure(apart, ["W"], ["degC", "degC"]).kinds[0] == "abstract"


def test_temperatures_are_absolute_by_their_unit():
    def oven(t, x, u, params):
        return np.array([params["gain"] * u[0] - (x[0] - 20.0) / 500.0])

    for unit, level, zero in (("degC", 600.0, 273.15), ("K", 900.0, 0.0), ("K", 40.0, 293.15), ("degF", 900.0, 459.67)):
        plant = as_plant(control.nlsys(oven, lambda t, x, u, params: x, inputs=["P"], outputs=["T"], states=["T"],
                                       params={"gain": 1.0}))
        rng = np.random.default_rng(0)
        s = find_structure(plant, level + 10.0 * rng.normal(size=(200, 1)), rng.normal(size=(200, 1)),
                           rng.normal(size=(200, 1)), ["W"], [unit], 0.02, 4.0)
        assert [place.constants for place in stores(s, "thermal")] == [(zero,)]


def test_friction_may_grow_with_any_input_and_a_mass_is_never_negative():
    """A conveyor whose carried mass is its second input: forces enter through the drive, friction grows with it."""
    def conveyor(t, x, u, params):
        return np.array([(60.0 * u[0] - params["c"] * x[0]) / (params["m0"] + u[1])])

    plant = as_plant(control.nlsys(conveyor, lambda t, x, u, params: x, inputs=["T", "load"], outputs=["v"],
                                   states=["v"], params={"m0": 180.0, "c": 90.0}))
    rng = np.random.default_rng(0)
    inputs = np.column_stack([rng.normal(size=200), rng.uniform(20.0, 420.0, 200)])
    s = find_structure(plant, rng.normal(size=(200, 1)), inputs, rng.normal(size=(200, 1)), ["N m", "kg"], ["m/s"],
                       0.02, 4.0)
    assert s.entry[0] == (0, 0, -1) and s.force_units[0] == {"N": 1, "m": 1}
    places = s.loaded()
    assert [(p.ii[8], p.variables, p.note) for p in places] == [(0, ("v", "T"), "load: T"), (1, ("v", "load"),
                                                                                          "load: load")]
