"""What maps still explain of what a hypothesis leaves: much for a stand-in, nothing for the law or a disturbance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from tests_support import TRUE, gathered, oscillator, record

from pwaid.mismatch import Thresholds
from pwaid.mismatch.adequacy import floor_or_trifle, inadequate, likelihood_gain, over_floor, still_explained
from pwaid.mismatch.decide import _better_pair, _not_outdone, decide
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import collect
from pwaid.mismatch.hypotheses import floor_square
from pwaid.mismatch.leftover import Leftover, leftover
from pwaid.mismatch.signatures import lattice


@pytest.fixture(scope="module")
def rubbing():
    """Dry friction a tenth of the drive's amplitude."""
    return [record(s, level=0.06) for s in (1, 2, 3)]


def test_maps_explain_what_a_stand_in_leaves_and_not_what_the_law_leaves(rubbing):
    for name, stands_in in (("hysteretic_spring", True), ("coulomb_friction", False)):
        evidence = gathered(rubbing, name)
        h = evidence.singles[0]
        rest = leftover(evidence.problem, h.fit, h.test)
        assert (rest.validated > 0.5) == stands_in
        assert (rest.after[0] < 0.8 * rest.before[0]) == stands_in


def late(seed: int, samples: int = 4):
    """A recording whose input reached the machine later than it was recorded."""
    r = record(seed, noise=1e-3)
    u = np.vstack([r.inputs[samples:], np.repeat(r.inputs[-1:], samples, axis=0)])
    return r.replace(inputs=u)


def test_maps_find_the_delay_that_a_lag_stands_in_for():
    runs = [late(s) for s in (7, 8, 9)]
    found = {}
    for name in ("actuator_lag", "input_delay"):
        evidence = gathered(runs, name)
        h = evidence.singles[0]
        assert h.share > 0.9
        gain = likelihood_gain(evidence.problem, h)
        found[name] = leftover(evidence.problem, h.fit, h.test).evidence / gain
        assert (inadequate(evidence.problem, h, Thresholds()) == "") == (name == "input_delay")
    assert found["input_delay"] < 0.01 < 0.2 < found["actuator_lag"]


def test_maps_do_not_explain_a_disturbance():
    rng = np.random.default_rng(0)
    disturbed = [r.replace(outputs=r.outputs + lfilter([0.02], [1.0, -0.95], rng.normal(size=r.outputs.shape), axis=0))
                 for r in (record(s) for s in (4, 5, 6))]
    problem = gathered(disturbed, "quadratic_drag", plant=oscillator(**TRUE)).problem
    rest = leftover(problem, problem.null, problem.null_test)
    assert rest.before[0] > 25 * problem.floor.level[0] ** 2  # the disturbance is far above the white noise
    assert rest.after[0] > 0.9 * rest.before[0]


def test_a_stand_in_for_a_law_left_out_is_refused():
    rubbing = [record(s, level=0.08) for s in (1, 2, 3)]
    spring = effect_by_id("hysteretic_spring")[0]
    force, yielding, order, shape = spring.quantities
    spring = replace(spring, quantities=(force, yielding, replace(order, low=1.99, high=2.01, probes=(2.0,)),
                                         replace(shape, low=0.49, high=0.51)))
    evidence = collect(oscillator(), rubbing[:2], rubbing[2:], list(TRUE),
                       effects=[spring, *effect_by_id("actuator_deadzone")])
    strict, lenient = (decide(evidence.problem, evidence.null, evidence.singles, (), t)
                       for t in (Thresholds(share_tentative=0.3),
                                 Thresholds(share_tentative=0.3, validated=1.0, found=1.0, left=np.inf)))
    assert strict.verdict == "unexplained"
    assert any("maps of states and inputs on top of it raise" in r for r in strict.reasons)
    assert lenient.verdict == "named"  # without the maps, and parameters at their bounds forgiven, it passes


