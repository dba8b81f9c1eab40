"""Start states that the null does not see: a law may, so its fit looks for them over the whole range they visit.

Where only speed is measured, nothing but a ripple or an end stop tells where the motion began; of two coupled positions
the difference may be seen and the mean not. Along such a direction the error has a valley for every period or stop.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit, fit_starts, jacobian

__all__ = ["best_starts", "scans", "unseen_directions", "visited"]

SEEN = 1e-3  # of sigma: what a move by the whole range must change in the null's outputs, on the average
COUNT, SLOW_COUNT, VALLEYS = 96, 32, 4  # places of a scan, where simulations are slow, and starts taken from it
VISITED = 32  # states of a fit that are tried where a recording begins
PROBES = np.array([0.0, 0.19, 0.43, 0.71, 1.0])  # places in the range that show whether a law acts along a direction


def unseen_directions(problem) -> list[tuple[int, np.ndarray]]:
    """Directions of the start state that change none of the null's held-out outputs.

    Each with a leading state, in whose unit it is one long and which no other direction moves.
    """
    fit, data = problem.null_test, problem.test
    S = jacobian(fit.model, fit.theta, fit.X0, data, problem.sigma, fit.Y, problem.ranges).S * problem.ranges
    power, V = np.linalg.eigh(S.T @ S / len(S))
    V = V[:, np.sqrt(np.maximum(power, 0.0)) < SEEN]
    if not V.size:
        return []
    leading = qr(V.T, pivoting=True)[2][:V.shape[1]]
    W = problem.ranges[:, None] * (V @ np.linalg.inv(V[leading]))
    W[np.abs(W) < 1e-6 * problem.ranges[:, None]] = 0.0
    found = [(int(i), w / w[i]) for i, w in zip(leading, W.T, strict=True)]
    return [(i, d) for i, d in found if _invisible(problem, 0.1 * problem.ranges[i] * d)]


def _invisible(problem, move) -> bool:
    """Whether a move of every start state leaves the null's held-out outputs where they are."""
    fit = problem.null_test
    return _alike(problem, fit.model.simulate(fit.theta, fit.X0 + move, problem.test)[0], fit.Y)


def _alike(problem, Y, other) -> bool:
    """Whether two simulations differ by nothing that counts beside sigma."""
    return bool(np.max(np.abs(Y - other) / problem.sigma) < 10 * SEEN)


def scans(problem, fit: Fit, X0, data: Dataset) -> list[np.ndarray]:
    """Start states (segments, nx) at the deepest valleys of a scan along each direction that its laws see and the null
    does not."""
    found, s, X0 = [], problem.structure, X0[:, :fit.model.nx]

    def moved(values, i, d):
        trials = X0 + (values[:, None] - X0[:, i])[:, :, None] * d
        return trials, (fit.model.simulate(fit.theta, x, data)[0] for x in trials)

    for i, d in problem.unseen if fit.model.located else ():
        first, *others = moved(s.low[i] + PROBES * (s.high[i] - s.low[i]), i, d)[1]
        if all(_alike(problem, Y, first) for Y in others):
            continue
        count = COUNT if problem.plant.rhs is not None else SLOW_COUNT
        trials, outputs = moved(np.linspace(s.low[i], s.high[i], count), i, d)
        sums = np.array([_by_segment(problem, Y, data) for Y in outputs])
        padded = np.pad(sums, ((1, 1), (0, 0)), constant_values=np.inf)
        valley = np.where((sums <= padded[:-2]) & (sums <= padded[2:]), sums, np.inf)
        found += [trials[row, np.arange(len(X0))] for row in np.argsort(valley, axis=0)[:VALLEYS]]
    return found


def visited(problem, fit: Fit, data: Dataset) -> np.ndarray:
    """Start states (segments, nx), each the one among states that the fit visits from which a segment errs least."""
    states = fit.X[np.linspace(0, len(fit.X) - 1, VISITED).astype(int), :fit.model.nx]
    states = states[np.all(np.isfinite(states), axis=1)]
    if not len(states):
        return problem.measured(data)
    count = len(data.segments)
    sums = [_by_segment(problem, fit.model.simulate(fit.theta, np.tile(x, (count, 1)), data)[0], data) for x in states]
    return states[np.argmin(sums, axis=0)]


def best_starts(problem, fit: Fit, best: Fit, options, data: Dataset) -> Fit:
    """`best`, with the start states of each segment replaced by those fitted from an option where they err less."""
    for X0 in options:
        other = fit_starts(fit.model, data, problem.sigma, fit.theta, X0, problem.ranges)
        better = _by_segment(problem, other.Y, data) < _by_segment(problem, best.Y, data)
        if better.any():
            best = fit_starts(fit.model, data, problem.sigma, fit.theta,
                              np.where(better[:, None], other.X0, best.X0), problem.ranges)
    return best


def _by_segment(problem, Y, data: Dataset) -> np.ndarray:
    """Weighted sum of squares of every segment; infinite where the simulation diverged."""
    e = np.sum(((data.Y - Y) / problem.sigma) ** 2, axis=1)
    sums = np.array([np.sum(e[a:b]) for a, b in data.segments[:, :2]])
    return np.where(np.isfinite(sums), sums, np.inf)
