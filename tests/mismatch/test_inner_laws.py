"""A law that holds a simpler one at some of its parameters is not named where the simpler one does as well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests_support import oscillator, pushed

from pwaid.mismatch.decide import criterion, decide
from pwaid.mismatch.effects.registry import CATALOGUE, effect_by_id
from pwaid.mismatch.explain import collect
from pwaid.mismatch.hypotheses import inner_laws
from pwaid.mismatch.pairs import _same_knob


@pytest.fixture(scope="module")
def spring():
    """Half of the spring is missing, and the simulator's own is trusted."""
    recordings = [pushed(s, lambda x, v: 0.0, noise=0.05) for s in (1, 2, 3)]
    return collect(oscillator(k=1.5), recordings[:2], recordings[2:], ["m", "b"],
                   effects=[*effect_by_id("hysteretic_spring"), *effect_by_id("linear_stiffness")])


def test_a_spring_is_not_named_as_a_hysteretic_one(spring):
    fitted = {h.ids[0]: h for h in spring.singles}
    assert fitted["hysteretic_spring"].share > 0.9  # it does what a spring does
    decision = decide(spring.problem, spring.null, spring.singles, spring.pairs)
    assert (decision.verdict, decision.chosen.ids) == ("named", ("linear_stiffness",))


def test_equal_fits_are_ordered_by_their_number_of_parameters(spring):
    fitted = {h.ids[0]: h for h in spring.singles}
    wide, narrow = fitted["hysteretic_spring"], fitted["linear_stiffness"]
    assert criterion(spring.problem, replace(narrow, train_error=wide.train_error), wide) < 0
    assert criterion(spring.problem, wide, wide) == 0.0
    assert criterion(spring.problem, wide, narrow) == pytest.approx(-criterion(spring.problem, narrow, wide))


def test_a_hysteretic_spring_hands_its_numbers_to_the_laws_it_becomes():
    effect = next(e for e in CATALOGUE if e.id == "hysteretic_spring" and not e.between)
    values = (3.0, 0.1, 1.0, 0.5)  # N, m
    assert effect.inherit["presliding_friction"](*values) == pytest.approx((3.0, 30.0))
    assert effect.inherit["linear_stiffness"](*values) == pytest.approx((30.0,))
    gravity = next(e for e in CATALOGUE if e.id == "gravity_torque")
    assert gravity.inherit["linear_stiffness"](2.0, np.pi / 3) == pytest.approx((1.0,))


def test_every_start_that_a_law_hands_on_fits_the_law_that_takes_it():
    laws = {e.id: e for e in CATALOGUE if not e.variant and not e.between}
    for outer in CATALOGUE:
        assert set(outer.inherit) <= {*outer.contains, *outer.becomes}
        for inner, part in outer.inherit.items():
            assert len(part(*[1.0] * len(outer.quantities))) == len(laws[inner].quantities)


def test_a_spring_may_stand_beside_a_hysteretic_one_but_not_a_second_hysteresis(spring):
    located = {h.ids[0]: h.located[0] for h in spring.singles}
    wide, narrow = located["hysteretic_spring"], located["linear_stiffness"]
    assert inner_laws(wide, [wide, narrow]) == [narrow]
    assert not _same_knob(wide, narrow)  # Bouc and Wen's law is often written with both
    friction = next(e for e in CATALOGUE if e.id == "presliding_friction" and not e.between)
    assert _same_knob(wide, replace(narrow, effect=friction, place=wide.place))