def test_a_small_error_that_maps_explain_is_no_disturbance(rubbing):
    evidence = gathered(rubbing, "quadratic_drag")
    assert decide(evidence.problem, evidence.null, evidence.singles, ()).verdict == "unexplained"
    assert decide(evidence.problem, evidence.null, evidence.singles, (), Thresholds(validated=1.0)).verdict == (
        "parameters_only")


def test_a_law_is_not_named_when_a_refused_one_leaves_much_less(rubbing):
    evidence = gathered(rubbing, "coulomb_friction", "hysteretic_spring")
    weaker = next(h for h in evidence.singles if h.ids == ("hysteretic_spring",))
    better = next(h for h in evidence.singles if h.ids == ("coulomb_friction",))
    reasons = []
    assert _not_outdone(evidence.problem, [weaker], [better], Thresholds(), reasons) == []
    assert "itself refused" in reasons[0]
    assert _not_outdone(evidence.problem, [better], [weaker], Thresholds(), reasons) == [better]


def test_a_refused_pair_that_adds_to_a_law_speaks_against_it_only_where_noise_counts(rubbing):
    evidence = gathered(rubbing, "coulomb_friction", "hysteretic_spring")
    problem, (law, other) = evidence.problem, evidence.singles[:2]
    pair = replace(law, located=(*law.located, *other.located), train_error=0.1 * law.train_error,
                   test_error=0.1 * law.test_error)
    stranger = replace(pair, located=other.located * 2)
    for quiet, kept in ((0.0, [law]), (np.inf, [])):
        assert _not_outdone(problem, [law], [pair], Thresholds(quiet=quiet), []) == kept
        assert _not_outdone(problem, [law], [stranger], Thresholds(quiet=quiet), []) == []


@pytest.mark.parametrize("step", [0.1, 0.37])
def test_the_step_of_a_quantised_signal_is_read_from_its_lattice(step):
    rng = np.random.default_rng(1)
    y = np.cumsum(rng.normal(size=3000)) * 0.05
    assert lattice(step * np.round(y / step)) == pytest.approx(step, rel=1e-9)
    assert lattice(y) == 0.0
    assert lattice(np.zeros(100)) == 0.0
    assert lattice(rng.choice([0.0, 0.1, 0.25, np.pi], 400)) == 0.0


def test_a_second_law_must_be_seen_by_likelihoods_too(rubbing):
    """Numbers of errors alone may fall because a law bends to one slow wave."""
    evidence = gathered(rubbing, "coulomb_friction", "hysteretic_spring")
    problem, floor = evidence.problem, floor_square(evidence.problem)
    weaker = next(h for h in evidence.singles if h.ids == ("hysteretic_spring",))
    better = next(h for h in evidence.singles if h.ids == ("coulomb_friction",))
    pair = replace(better, located=(*better.located, *weaker.located))
    assert _better_pair(problem, weaker, [pair], floor, Thresholds()) is pair
    unseen = replace(pair, fit=weaker.fit, test=weaker.test)
    assert _better_pair(problem, weaker, [unseen], floor, Thresholds()) is None


def test_what_maps_explain_in_training_only_and_is_little_does_not_speak_against_a_law(rubbing):
    evidence = gathered(rubbing, "hysteretic_spring")
    h = evidence.singles[0]
    square = over_floor(evidence.problem, h.test.Y, Thresholds()) * floor_or_trifle(evidence.problem, Thresholds()) ** 2
    maps = Leftover(square, square, validated=0.6, evidence=0.0)  # nothing held out
    part = 1.0 - h.share
    assert 0.01 < part < 0.6
    for acquitted, trace, refused in ((True, 2 * part, False), (True, 0.5 * part, True), (False, 2 * part, True)):
        said = still_explained(evidence.problem, h, Thresholds(trace=trace), maps, acquitted)
        assert ("60 % of what it leaves in training" in said) == refused, said
