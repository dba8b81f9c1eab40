"""Motions that part from the smallest difference, such as a pendulum that swings over the top.

No start state keeps them over a recording, though nothing may be missing. Where the refitted simulation loses a
recording, and slightly other start states lead somewhere else, recordings are cut into segments.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit, fit_model, fit_starts
from pwaid.mismatch.startscan import best_starts

__all__ = ["LOST", "SHORTEST", "follows", "steadied"]

LOST = 0.5  # of an output's standard deviation
RESTS = 0.1  # of its spread over all recordings: where an output moves less it all but rests
FOLLOWED = 1.3  # mean square of what is left, relative to the floor's, below which nothing is missing
SLIGHT = 0.01  # of a state's range: a move of its start that a motion should outlive
SHORTEST = 40  # samples of a segment
HANDED = 4  # times that start states are handed on from one segment to the next


def follows(problem, fit: Fit, data: Dataset) -> bool:
    """Whether a simulation leaves no more than the noise floor of every output."""
    return bool(np.all(np.mean(fit.residual(data) ** 2, axis=0) < FOLLOWED * problem.floor.level**2))


def _off(Y, data: Dataset, beside) -> bool:
    """Whether two simulations, or one and the recordings, differ by much of an output's spread in some segment.

    A recording in which an output all but rests is measured by its spread in the others.
    """
    whole = np.std(data.Y, axis=0)
    whole[whole == 0.0] = np.inf  # an output that never moves says nothing
    return any(np.any(np.std((Y - beside)[a:b], axis=0) > LOST * np.maximum(np.std(data.Y[c:d], axis=0), RESTS * whole))
               for a, b, c, d in data.segments[:, :4])


def _parts(fit: Fit, data: Dataset, ranges) -> bool:
    """Whether start states a hundredth of their range away lead somewhere else."""
    moves = [sign * SLIGHT * move for move in np.diag(ranges) for sign in (1, -1)]
    return any(_off(fit.model.simulate(fit.theta, fit.X0 + move, data)[0], data, fit.Y) for move in moves)


def steadied(problem):
    """The problem in segments over which its motion is no longer sensitive; as it came where the null keeps all
    recordings, or where the motion is not sensitive.

    Segments that the null follows to the floor are what there is to explain: nothing. Otherwise a hypothesis that
    keeps the whole recordings is judged on them (see `Problem.whole`).
    """
    sides = (problem.null, problem.train), (problem.null_test, problem.test)
    if not any(_off(fit.Y, data, data.Y) and _parts(fit, data, problem.ranges) for fit, data in sides):
        return problem
    length, whole = int(12 * problem.structure.time_scale / problem.train.sample_time), (problem.train, problem.test)
    for samples in (length, length // 2, length // 4):
        if samples < SHORTEST:
            break
        (train, nominal, null), (test, nominal_test, null_test) = _in_segments(problem, samples)
        sides = (null, train), (null_test, test)
        nothing = all(follows(problem, fit, data) for fit, data in sides)
        if nothing or not any(_off(fit.Y, data, data.Y) or _parts(fit, data, problem.ranges) for fit, data in sides):
            note = ("the motion is sensitive, no start state keeps it over a recording: segments of about "
                    f"{samples * train.sample_time:.3g} s, each with free start states")
            return replace(problem, train=train, test=test, coarse=train, nominal=nominal, null=null,
                           null_coarse=null, nominal_test=nominal_test, null_test=null_test,
                           whole=None if nothing else whole, notes=(*problem.notes, note))
    return problem


def _in_segments(problem, samples: int):
    """Data, nominal simulation and null in segments, for training and held-out recordings."""
    null, null_test = problem.null, problem.null_test
    train, test = problem.train.cut(samples), problem.test.cut(samples)
    nominal = _handed_on(problem, null, 0 * null.theta, train)
    fit = fit_model(null.model, train, problem.sigma, nominal.theta, nominal.X0, problem.ranges, 20)
    return (train, nominal, fit), (test, _handed_on(problem, null_test, 0 * fit.theta, test),
                                   _handed_on(problem, null_test, fit.theta, test))


def _handed_on(problem, null: Fit, theta, cut: Dataset) -> Fit:
    """Start states of segments: the best from what was measured and from where the segment before ended."""
    last = np.maximum(cut.segments[:, 0] - 1, 0)
    inside = cut.segments[:, 0] > cut.segments[:, 2]
    X0 = problem.measured(cut)
    best = fit_starts(null.model, cut, problem.sigma, theta, X0, problem.ranges)
    before = null.X
    for _ in range(HANDED):
        ends = before[last, :null.model.nx]
        known = inside & np.all(np.isfinite(ends), axis=1)
        best = best_starts(problem, best, best, [np.where(known[:, None], ends, best.X0)], cut)
        before = best.X
    return best
