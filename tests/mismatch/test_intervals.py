"""Intervals cover the truth where small effects stay hidden, only widen, and are not blown up where nothing hides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student
from tests_support import oscillator, record

from pwaid.mismatch.discrepancy import discrepancy, signatures
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import collect
from pwaid.mismatch.fit import fit_model
from pwaid.mismatch.intervals import covariance, parameter_intervals
from pwaid.mismatch.model import Located, Model
from pwaid.mismatch.normal import normal_equations

HIDDEN = ("cubic_stiffness", "quadratic_drag")
VISIBLE = 0.25  # of the noise, what the hidden effects leave after a refit
NOISE = 2e-3


@pytest.fixture(scope="module")
def base():
    """Problem and Coulomb fit of two recordings of an oscillator; the fit is the truth of what follows."""
    recordings = [record(k, level=0.4, samples=600) for k in (1, 2, 3)]
    evidence = collect(oscillator(), recordings[:2], recordings[2], ["m", "b", "k"],
                       effects=effect_by_id("coulomb_friction"))
    return evidence.problem, evidence.singles[0].fit


def refitted(problem, truth, seed, hidden):
    """The Coulomb law fitted to what `truth` simulates with the hidden effects inside, noise added."""
    rng = np.random.default_rng(seed)
    law, theta = truth.model.located[0], truth.theta
    small = tuple(Located(e, e.places(problem.structure)[0]) for name in hidden for e in effect_by_id(name)[:1])
    model = Model(problem.settings, (law, *small), truth.model.substeps)
    signs = (rng.choice([-1.0, 1.0]), 1.0)  # drag only brakes; its size lies on a logarithmic axis
    sizes = [s.internal([sign * 0.02 * rng.uniform(0.4, 1.0)]) for s, sign in zip(small, signs, strict=False)]
    outputs = model.simulate(np.concatenate([theta, *sizes]), truth.X0, problem.train)[0]
    normal = normal_equations(problem, truth)
    left = normal.unabsorbed(normal.without_starts(((outputs - truth.Y) / problem.sigma).ravel())) * problem.sigma[0]
    shrink = min(1.0, VISIBLE * NOISE / max(float(np.sqrt(np.mean(left**2))), 1e-12)) if hidden else 0.0
    outputs = truth.Y + shrink * (outputs - truth.Y) + NOISE * rng.normal(size=outputs.shape)
    other = replace(problem, train=replace(problem.train, Y=outputs))
    return other, fit_model(truth.model, other.train, other.sigma, theta, truth.X0, other.ranges)


def half_widths(problem, fit):
    """Of the interval and of the block sandwich alone."""
    low, high, _ = parameter_intervals(problem, fit)
    C = covariance(problem, normal_equations(problem, fit))
    return 0.5 * (high - low), student.ppf(0.95, 20) * np.sqrt(np.diag(C))


def test_hidden_effects_are_allowed_for(base):
    problem, truth = base
    covered = []
    for seed in range(8):
        other, fit = refitted(problem, truth, seed, HIDDEN)
        covered.append([np.abs(fit.theta - truth.theta) <= w for w in half_widths(other, fit)])
    whole, alone = np.mean(covered, axis=(0, 2))  # of 32
    assert alone < 0.5
    assert whole > 0.8


def test_intervals_only_widen_and_clean_ones_by_a_few_times(base):
    problem, truth = base
    ratios = []
    for seed in range(4):
        other, fit = refitted(problem, truth, seed, ())
        whole, alone = half_widths(other, fit)
        assert np.all(whole >= alone)
        ratios.append(whole / alone)
    assert np.median(ratios) < 6.0


def test_discrepancy_is_a_second_moment_and_the_named_law_no_part_of_it(base):
    problem, fit = base
    bias = discrepancy(problem, fit, normal_equations(problem, fit))
    assert np.all(np.linalg.eigvalsh(bias) >= -1e-12 * np.trace(bias))
    cubic = Located(effect_by_id("cubic_stiffness")[0], effect_by_id("cubic_stiffness")[0].places(problem.structure)[0])
    both = Model(problem.settings, (*fit.model.located, cubic), fit.model.substeps)
    theta = np.append(fit.theta, 0.05)
    outputs, states = both.simulate(theta, fit.X0, problem.train)
    named = replace(fit, model=both, theta=theta, Y=outputs, X=states)
    assert signatures(problem, named).shape[1] == signatures(problem, fit).shape[1] - 1


def test_a_direction_that_only_the_prior_holds_is_as_wide_as_the_tolerance(base):
    problem, fit = base
    normal = normal_equations(problem, fit)
    G = normal.G.copy()
    G[:, 0] = 0.0  # as if the recordings said nothing of the mass
    blind = replace(normal, G=G, inverse=np.linalg.inv(G.T @ G + np.diag(normal.prior**2)))
    assert np.sqrt(covariance(problem, blind)[0, 0]) == pytest.approx(np.log(1.3), rel=0.05)


def test_a_parameter_that_does_nothing_may_be_anything_within_its_bounds(base):
    problem, fit = base
    stop = next(Located(e, p) for e in effect_by_id("end_stop") for p in e.places(problem.structure))
    never = stop.internal([1.0, 5.0, 1.0])  # stiffness, position far beyond the motion, damping
    both = Model(problem.settings, (*fit.model.located, stop), fit.model.substeps)
    theta = np.concatenate([fit.theta, never])
    Y, X = both.simulate(theta, fit.X0, problem.train)
    ends = parameter_intervals(problem, replace(fit, model=both, theta=theta, Y=Y, X=X))[:2]
    n = fit.model.size
    low, high = both.bounds(problem.train.sample_time)
    assert np.allclose(ends[0][n:], low[n:]) and np.allclose(ends[1][n:], high[n:])
    assert np.all(ends[1][:n] - ends[0][:n] < 1.0)
