"""Outputs that show an acceleration: laws that are left out change them too."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from tests_support import TRUE, multisine, output, update

from pwaid.mismatch.accelerometers import rates_shown
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.effects.registry import CATALOGUE
from pwaid.mismatch.explain import explain
from pwaid.mismatch.model import Model, Settings
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.probing import find_structure
from pwaid.mismatch.screen import locate_effects
from pwaid.recording import Recording

GRAVITY = 9.81
NOMINAL = {"m": 1.1, "b": 0.5, "k": 3.2}


def shaken(t, x, u, params):
    """An accelerometer on the mass, in units of gravity."""
    return update(t, x, u, params)[1:] / GRAVITY


def both(t, x, u, params):
    return np.array([x[0], update(t, x, u, params)[1] / GRAVITY])


def sensed(outfcn, *names, **more):
    return control.nlsys(update, outfcn, inputs=["F"], outputs=list(names), states=["x", "v"], params=NOMINAL, **more)


def structure_of(simulator, data, units):
    states = np.random.default_rng(0).normal(size=(64, 2))
    return find_structure(as_plant(simulator), states, data.U, data.Y, ["N"], units, data.sample_time,
                          len(data.U) * data.sample_time, tuple(NOMINAL))


def recording(seed: int, samples: int, dt: float) -> Recording:
    """A multisine without a response."""
    t = dt * np.arange(samples)
    u = multisine(np.random.default_rng(seed), t, 1.5)
    return Recording(t, u[:, None], u[:, None], ("F",), ("a",), {"F": "N", "a": "g"}, name=f"r{seed}.csv")


def model(name: str, data, python: bool = False) -> Model:
    simulator = sensed(shaken, "a")
    s = structure_of(simulator, data, ["g"])
    plant = replace(s.plant, rhs=None, out=None, takes_arrays=False) if python else s.plant
    settings = Settings(plant, s.partner, s.ratio, tuple(NOMINAL), np.full(3, 0.3), substeps=2,
                        rates_shown=rates_shown(s))
    return Model(settings, tuple(e for e in locate_effects(CATALOGUE, s) if e.effect.id == name)[:1])


def start_of(m: Model, multiple: float = 1.0):
    return np.concatenate([np.zeros(3), m.located[0].internal([multiple] * m.located[0].size)]), np.array([[0.4, 0.0]])


def test_an_output_that_is_an_acceleration_is_seen_with_its_gain():
    data = Dataset.from_recordings([recording(0, 60, 0.02)])
    two = replace(data, Y=np.repeat(data.Y, 2, axis=1))
    assert rates_shown(structure_of(sensed(both, "x", "a"), two, ["m", "g"])) == (
        (1, 1, pytest.approx(1 / GRAVITY, rel=1e-7)),)
    assert rates_shown(structure_of(sensed(output, "x"), data, ["m"])) == ()
    assert rates_shown(structure_of(sensed(shaken, "a", dt=0.02), data, ["g"])) == ()


def test_a_load_cell_under_a_body_shows_its_rate_and_a_shaft_does_not():
    def structure(rates, outfcn, units, params, free, nx):
        plant = as_plant(control.nlsys(rates, outfcn, inputs=["F"], outputs=["y"], states=["x", "v", "xl", "vl"][:nx],
                                       params=params))
        rng = np.random.default_rng(0)
        return find_structure(plant, rng.normal(size=(64, nx)), rng.normal(size=(64, 1)), rng.normal(size=(64, 1)),
                              ["N"], [units], 0.02, 4.0, free)

    def shaft(t, x, u, params):
        pull = 40.0 * (x[0] - x[2])
        return np.array([x[1], (u[0] - pull) / params["m"], x[3], pull / 2.0])

    def base(t, x, u, params):
        return np.array([params["b"] * x[1] + params["k"] * x[0]])

    assert rates_shown(structure(update, base, "N", NOMINAL, ("b", "k"), 2)) == ((0, 1, pytest.approx(-1.1)),)
    assert rates_shown(structure(update, base, "N", NOMINAL, ("m", "b"), 2)) == ()  # the gain would be that of m
    force = structure(shaft, lambda t, x, u, params: np.array([40.0 * (x[0] - x[2])]), "N", {"m": 1.0}, (), 4)
    assert rates_shown(force) == ()


@pytest.mark.parametrize(("name", "multiple"), [("coulomb_friction", 1.0), ("cubic_stiffness", 30.0)])
def test_the_acceleration_is_that_of_the_speed_and_none_at_rest(name, multiple):
    data = Dataset.from_recordings([recording(1, 4000, 1e-3)])
    m = model(name, data)
    theta, X0 = start_of(m, multiple)
    a, X = m.simulate(theta, X0, data)
    a, v = a[:, 0], X[:, 1]
    rest = v == 0.0
    assert rest[1:].any() == (name == "coulomb_friction")
    assert np.all(np.abs(a[1:][rest[1:] & rest[:-1]]) < 1e-9)
    slopes = np.diff(v) / data.sample_time / GRAVITY
    smooth = np.sign(v[1:]) * np.sign(v[:-1]) > 0
    np.testing.assert_allclose(a[:-1][smooth], slopes[smooth], atol=5e-3 * np.max(np.abs(a)))
    alone = Model(m.settings).simulate(theta[:3], X0, data)[0][:, 0]
    assert np.max(np.abs(a - alone)) > 0.1 * np.max(np.abs(a))


@pytest.mark.parametrize("name", ["coulomb_friction", "cubic_stiffness", "actuator_lag", "presliding_friction"])
def test_a_simulator_in_python_shows_the_same(name):
    data = Dataset.from_recordings([recording(2, 60, 0.02)])
    fast, slow = model(name, data), model(name, data, python=True)
    for got, want in zip(slow.simulate(*start_of(slow), data), fast.simulate(*start_of(fast), data), strict=True):
        np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-10)


def shaken_with_friction(seed: int, level: float, samples: int = 900, dt: float = 0.02, fine: int = 40) -> Recording:
    """The true mass, exact at rest: its position and what its accelerometer reads."""
    r, rng = recording(seed, samples, dt), np.random.default_rng(seed)
    x, v, h, y = 0.1, 0.0, dt / fine, np.empty((samples, 2))
    for k, force in enumerate(r.inputs[:, 0]):
        for j in range(fine):
            smooth = (force - TRUE["b"] * v - TRUE["k"] * x) / TRUE["m"]
            sign = np.sign(v) if v != 0.0 else np.sign(smooth)
            rate = 0.0 if v == 0.0 and abs(smooth) <= level / TRUE["m"] else smooth - level / TRUE["m"] * sign
            if j == 0:
                y[k] = x, rate / GRAVITY
            new = v + h * rate
            new = 0.0 if new * sign < 0.0 else new
            x, v = x + 0.5 * h * (v + new), new
    return Recording(r.time, r.inputs, y + 2e-3 * rng.normal(size=y.shape), ("F",), ("x", "a"),
                     {"F": "N", "x": "m", "a": "g"}, name=r.name)


def test_friction_is_named_beside_an_accelerometer():
    """Friction is in the reading and in the motion behind it."""
    train, test = [shaken_with_friction(s, 0.35) for s in (3, 4)], [shaken_with_friction(5, 0.35)]
    report = explain(sensed(both, "x", "a"), train, test)
    assert report.verdict == "named", report.summary
    assert [e["id"] for e in report.effects] == ["coulomb_friction"]
    assert report.effects[0]["parameters"]["level"]["value"] == pytest.approx(0.35, rel=0.05)
