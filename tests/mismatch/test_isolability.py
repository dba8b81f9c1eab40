"""What the recordings can tell apart, and the input that tells more."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests_support import TRUE, oscillator, record

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.experiment import next_experiment, plan_experiment, rivals
from pwaid.mismatch.fit import fit_model
from pwaid.mismatch.hypotheses import hypothesis_of, null_hypothesis
from pwaid.mismatch.inputs import proposals
from pwaid.mismatch.isolability import ALIKE, isolability, leading, nested
from pwaid.mismatch.model import Model
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.prepare import prepare
from pwaid.mismatch.refit import Refitter, noise_of, times_noise
from pwaid.mismatch.screen import locate_effects, screen

IDS = ("coulomb_friction", "quadratic_drag", "cubic_stiffness", "stribeck_friction")


@pytest.fixture(scope="module")
def problem():
    train, test = (Dataset.from_recordings([record(s, level=0.4, samples=500)]) for s in (1, 2))
    return prepare(as_plant(oscillator(**TRUE)), train, test, ["N"], ["m"], ("m", "b", "k"))


@pytest.fixture(scope="module")
def fitted(problem):
    """Each law fitted from a plausible start."""
    found = {"null": null_hypothesis(problem)}
    for e in locate_effects([v for i in IDS for v in effect_by_id(i)], problem.structure):
        model = Model(problem.settings, (e,))
        theta = np.concatenate([np.zeros(3), e.internal([q.probes[0] for q in e.effect.quantities])])
        fit = fit_model(model, problem.train, problem.sigma, theta, problem.null.X0, problem.ranges, 15)
        found.setdefault(e.effect.id, hypothesis_of(problem, fit, 0.0))  # the first of several laws of an id
    return found


def decision(verdict, *members):
    return SimpleNamespace(verdict=verdict, members=members, chosen=members[0] if members else None)


def test_the_matrix_says_who_can_imitate_whom(problem, fitted):
    chosen = [fitted[i] for i in ("null", "coulomb_friction", "cubic_stiffness", "stribeck_friction")]
    told = isolability(problem, chosen)
    m = told.matrix
    assert np.all(np.diag(m) == 1.0)
    assert np.all(m >= 1.0)
    assert m[1, 0] > 5  # no parameters imitate friction
    assert m[1, 2] > 5  # nor does a cubic spring
    assert m[0, 1] == 1.0  # friction turned down is no friction
    assert m[1, 3] < ALIKE  # Stribeck friction contains Coulomb's
    assert told.alike() == []  # laws inside each other are not called alike
    assert told.table()["labels"][0] == "parameters only"


def test_matrix_is_the_same_with_two_threads(problem, fitted):
    chosen = [fitted[i] for i in ("null", "coulomb_friction", "quadratic_drag")]
    np.testing.assert_array_equal(isolability(problem, chosen).matrix, isolability(problem, chosen, jobs=2).matrix)


def quick_and_full(problem, h, target):
    """Times the noise that refits of a hypothesis to these outputs leave: a few steps, and a whole fit."""
    noise = noise_of(problem)
    quick = Refitter(h, problem.train, h.fit.X0, noise, problem.ranges).refit(target)
    moved = Dataset(problem.train.names, problem.train.U, target, problem.train.segments, problem.train.sample_time)
    full = fit_model(h.fit.model, moved, noise, h.fit.theta, h.fit.X0, problem.ranges, 25)
    return times_noise(target, quick, noise), times_noise(target, full.Y, noise)


@pytest.mark.parametrize("name", ["null", "quadratic_drag"])
def test_refit_finds_what_a_full_fit_finds(problem, fitted, name):
    quick, full = quick_and_full(problem, fitted[name], fitted["cubic_stiffness"].fit.Y)
    assert quick < 1.1 * full


def test_refit_that_has_far_to_go_says_apart_as_a_full_fit_does(problem, fitted):
    quick, full = quick_and_full(problem, fitted["quadratic_drag"], fitted["coulomb_friction"].fit.Y)
    assert min(quick, full) > ALIKE


def test_leading_takes_the_answer_first_and_no_law_twice(fitted):
    members = [fitted["coulomb_friction"]]
    chosen = leading(fitted["null"], members, [*fitted.values(), fitted["quadratic_drag"]], most=4)
    assert chosen[:2] == (fitted["null"], fitted["coulomb_friction"])
    assert len(chosen) == 4
    assert len({h.label for h in chosen}) == 4
    assert nested(fitted["stribeck_friction"], fitted["coulomb_friction"])
    assert not nested(fitted["quadratic_drag"], fitted["coulomb_friction"])


def test_proposals_stay_inside_the_recorded_range(problem):
    found = proposals(problem.train, ["F"], ["N"])
    low, high = problem.train.U.min(), problem.train.U.max()
    assert {"slow triangle", "two amplitudes of one multisine", "step, hold, reverse", "coast down",
            "recorded input at half amplitude", "bias and recorded input"} <= {p.kind for p in found}
    assert all(low - 1e-9 <= p.U.min() and p.U.max() <= high + 1e-9 for p in found)
    assert "recorded input at double amplitude" not in {p.kind for p in found}  # outside the recorded range
    triangle = next(p for p in found if p.kind == "slow triangle")
    assert triangle.amplitude == pytest.approx(np.max(triangle.U), rel=0.02)
    assert "N" in triangle.words
    assert f"{triangle.period:.3g} s" in triangle.words


def test_one_sided_inputs_are_proposed_around_their_middle():
    recording = record(1, samples=200)
    up = recording.replace(inputs=recording.inputs - recording.inputs.min() + 1.0)
    found = proposals(Dataset.from_recordings([up]), ["F"], ["N"])
    assert found
    assert all(p.U.min() >= 1.0 - 1e-9 for p in found)
    assert "around" in found[0].words


def test_the_chosen_input_separates_best_among_the_finalists(problem, fitted):
    pair = rivals(problem, fitted["null"], decision("named", fitted["coulomb_friction"]), list(fitted.values()))
    assert pair[0] is fitted["coulomb_friction"]
    assert pair[1].ids in (("quadratic_drag",), ("cubic_stiffness",))
    plan = plan_experiment(problem, pair, ["N"])
    assert plan.predicted >= max(d for _, d in plan.ranking)
    assert plan.predicted == pytest.approx(times_noise(plan.first, plan.second, noise_of(problem)))
    text = next_experiment(problem, decision("named", fitted["coulomb_friction"]), plan)
    assert plan.proposal.words in text
    assert "in the present recordings" in text
    assert "a slow triangle with reversals" in text  # the catalogue's reason


def test_rivals_of_a_set_are_its_first_two(problem, fitted):
    a, b, null = fitted["quadratic_drag"], fitted["coulomb_friction"], fitted["null"]
    assert rivals(problem, null, decision("one_of", a, b), []) == (a, b)
    assert rivals(problem, null, decision("unexplained"), [b]) == (b, null)
    assert rivals(problem, null, decision("agreement"), []) is None


def test_a_rival_is_fitted_where_only_wider_laws_were(problem, fitted):
    best, null = fitted["coulomb_friction"], fitted["null"]
    laws = locate_effects([*effect_by_id("stribeck_friction"), *effect_by_id("actuator_deadzone")], problem.structure)
    pair = rivals(problem, null, decision("named", best), [fitted["stribeck_friction"]],
                  screen(problem, problem.null, laws))
    assert pair[0] is best
    assert pair[1].ids == ("actuator_deadzone",)
    assert pair[1].train_error < null.train_error


def test_a_simulator_in_the_plain_loop_is_compared_too(problem, fitted):
    """Fewer samples, the same answer: no parameters imitate friction."""
    plant = replace(problem.plant, rhs=None, out=None)
    slow = replace(problem, plant=plant, settings=replace(problem.settings, plant=plant))
    pair = []
    for name in ("coulomb_friction", "null"):
        h = fitted[name]
        model = Model(slow.settings, h.located, h.fit.model.substeps)
        pair.append(replace(h, fit=replace(h.fit, model=model)))
    told = isolability(slow, pair)
    assert told.matrix[0, 1] > 5
    plan = plan_experiment(slow, tuple(pair), ["N"])
    assert plan.predicted > 5
    assert len(plan.time) <= 300
