"""Laws that change what a force accelerates, beside laws that are forces: both are what they are alone."""

from __future__ import annotations

import itertools
from dataclasses import replace

import control
import numpy as np
import pytest
from tests_support import TRUE, oscillator, record, update

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.effects.registry import CATALOGUE
from pwaid.mismatch.model import Model, Settings
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.probing import find_structure
from pwaid.mismatch.screen import locate_effects

DATA = Dataset.from_recordings([record(1, samples=300)])
FORCES = {"coulomb_friction": [0.4], "viscous_friction": [0.3], "load_dependent_friction": [0.2, 0.1]}


def _placed(simulator, input_unit, output_unit):
    plant = as_plant(simulator)
    nx, _, ny = plant.sizes
    data = replace(DATA, Y=np.repeat(DATA.Y, ny, axis=1))
    s = find_structure(plant, np.random.default_rng(0).normal(size=(64, nx)), data.U, data.Y, [input_unit],
                       [output_unit] * ny, data.sample_time, 6.0, ())
    settings = Settings(plant, s.partner, s.ratio, (), np.zeros(0), substeps=20)
    return locate_effects(CATALOGUE, s), settings, data


def _simulated(simulator, laws, start, units=("N", "m")):
    """Outputs with these laws, {(id, speed or position): values}."""
    everywhere, settings, data = _placed(simulator, *units)
    chosen = [next(e for e in everywhere if e.effect.id == i and signal in (None, e.place.signal)
                   and e.size == len(values)) for (i, signal), values in laws.items()]
    model = Model(settings, tuple(chosen))
    parts = [np.array(v) for v in laws.values()]
    return model.simulate_with(settings.plant.vector(), parts, np.array([start]), data)[0]


@pytest.mark.parametrize("force, turned", list(itertools.product(FORCES, (False, True))))
def test_forces_meet_an_added_mass(force, turned):
    laws = {("missing_inertia", None): [0.3], (force, None): FORCES[force]}
    laws = dict(reversed(laws.items())) if turned else laws
    start = [0.2, 0.1]
    got = _simulated(oscillator(**{**TRUE, "m": 0.7}), laws, start)
    want = _simulated(oscillator(**TRUE), {(force, None): FORCES[force]}, start)
    np.testing.assert_allclose(got, want, atol=1e-6)


def two_masses(t, x, u, params):
    share, w, zeta = 0.4, 9.0, 0.05  # of the inertia 1 kg on a spring whose load side alone has that frequency
    twist, rate = x[2] - x[0], x[3] - x[1]
    pull = w * w * twist + 2.0 * zeta * w * rate
    return np.array([x[1], (u[0] - 0.45 * x[1] - 3.0 * x[0] + share * pull) / (1.0 - share), x[3], -pull])


@pytest.mark.parametrize("force", ["coulomb_friction", "viscous_friction"])
def test_forces_act_on_the_motor_in_front_of_a_hidden_load(force):
    hidden = {("compliance", None): [0.4, 9.0, 0.05], (force, None): FORCES[force]}
    got = _simulated(oscillator(**TRUE), hidden, [0.2, 0.0])
    plain = control.nlsys(two_masses, lambda t, x, u, params: x[:1], inputs=["F"], outputs=["x"],
                          states=["x", "v", "xl", "vl"])
    want = _simulated(plain, {(force, "v"): FORCES[force]}, [0.2, 0.0, 0.2, 0.0])
    assert np.max(np.abs(got - want)) < 2e-3 * np.max(np.abs(want))


def test_the_support_plant_has_no_other_mass():
    assert update(0.0, np.zeros(2), [1.0], TRUE)[1] == 1.0
