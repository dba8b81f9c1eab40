"""Simulators whose outputs are in other units than their states, as machines have them: mm, rpm, bar, °C."""

from __future__ import annotations

import control
import numpy as np
import pytest
from tests_support import output, update

from pwaid.mismatch.beginnings import first_states
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.explain import collect
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.probing import find_structure
from pwaid.recording import Recording

RNG = np.random.default_rng(0)


def structure(system, input_units, output_units, scale=1.0):
    plant = as_plant(system)
    nx, nu, ny = plant.sizes
    states = scale * RNG.uniform(0.2, 1.0, (64, nx))
    Y = np.array([plant.outputs(x, np.zeros(nu)) for x in states])
    return find_structure(plant, states, RNG.normal(size=(64, nu)), Y, input_units, output_units, 0.01, 1.0)


def motor(t, x, u, params):
    return [x[1], (u[0] - params["b"] * x[1]) / params["J"]]


def oven(t, x, u, params):
    return [(u[0] - params["k"] * (x[0] - 293.15)) / params["C"]]


def screw(t, x, u, params):
    way = 10.0 / (2 * np.pi)  # mm/rad
    return [x[1], way * (u[0] - params["d"] * x[1] / way) / params["J"]]


def system(update, see, states, outputs, **params):
    return control.nlsys(update, see, inputs=["u"], states=states, outputs=outputs, params=params)


def twisted(t, x, u, params):
    shaft = params["k"] * x[2] + 0.1 * (x[0] - x[1])
    return [(u[0] - shaft) / params["Jm"], (shaft - params["b"] * x[1]) / params["Jl"], x[0] - x[1]]


def test_the_far_end_of_a_twisted_shaft_is_a_speed():
    s = structure(system(twisted, lambda t, x, u, p: [x[0] * 30 / np.pi], ["a", "c", "twist"], ["n"], k=40.0, Jm=1.0,
                         Jl=2.0, b=0.2), ["N m"], ["rpm"])
    assert s.kinds[:2] == ("velocity", "velocity") and s.kinds[2] not in ("velocity", "store")
    assert s.state_units[1] == {"rad": 1, "s": -1} and s.entry[1] == (1, 1, 2)


def test_a_speed_in_rpm_keeps_its_unit_beside_an_angle_in_degrees():
    def table(t, x, u, params):
        return [6.0 * x[1], (u[0] - params["b"] * x[1]) / params["J"] * 30 / np.pi]

    s = structure(system(table, lambda t, x, u, p: x, ["phi", "n"], ["angle", "speed"], J=0.05, b=0.005), ["N m"],
                  ["deg", "rpm"])
    assert s.state_units == ({"deg": 1}, {"rev": 1, "min": -1}) and s.force_units[1] == {"N": 1, "m": 1}
    alone = structure(system(table, lambda t, x, u, p: x[:1], ["phi", "n"], ["angle"], J=0.05, b=0.005), ["N m"],
                      ["deg"])
    assert alone.state_units[1] != {"deg": 1, "s": -1}  # six times its rate


def test_states_and_units_follow_the_gain_of_an_output():
    s = structure(system(motor, lambda t, x, u, p: np.array([np.rad2deg(x[0]), x[1] * 30 / np.pi]), ["q", "w"],
                         ["angle", "speed"], J=0.1, b=0.2), ["N m"], ["deg", "rpm"])
    assert s.output_state == (0, 1) and s.state_units == ({"rad": 1}, {"rad": 1, "s": -1})
    np.testing.assert_allclose(s.shown.state_of(0, np.array([180.0])), np.pi)
    np.testing.assert_allclose(s.shown.state_of(1, np.array([60.0])), 2 * np.pi)


def test_an_offset_belongs_to_the_output():
    s = structure(system(oven, lambda t, x, u, p: [x[0] - 273.15], ["T"], ["y"], k=0.5, C=9.0), ["W"], ["degC"], 300.0)
    assert s.output_state == (0,) and s.state_units == ({"K": 1},) and s.kinds == ("thermal",)
    np.testing.assert_allclose(s.shown.state_of(0, 20.0), 293.15)


