"""Simulators that do not compile: arrays in place of scalars, verified, equal to the compiled loop."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.special import erf
from tests_support import oscillator, output, record

from pwaid.mismatch.access import SWEEPS, expected_time
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.effects.registry import CATALOGUE
from pwaid.mismatch.fit import jacobian
from pwaid.mismatch.model import LIMIT, Model, Settings
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.probing import find_structure
from pwaid.mismatch.screen import locate_effects

DATA = Dataset.from_recordings([record(1, samples=90), record(2, samples=60)]).cut(40)
PLANT = as_plant(oscillator())
RNG = np.random.default_rng(0)
STRUCTURE = find_structure(PLANT, RNG.normal(size=(64, 2)), DATA.U, DATA.Y, ["N"], ["m"], 0.02, 1.8, ("m", "b", "k"))
NAMES = ("coulomb_friction", "actuator_lag", "sensor_lag", "input_delay", "presliding_friction", "end_stop",
         "parameter_drift")


def model(name: str, arrays: bool | None, **changes) -> Model:
    """The oscillator with one effect; compiled when `arrays` is None."""
    plant = PLANT if arrays is None else replace(PLANT, rhs=None, out=None, takes_arrays=arrays)
    settings = Settings(plant, STRUCTURE.partner, STRUCTURE.ratio, ("m", "b", "k"), np.full(3, 0.3), substeps=2,
                        **changes)
    return Model(settings, tuple(e for e in locate_effects(CATALOGUE, STRUCTURE) if e.effect.id == name)[:1])


def point(m: Model):
    e = m.located[0]
    z = e.internal([q.probes[0] if q.probes else 1.0 for q in e.effect.quantities])
    return np.concatenate([[0.1, -0.2, 0.05], z]), 0.1 * np.arange(2 * len(DATA.segments)).reshape(-1, 2)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("first_order_hold", [False, True])
def test_columns_equal_the_compiled_loop(name, first_order_hold):
    fast = model(name, None, first_order_hold=first_order_hold)
    theta, X0 = point(fast)
    want = fast.simulate(theta, X0, DATA)
    for arrays in (False, True):
        got = model(name, arrays, first_order_hold=first_order_hold).simulate(theta, X0, DATA)
        np.testing.assert_allclose(got[0], want[0], rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(got[1], want[1], rtol=1e-9, atol=1e-11)


def exact(t, x, u, params):
    """A step of a mass on a spring to second order, with the position moving with the mean speed."""
    v = x[1] + 0.02 / params["m"] * (u[0] - params["b"] * x[1] - params["k"] * (x[0] + 0.01 * x[1]))
    return np.array([x[0] + 0.01 * (x[1] + v), v])


def euler(t, x, u, params):
    v = x[1] + 0.02 / params["m"] * (u[0] - params["b"] * x[1] - params["k"] * x[0])
    return np.array([x[0] + 0.02 * v, v])


@pytest.mark.parametrize("update, share", [(exact, 0.5), (euler, 1.0)])
@pytest.mark.parametrize("name", ["coulomb_friction", "quadratic_drag", "actuator_lag", "end_stop", "input_play"])
def test_columns_equal_the_compiled_loop_for_next_states(update, share, name):
    plant = as_plant(control.nlsys(update, output, inputs=["F"], outputs=["x"], states=["x", "v"],
                                   params={"m": 1.0, "b": 0.4, "k": 3.0}, dt=0.02))
    s = find_structure(plant, RNG.normal(size=(64, 2)), DATA.U, DATA.Y, ["N"], ["m"], 0.02, 1.8, ("m", "b", "k"))
    assert s.share == share
    located = tuple(e for e in locate_effects(CATALOGUE, s) if e.effect.id == name)[:1]
    runs = []
    for p in (plant, replace(plant, rhs=None, out=None, takes_arrays=False)):
        m = Model(Settings(p, s.partner, s.ratio, ("m", "b", "k"), np.full(3, 0.3), share=s.share), located)
        runs.append(m.simulate(*point(m), DATA))
    np.testing.assert_allclose(runs[1][0], runs[0][0], rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(runs[1][1], runs[0][1], rtol=1e-9, atol=1e-11)


def test_many_simulations_in_one_sweep_give_the_same_jacobian():
    fast, slow = model("coulomb_friction", None), model("coulomb_friction", True)
    theta, X0 = point(fast)
    Y = fast.simulate(theta, X0, DATA)[0]
    want, got = (jacobian(m, theta, X0, DATA, np.ones(1), Y, np.ones(2)) for m in (fast, slow))
    np.testing.assert_allclose(got.G, want.G, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(got.S, want.S, rtol=1e-6, atol=1e-9)


def test_what_runs_away_is_filled_and_the_rest_goes_on():
    slow = model("coulomb_friction", True)
    theta, X0 = point(slow)
    X0[1] = 2e9
    Y, _ = slow.simulate(theta, X0, DATA)
    a, b = DATA.segments[1, :2]
    assert np.all(Y[a + 1:b] == LIMIT)
    assert np.all(np.abs(np.delete(Y, np.arange(a, b))) < 100)


def system(update):
    return control.nlsys(update, output, inputs=["F"], outputs=["x"], states=["x", "v"],
                         params={"m": 1.1, "b": 0.5, "k": 3.2})


def with_a_dict(t, x, u, params):
    s = dict(zip(("x", "v"), x, strict=True))
    return np.array([s["v"], (u[0] - params["b"] * s["v"] - params["k"] * erf(s["x"])) / params["m"]])


def with_a_branch(t, x, u, params):
    s = dict(zip(("x", "v"), x, strict=True))
    return np.array([s["v"], -params["k"] * erf(s["x"]) if s["x"] > 0 else u[0]])


def with_a_sum(t, x, u, params):
    s = dict(zip(("x", "v"), x, strict=True))
    return np.array([s["v"], u[0] - params["k"] * np.max(np.abs(erf(s["x"])))])  # over all columns with arrays: wrong


@pytest.mark.parametrize(("update", "arrays"), [(with_a_dict, True), (with_a_branch, False), (with_a_sum, False)])
def test_arrays_are_used_only_when_they_give_the_same(update, arrays):
    plant = as_plant(system(update))
    assert plant.rhs is None and plant.takes_arrays == arrays
    assert any("runs in Python" in n for n in plant.notes)
    X, U, P = RNG.normal(size=(5, 2)), RNG.normal(size=(5, 1)), np.tile(plant.vector(), (5, 1))
    want = np.array([update(0.0, x, u, plant.as_dict(plant.vector())) for x, u in zip(X, U, strict=True)])
    np.testing.assert_allclose(plant.derivatives(np.zeros(5), X, U, P), want)


def test_a_point_outside_the_domain_is_nan_and_its_neighbours_are_not():
    def table(t, x, u, params):
        if np.any(np.abs(x[0]) > 30.0):
            raise ValueError("beyond the table")
        return with_a_dict(t, x, u, params)

    plant = as_plant(system(table))
    assert plant.takes_arrays
    found = plant.derivatives(np.zeros(2), np.array([[1.0, 0.0], [50.0, 0.0]]), np.zeros((2, 1)),
                              np.tile(plant.vector(), (2, 1)))
    assert np.all(np.isfinite(found[0])) and np.all(np.isnan(found[1]))
    assert plant.raised == {"ValueError: beyond the table"}


def test_how_long_it_takes_is_said(monkeypatch):
    long = Dataset.from_recordings([record(1, samples=20000)])
    text = expected_time(as_plant(system(with_a_branch)), long)
    assert "expect about" in text and f"{SWEEPS} simulations" in text
    assert expected_time(PLANT, long) == ""
    assert expected_time(as_plant(lambda u: u, ("F",), ("x",)), DATA) == ""
