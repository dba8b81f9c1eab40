"""The compiled loop against exact solutions and against the plain loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from tests_support import oscillator, record

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.effects.registry import CATALOGUE
from pwaid.mismatch.model import Model, Settings
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.probing import find_structure
from pwaid.mismatch.screen import locate_effects

DATA = Dataset.from_recordings([record(1, samples=200)])
PLANT = as_plant(oscillator())


def structure(plant=PLANT, data=DATA):
    rng = np.random.default_rng(0)
    return find_structure(plant, rng.normal(size=(64, 2)), data.U, data.Y, ["N"], ["m"], data.sample_time,
                          4.0,
                          ("m", "b", "k"))


def settings(plant=PLANT):
    s = structure()
    return Settings(plant, s.partner, s.ratio, ("m", "b", "k"), np.full(3, 0.3), substeps=2)


def test_linear_plant_matches_the_matrix_exponential():
    Y, _ = Model(settings(), (), 8).simulate(np.zeros(3), np.zeros((1, 2)), DATA)
    m, b, k = 1.1, 0.5, 3.2
    M = expm(np.array([[0, 1, 0], [-k / m, -b / m, 1 / m], [0, 0, 0]]) * DATA.sample_time)
    x, want = np.zeros(2), []
    for u in DATA.U[:, 0]:
        want.append(x[0])
        x = M[:2, :2] @ x + M[:2, 2] * u
    np.testing.assert_allclose(Y[:, 0], want, atol=1e-8)


@pytest.mark.parametrize("name", ["coulomb_friction", "stribeck_friction", "presliding_friction",
                                  "actuator_lag",
                                  "input_play", "end_stop", "compliance", "sensor_lag",
                                  "actuator_rate_limit"])
def test_compiled_loop_equals_plain_loop(name):
    located = next(e for e in locate_effects(CATALOGUE, structure()) if e.effect.id == name)
    z = located.internal([q.probes[0] for q in located.effect.quantities])
    theta = np.concatenate([np.zeros(3), z])
    fast = Model(settings(), (located,)).simulate(theta, np.zeros((1, 2)), DATA)[0]
    slow_plant = replace(PLANT, rhs=None, out=None)
    slow = Model(replace(settings(), plant=slow_plant), (located,)).simulate(theta, np.zeros((1, 2)), DATA)[0]
    np.testing.assert_allclose(fast, slow, rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("rhs", [PLANT.rhs, None])
@pytest.mark.parametrize("name", ["coulomb_friction", "input_delay", "end_stop", "actuator_lag", "input_play"])
def test_several_simulations_in_one_call_equal_single_ones(name, rhs):
    located = next(e for e in locate_effects(CATALOGUE, structure()) if e.effect.id == name)
    plant = replace(PLANT, rhs=rhs, out=PLANT.out if rhs else None)
    model = Model(replace(settings(), plant=plant), (located,))
    z = located.internal([q.probes[0] for q in located.effect.quantities])
    asked = [(np.concatenate([np.full(3, d), z]), np.full((1, 2), x)) for d, x in ((0.0, 0.0), (0.2, 0.5), (0.0, 1e9))]
    for many, (theta, X0) in zip(model.simulate_many(asked, DATA), asked, strict=True):
        np.testing.assert_array_equal(many, model.simulate(theta, X0, DATA)[0])


def test_friction_above_the_force_sticks_exactly():
    located = next(e for e in locate_effects(CATALOGUE, structure()) if e.effect.id == "coulomb_friction")
    level = 1.5 * np.max(np.abs(DATA.U))
    theta = np.concatenate([np.zeros(3), located.from_physical([level])])
    Y, _ = Model(settings(), (located,)).simulate(theta, np.zeros((1, 2)), DATA)
    assert np.all(Y == 0.0)


@pytest.mark.parametrize("rhs", [PLANT.rhs, None])
def test_a_body_that_friction_stops_anywhere_in_a_step_stays(rhs):
    """It comes to rest after any share of a substep; no stage of a step may turn friction round early."""
    located = next(e for e in locate_effects(CATALOGUE, structure()) if e.effect.id == "coulomb_friction")
    theta = np.concatenate([np.zeros(3), located.from_physical([0.35])])
    data = replace(DATA, U=np.full((3, 1), 0.26), Y=np.zeros((3, 1)), segments=np.array([[0, 3, 0, 3]]))
    plant = replace(PLANT, rhs=rhs, out=PLANT.out if rhs else None)
    for substeps in (1, 2):
        model = Model(replace(settings(), plant=plant), (located,), substeps)
        for speed in np.linspace(1e-4, 1.4e-3, 27):  # at rest within a sample
            X = model.simulate(theta, np.array([[0.0, speed]]), data)[1]
            assert np.all(X[1:, 1] == 0.0), (substeps, speed)


def test_every_effect_vanishes_towards_its_neutral_value():
    """A law a millionth of its size changes the outputs by next to nothing: injection adds nothing of its own."""
    base = Model(settings(), ()).simulate(np.zeros(3), np.zeros((1, 2)), DATA)[0]
    skip = ("sensor_rectification", "actuator_saturation", "actuator_rate_limit", "end_stop", "overflow",
            "sensor_saturation")  # their neutral value is at the far end
    for located in locate_effects(CATALOGUE, structure()):
        if located.effect.id in skip or not located.effect.quantities or located.place.note == "load side measured":
            continue  # behind a spring, the measured side moves however light the load is
        tiny = [i == 0 or q.size.startswith("force") or q.name in ("load_factor", "load_share")
                for i, q in enumerate(located.effect.quantities)]
        multiples = [(q.probes[0] if q.probes else 1.0) * (1e-6 if small else 1.0)
                     for q, small in zip(located.effect.quantities, tiny, strict=True)]
        if located.effect.id == "periodic_disturbance":
            multiples = [1.0, 1e-6, 0.0]
        theta = np.concatenate([np.zeros(3), located.internal(multiples)])
        Y, _ = Model(settings(), (located,)).simulate(theta, np.zeros((1, 2)), DATA)
        assert np.max(np.abs(Y - base)) < 5e-3 * np.max(np.abs(base)), located.label


def _law(name):
    return next(e for e in locate_effects(CATALOGUE, structure()) if e.effect.id == name)


def _run(laws, values, U=None, plant=PLANT):
    """Outputs with these laws, their parameters given in their units."""
    data = DATA if U is None else replace(DATA, U=U)
    z = [law.from_physical(v) for law, v in zip(laws, values, strict=True)]
    model = Model(replace(settings(), plant=plant), tuple(laws))
    return model.simulate(np.concatenate([np.zeros(3), *z]), np.zeros((1, 2)), data)[0]


@pytest.mark.parametrize("plant", [PLANT, replace(PLANT, rhs=None, out=None)])
@pytest.mark.parametrize("name", ["actuator_lag", "input_play", "actuator_rate_limit"])
def test_a_law_with_memory_follows_the_one_before_it(name, plant):
    clip, memory = _law("actuator_saturation"), _law(name)
    size = [0.15] if name != "actuator_rate_limit" else [4.0]
    both = _run((clip, memory), ([0.8], size), plant=plant)
    np.testing.assert_allclose(both, _run((memory,), (size,), np.clip(DATA.U, -0.8, 0.8)), rtol=1e-9, atol=1e-12)
    assert np.max(np.abs(both - _run((memory,), (size,)))) > 1e-2
    assert np.max(np.abs(both - _run((memory, clip), (size, [0.8]), plant=plant))) > 1e-3


@pytest.mark.parametrize("plant", [PLANT, replace(PLANT, rhs=None, out=None)])
def test_a_force_through_an_input_is_no_command(plant):
    load, lag = _law("constant_load"), _law("actuator_lag")
    through = replace(load, place=replace(load.place, ii=(load.place.ii[0], 0, 0, *load.place.ii[3:])))
    want = _run((load, lag), ([0.4], [0.2]))
    for laws, values in (((through, lag), ([0.4], [0.2])), ((lag, through), ([0.2], [0.4]))):
        np.testing.assert_allclose(_run(laws, values, plant=plant), want, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ["actuator_lag", "input_play", "actuator_rate_limit"])
def test_the_memory_of_an_input_goes_on_from_segment_to_segment(name):
    law = _law(name)
    model = Model(settings(), (law,))
    theta = np.concatenate([np.zeros(3), law.internal([q.probes[0] for q in law.effect.quantities])])
    Y, X = model.simulate(theta, np.zeros((1, 2)), DATA)
    cut = DATA.cut(40)
    starts = X[cut.segments[:, 0], :2]
    np.testing.assert_allclose(model.simulate(theta, starts, cut)[0], Y, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(model.simulate_many([(theta, starts)], cut)[0], Y, rtol=1e-12, atol=1e-13)
    apart = replace(cut, segments=np.column_stack([cut.segments[:, :2]] * 2))  # as recordings of their own
    assert np.max(np.abs(model.simulate(theta, starts, apart)[0] - Y)) > 1e-4
