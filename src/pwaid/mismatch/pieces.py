"""Laws with impacts part two motions that start side by side; over a few time constants they do not."""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit, fit_starts
from pwaid.mismatch.hypotheses import Hypothesis
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.sensitive import SHORTEST

__all__ = ["PARTING", "brief_samples", "holds_in_pieces"]

PARTING = ("end_stop", "backlash", "position_ripple")  # laws that part motions; a brim joins them
BRIEF = 2.5  # time constants of a segment over which no impact parts two motions


def brief_samples(problem: Problem) -> int:
    """Samples of such a segment."""
    return max(SHORTEST, int(BRIEF * problem.structure.time_scale / problem.train.sample_time))


def holds_in_pieces(problem: Problem, h: Hypothesis, near: float, share: float) -> bool:
    """Whether a hypothesis with impacts leaves at most `near` times the floor's mean square of every output on short
    segments of the held-out recordings, each with its own start state, and less by `share` than the null does there.

    What it then leaves on whole recordings is no other physics: a slightly wrong impact leads elsewhere.
    """
    if problem.plant.rhs is None or not any(e.effect.id in PARTING for e in h.located):
        return False
    data = problem.test.cut(brief_samples(problem))
    left, null = (_left(problem, fit, data) for fit in (h.test, problem.null_test))
    worst = int(np.argmax(null))
    return bool(np.all(left < near)) and null[worst] - left[worst] > share * (null[worst] - 1.0)


def _left(problem: Problem, fit: Fit, data: Dataset) -> np.ndarray:
    """Mean square of each output relative to the floor's, from the better of two sets of start states."""
    begun = fit.X[data.segments[:, 0], :fit.model.nx]
    fits = [fit_starts(fit.model, data, problem.sigma, fit.theta, X0, problem.ranges)
            for X0 in (problem.measured(data), begun)]
    best = min(fits, key=lambda f: f.cost)
    return np.mean(best.residual(data) ** 2, axis=0) / problem.floor.level**2