def test_a_force_on_a_speed_in_millimetres_goes_through_the_torque():
    s = structure(system(screw, lambda t, x, u, p: [x[0]], ["pos", "vel"], ["pos"], J=2e-4, d=2e-3), ["N m"], ["mm"])
    assert s.entry[1] == (0, 0, -1) and s.force_units[1] == {"N": 1, "m": 1}
    si = structure(system(motor, lambda t, x, u, p: [x[0]], ["q", "w"], ["angle"], J=0.1, b=0.2), ["N m"], ["rad"])
    assert si.entry[1] == (1, 1, 0)


@pytest.mark.parametrize("gain", [1.0, 1e3, -1e3])
def test_start_states_come_from_outputs_in_any_unit(gain):
    plant = control.nlsys(update, lambda t, x, u, params: gain * np.asarray(output(t, x, u, params)), inputs=["F"],
                          outputs=["y"], states=["x", "v"], params={"m": 1.0, "b": 0.4, "k": 3.0})
    t = np.arange(60) * 0.02
    recording = Recording(t, np.zeros((60, 1)), gain * np.cos(t)[:, None], ("F",), ("y",), {"F": "N", "y": "mm"})
    data = Dataset.from_recordings([recording])
    s = structure(plant, ["N"], ["mm" if abs(gain) > 1 else "m"])
    x0 = first_states(as_plant(plant), s.start_map, data)[0]
    assert x0[0] == pytest.approx(1.0, abs=0.02) and x0[1] == pytest.approx(0.0, abs=0.3)


def test_an_effect_is_found_behind_an_output_in_other_units():
    """Coulomb friction of a motor whose angle is read in degrees: level in N m, as with an angle in rad."""
    rng = np.random.default_rng(3)
    recordings = []
    for k in range(2):
        t = np.arange(900) * 0.01
        u = (0.8 * np.sin(2 * np.pi * np.outer(t, rng.uniform(0.2, 2.0, 6)) + rng.uniform(0, 6.28, 6))).sum(axis=1)
        q, w, y = 0.3, 0.0, []
        for a in u:
            y.append(np.rad2deg(q))
            for _ in range(20):
                smooth = a - 0.5 * w
                sign = np.sign(w) if w else np.sign(smooth)
                new = w if not w and abs(smooth) < 0.3 else w + 5e-4 * (smooth - 0.3 * sign) / 0.1
                w, q = 0.0 if new * sign < 0 else new, q + 5e-4 * w
        y = np.array(y) + 0.2 * rng.normal(size=900)
        recordings.append(Recording(t, u[:, None], y[:, None], ("T",), ("angle",), {"T": "N m", "angle": "deg"},
                                    name=f"r{k}"))
    simulator = control.nlsys(motor, lambda t, x, u, p: [np.rad2deg(x[0])], inputs=["T"], outputs=["angle"],
                              states=["q", "w"], params={"J": 0.11, "b": 0.45})
    evidence = collect(simulator, recordings[:1], recordings[1:])
    best = evidence.singles[0]
    assert best.ids == ("coulomb_friction",) or "coulomb_friction" in best.located[0].effect.contains
    friction = next(h for h in evidence.singles if h.ids == ("coulomb_friction",))
    assert friction.share > 0.95 and friction.values()[0][0] == pytest.approx(0.3, rel=0.03)
    assert friction.located[0].units() == ["N m"]


def test_a_force_over_an_inertia_has_the_unit_of_a_speed_in_millimetres():
    """A pressure moves a rod: nothing but the inertia tells the force, and m dv/dt is in kg mm/s^2."""
    def rod(t, x, u, params):
        return np.array([x[1], (5e4 * u[0] - params["k"] * x[0] - params["c"] * x[1]) / params["m"]])

    cylinder = system(rod, lambda t, x, u, p: x[:1], ["x", "v"], ["y"], m=1.7, k=640.0, c=27.0)
    s = structure(cylinder, ["bar"], ["mm"], 20.0)
    assert s.entry[1] == (1, 1, 0)
    assert s.force_units[1] == {"kg": 1, "mm": 1, "s": -2} and s.inertia_units[1] == {"kg": 1}
