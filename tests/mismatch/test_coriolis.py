"""Coriolis torque from the inertia that a simulator shows, against Lagrange's equations of arms done by hand."""

from __future__ import annotations

import control
import numpy as np
import pytest

from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.inertia import _is_inertia, shown_inertia
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.probing import find_structure
from pwaid.mismatch.screen import locate_effects

ARM = {"a": 2.0, "b": 0.7, "c": 0.5, "f1": 0.8, "f2": 0.3}


def arm_update(t, x, u, params):
    """Two rigid links without Coriolis torque: M(q2) dv = torque - friction, states q1, q2, v1, v2."""
    k = params["b"] * np.cos(x[1])
    m11, m12, m22 = params["a"] + 2 * k, params["c"] + k, params["c"]
    g1, g2 = u[0] - params["f1"] * x[2], u[1] - params["f2"] * x[3]
    d = m11 * m22 - m12 * m12
    return np.array([x[2], x[3], (m22 * g1 - m12 * g2) / d, (m11 * g2 - m12 * g1) / d])


def crank_update(t, x, u, params):
    """One joint whose inertia is J + m cos 2q, with friction."""
    return np.array([x[1], (u[0] - params["f"] * x[1]) / (params["J"] + params["m"] * np.cos(2 * x[0]))])


def drive_update(t, x, u, params):
    """One joint of constant inertia on a soft spring."""
    return np.array([x[1], (u[0] - params["f"] * x[1] - params["k"] * x[0]) / params["J"]])


def output(t, x, u, params):
    return x[:len(x) // 2]


def structure(update, params, free=(), unit="rad"):
    n = 2 if "f1" in params else 1
    names = [f"q{i}" for i in range(n)] + [f"v{i}" for i in range(n)]
    inputs, outputs = [f"T{i}" for i in range(n)], [f"y{i}" for i in range(n)]
    plant = as_plant(control.nlsys(update, output, inputs=inputs, outputs=outputs, states=names, params=params))
    states = np.random.default_rng(0).uniform(-1.2, 1.6, (400, 2 * n))
    states[:, :n] *= 180 / np.pi if unit == "deg" else 1.0
    return find_structure(plant, states, np.ones((400, n)), states[:, :n], ["N m"] * n, [unit] * n, 0.01, 4.0, free)


def acceleration(s, x, p, coefficient=1.0):
    """What the located law adds to dx/dt."""
    located = [e for e in locate_effects(effect_by_id("coriolis_torque"), s) if e.effect.quantities[0].size == "1"]
    assert len(located) == 1
    place, dx = located[0].place, np.zeros(len(x))
    q = np.array([coefficient, *place.constants])
    located[0].effect.compiled()(2, 0.0, 0.0, x, x, np.zeros(len(x) // 2), p, dx, np.array(place.ii), q)
    return dx


def test_two_links_get_the_torques_of_lagrange_for_changed_parameters_too():
    s = structure(arm_update, ARM, free=("a", "b", "f1"))
    x = np.array([0.4, 0.9, 1.3, -2.1])
    for b in (0.7, 0.8):
        k, h = b * np.cos(x[1]), b * np.sin(x[1])
        M = np.array([[ARM["a"] + 2 * k, ARM["c"] + k], [ARM["c"] + k, ARM["c"]]])
        torque = np.array([-h * (2 * x[2] * x[3] + x[3] ** 2), h * x[2] ** 2])
        p = np.array([*(ARM | {"b": b}).values()])
        np.testing.assert_allclose(acceleration(s, x, p)[2:], -np.linalg.solve(M, torque), rtol=1e-6)


def test_one_joint_of_varying_inertia_conserves_energy():
    params = {"J": 2.0, "m": 0.6, "f": 0.4}
    s = structure(crank_update, params)
    x, p = np.array([0.5, 1.7]), np.array([*params.values()])
    M, slope = 2.0 + 0.6 * np.cos(1.0), -1.2 * np.sin(1.0)
    assert acceleration(s, x, p)[1] == pytest.approx(-0.5 * slope * x[1] ** 2 / M, rel=1e-6)


def test_degrees_are_turned_into_radians():
    """The same arm with angles in degrees: M of 60 deg is that of pi / 3."""

    def in_degrees(t, x, u, params):
        scaled = np.array([x[0] * np.pi / 180, x[1] * np.pi / 180, x[2], x[3]])
        rate = arm_update(t, scaled, u, params)
        return np.array([rate[0] * 180 / np.pi, rate[1] * 180 / np.pi, rate[2], rate[3]])

    s = structure(in_degrees, ARM, unit="deg")
    shown = shown_inertia(s)[0]
    assert shown.turn == pytest.approx(np.pi / 180)
    M = shown.matrix(60.0)
    assert M[0, 1] / M[1, 1] == pytest.approx((0.5 + 0.7 * 0.5) / 0.5, rel=1e-6)


def test_constant_inertia_shows_no_place():
    s = structure(drive_update, {"J": 2.0, "f": 0.4, "k": 1.0})
    assert shown_inertia(s) == []


def test_an_actuator_that_weakens_with_position_is_no_varying_inertia():
    def magnet(t, x, u, params):
        return np.array([x[1], (u[0] / (3.0 + np.cos(x[0])) - params["f"] * x[1]) / params["J"]])

    assert shown_inertia(structure(magnet, {"J": 2.0, "f": 0.4})) == []


def test_products_of_speeds_remain_in_the_catalogue_for_two_axes():
    places = [e.place for e in locate_effects(effect_by_id("coriolis_torque"), structure(arm_update, ARM))
              if e.effect.quantities[0].size != "1"]
    assert {"v0", "v1"} <= {v for p in places for v in p.variables}
    assert any("sin(q1)" in p.variables for p in places)


def test_a_singular_coupling_is_no_inertia():
    assert not _is_inertia(np.ones((3, 2, 2)))
    assert _is_inertia(np.tile([[2.0, 1.0], [1.0, 2.0]], (3, 1, 1)))
