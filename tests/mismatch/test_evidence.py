"""Which effects are fitted: those the screen puts first and, short of the floor, the others too."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from tests_support import gathered, pushed, record

from pwaid.errors import InputError
from pwaid.mismatch import evidence as module
from pwaid.mismatch.decide import decide
from pwaid.mismatch.hypotheses import floor_square
from pwaid.mismatch.screen import other_laws, overlooked, shortlist

explaining = sys.modules["pwaid.mismatch.explain"]  # the name of the module is that of its function
IDS = ("coulomb_friction", "actuator_lag", "sensor_offset", "cubic_stiffness")


def test_an_effect_that_the_screen_puts_last_is_found(monkeypatch):
    monkeypatch.setattr(module, "shortlist", lambda screened: [
        s for s in screened if s.located.effect.id != "coulomb_friction"][:2])
    found = gathered([record(s, level=0.3) for s in (1, 2, 3)], *IDS)
    decision = decide(found.problem, found.null, found.singles, found.pairs)
    assert (decision.verdict, decision.chosen.ids) == ("named", ("coulomb_friction",))


def test_where_an_effect_reaches_the_floor_no_other_is_looked_for(monkeypatch):
    asked = []
    monkeypatch.setattr(module, "overlooked", lambda *args: asked.append(args) or [])
    gathered([record(s, level=0.3) for s in (1, 2, 3)], *IDS)
    assert not asked


def test_when_the_time_is_over_the_best_law_is_fitted_and_the_rest_is_said_to_be_untried():
    def both(x, v):
        return -1.5 * x**3 - 0.6 * v * abs(v)

    recordings, ids = [pushed(s, both) for s in (1, 2, 3)], ("cubic_stiffness", "quadratic_drag", "coulomb_friction")
    patient, hasty = (gathered(recordings, *ids, minutes=m) for m in (None, 1e-6))
    assert len(patient.singles) > 1 and patient.pairs and module.STOPPED not in patient.notes
    assert len(hasty.singles) == 1 and not hasty.pairs and module.STOPPED in hasty.notes
    assert hasty.singles[0].ids[0] == hasty.screened[0].located.effect.id
    assert decide(hasty.problem, hasty.null, hasty.singles, hasty.pairs).verdict == "unexplained"


@pytest.mark.parametrize("minutes", [0.0, -1.0, float("nan")])
def test_no_time_at_all_is_refused(minutes):
    with pytest.raises(InputError, match="positive number"):
        gathered([record(s) for s in (1, 2, 3)], "coulomb_friction", minutes=minutes)


def test_the_best_place_of_every_effect_left_out_is_looked_at():
    found = gathered([record(s, level=0.3) for s in (1, 2, 3)], *IDS)
    alive = [s for s in found.screened if s.score > 0]
    rest = overlooked(found.screened, alive[:1])
    ids = [s.located.effect.id for s in rest]
    assert alive[0].located.effect.id not in ids and len(set(ids)) == len(ids)
    assert set(ids) | {alive[0].located.effect.id} == {s.located.effect.id for s in alive}
    assert all(s.score == max(a.score for a in alive if a.located.effect.id == s.located.effect.id) for s in rest)


def test_the_other_law_of_an_effect_is_fitted_beside_it():
    """A sensor's curve has a square and a cube; where one is chosen the other is too, once, at its best place."""
    found = gathered([record(s, level=0.3) for s in (1, 2, 3)], "sensor_nonlinearity", "cubic_stiffness")
    alive = [s for s in found.screened if s.score > 0]
    curves = [s for s in alive if s.located.effect.id == "sensor_nonlinearity"]
    assert len({s.located.effect.law for s in curves}) == 2
    assert other_laws(curves[:1], alive) == [next(s for s in curves if s.located.effect.law !=
                                                  curves[0].located.effect.law)]
    assert other_laws(curves, alive) == []
    chosen = {s.located.effect.law for s in shortlist(alive)}
    assert {s.located.effect.law for s in curves} <= chosen


def test_what_the_best_effect_is_mistaken_for_is_fitted_beside_it(monkeypatch):
    monkeypatch.setattr(module, "shortlist", lambda screened: [
        s for s in screened if s.located.effect.id == "coulomb_friction"])
    recordings = [record(s, level=0.3) for s in (1, 2, 3)]
    found = gathered(recordings, "coulomb_friction", "actuator_deadzone", "sensor_offset")
    places = [h.located[0].key for h in found.singles]
    assert {h.ids[0] for h in found.singles} == {"coulomb_friction", "actuator_deadzone"}
    assert len(set(places)) == len(places) and found.singles[0].ids == ("coulomb_friction",)
    assert list(found.singles) == sorted(found.singles, key=lambda h: h.train_error)


def test_laws_with_impacts_are_fitted_by_way_of_short_segments():
    """Over whole recordings a stiff stop is rugged: without segments the fit leaves five thousand times the floor."""
    def stop(x, v):
        depth = np.sign(x) * max(abs(x) - 0.35, 0.0)
        return -(600.0 * depth + 4.0 * v) if depth * (600.0 * depth + 4.0 * v) > 0 else 0.0

    found = gathered([pushed(s, stop) for s in (1, 2, 3)], "end_stop", "cubic_stiffness")
    best, floor = found.singles[0], floor_square(found.problem)
    assert best.ids == ("end_stop",) and best.train_error < 3 * floor < 0.001 * found.null.train_error
    stiffness, position, _ = best.values()[0]
    assert position == pytest.approx(0.35, rel=0.01) and stiffness == pytest.approx(600.0, rel=0.1)


def test_a_null_that_was_stranded_is_known_by_what_a_law_without_size_leads_to():
    found = gathered([record(s) for s in (1, 2, 3)], "sensor_offset")
    problem, null = found.problem, found.problem.null_coarse
    assert module._lower_valley(problem, found.singles) is None
    stranded = replace(problem, null_coarse=replace(null, cost=10 * null.cost))
    np.testing.assert_allclose(module._lower_valley(stranded, found.singles), null.theta, atol=0.02)


def test_a_stranded_null_is_refitted_once_from_there(monkeypatch):
    asked, valley = [], np.array([0.05, -0.02, 0.01])
    prepared = explaining.prepare
    monkeypatch.setattr(explaining, "prepare", lambda *a: asked.append(a[-1]) or prepared(*a))
    monkeypatch.setattr(module, "_lower_valley", lambda problem, singles: valley)
    found = gathered([record(s, level=0.3) for s in (1, 2, 3)], *IDS)
    assert asked == [None, valley] and found.lower is None and found.singles[0].ids == ("coulomb_friction",)
