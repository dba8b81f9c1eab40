"""What maps of states, inputs and outputs still explain of what a hypothesis leaves.

A law that only resembles the true one leaves a residual that is still a function of what the machine does; a
disturbance leaves one that is not. So small forces are injected, each a hat function of one state or input, on top
of the fitted hypothesis; their simulated responses, with small changes of the fitted parameters and with hat
functions of the outputs, are regressed on the training residual (ridge, strength by blocks of time left out). What
counts is how much of the held-out residual the sum then removes. Unlike a regression on states
(`pwaid.mismatch.predictability`) this sees a force through the dynamics that it acts on.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from pwaid.mismatch.correction import CORRECTION, curve_place
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit, fit_starts, jacobian, weighted
from pwaid.mismatch.model import Located, Model
from pwaid.mismatch.noise import NoiseModel, fit_noise
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.scout import evenly, part_of
from pwaid.mismatch.signatures import StartsOut

__all__ = ["Leftover", "leftover"]

HATS = 9  # per map
LAGS = (1, 2, 4, 8)  # samples by which an input or a reading may come later
SMALL = 0.01  # of the force scale: the size of an injected hat
RIDGES = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)  # of the mean square of a response, per sample
BLOCKS, FOLDS = 10, 5
LONG = 12000  # samples: longer recordings are judged on stretches, evenly spaced


@dataclass(frozen=True)
class Leftover:
    """Held-out mean square of each output, in its unit squared, `before` and `after` maps explain what they can, (ny,);
    `validated`: share of the training residual that the maps explain in blocks of time left out; `evidence`: rise of
    the held-out log-likelihood with the maps, residuals made white."""

    before: np.ndarray
    after: np.ndarray
    validated: float
    evidence: float


def _channels(problem: Problem) -> list[tuple[str, int, float]]:
    """Where a force may enter: kind, input or state, and its scale there."""
    s = problem.structure
    found = [("input", j, float(s.input_max[j]) or 1.0) for j in range(len(problem.plant.input_names))]
    for i, kind in enumerate(s.kinds):
        if kind == "velocity":
            found.append(("state", i, s.mobility.get(i, 1.0) * s.force_scale.get(i, 1.0)))
        elif s.partner[i] < 0:
            found.append(("state", i, s.reach(i) / s.time_scale))
    return found


def _span(z) -> tuple[float, float] | None:
    """The middle 98 % of the samples; None for a constant."""
    low, high = np.quantile(z, [0.01, 0.99])
    return (float(low), float(high)) if high - low > 1e-9 * (1 + abs(high)) else None


def _forces(problem: Problem, fit: Fit) -> list[Model]:
    """The hypothesis' model with one small hat force more, for every channel, variable and hat."""
    models, data = [], problem.train
    for (kind, target, scale), i in itertools.product(_channels(problem), range(fit.model.nx + data.U.shape[1])):
        of_input = i >= fit.model.nx
        span = _span(data.U[:, i - fit.model.nx] if of_input else fit.X[:, i])
        if span is None:
            continue
        knots = np.linspace(*span, HATS)
        for hat in SMALL * scale * np.eye(HATS):
            place = curve_place(kind, target, i - fit.model.nx if of_input else i, of_input, knots, hat)
            models.append(Model(problem.settings, (*fit.model.located, Located(CORRECTION, place)),
                                fit.model.substeps))
    return models


def _late(z, data: Dataset, lag: int) -> np.ndarray:
    """What a signal (N,) would change by if it came `lag` samples later; recordings keep their first value."""
    out = np.empty_like(z)
    for a, b in data.recordings:
        k = min(lag, b - a)
        out[a:b] = np.concatenate([np.full(k, z[a]), z[a:b - k]]) - z[a:b]
    return out


def _responses(problem: Problem, fit: Fit, held: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Responses on training and held-out outputs in units of sigma, (N ny, n) each; those that run away left out."""
    columns = []
    sets = (problem.train, fit), (problem.test, held)
    theta = np.append(fit.theta, 1.0)
    for model in _forces(problem, fit):
        columns.append([((model.simulate(theta, f.X0, data)[0] - f.Y) / problem.sigma).ravel() for data, f in sets])
    for j, lag in itertools.product(range(problem.train.U.shape[1]), LAGS):
        both = []
        for data, f in sets:
            U = data.U.copy()
            U[:, j] += SMALL * _late(data.U[:, j], data, lag)
            Y = fit.model.simulate(fit.theta, f.X0, replace(data, U=U))[0]
            both.append(((Y - f.Y) / problem.sigma).ravel())
        columns.append(both)
    for k in range(problem.train.Y.shape[1]):
        for lag in LAGS:
            both = [np.zeros_like(data.Y) for data, _ in sets]
            for change, (data, f) in zip(both, sets, strict=True):
                change[:, k] = SMALL * _late(f.Y[:, k], data, lag) / problem.sigma[k]
            columns.append([change.ravel() for change in both])
        span = _span(fit.Y[:, k])
        for hat in np.eye(HATS) if span else ():
            both = [np.zeros_like(data.Y) for data, _ in sets]
            for change, (_, f) in zip(both, sets, strict=True):
                change[:, k] = np.interp(f.Y[:, k], np.linspace(*span, HATS), hat) / problem.sigma[k]
            columns.append([change.ravel() for change in both])
    kept = [c for c in columns if all(np.all(np.isfinite(v)) and np.max(np.abs(v)) < 1e6 for v in c)]
    return tuple(np.column_stack([c[side] for c in kept]) for side in (0, 1))


def _white(noise: NoiseModel, data: Dataset, M) -> np.ndarray:
    """Weighted output signals (N ny, n) filtered so that what the noise model describes comes out white."""
    N, ny = data.Y.shape
    return noise.innovations(M.reshape(N, ny, -1), data.segments).reshape(N * ny, -1)


def _signals(problem: Problem, data: Dataset, fit: Fit, S) -> tuple[np.ndarray, np.ndarray]:
    """Residual, responses to parameters and those given, (N ny, 1 + n); and responses to start states, (N ny, nx)."""
    J = jacobian(fit.model, fit.theta, fit.X0, data, problem.sigma, fit.Y, problem.ranges,
                 bounds=fit.model.bounds(data.sample_time))
    return np.column_stack([weighted(fit.Y, data, problem.sigma), J.G, S]), J.S


def _free_of_starts(data: Dataset, M, starts) -> tuple[np.ndarray, np.ndarray]:
    """Residual and responses with what start states explain taken out."""
    M = StartsOut(starts, data)(M)
    return M[:, 0], M[:, 1:]


def _folds(data: Dataset) -> np.ndarray:
    """Fold of every sample of every output: interleaved blocks of each recording."""
    label = np.empty(len(data.Y), dtype=int)
    for a, b in data.recordings:
        label[a:b] = (np.arange(b - a) * BLOCKS // (b - a)) % FOLDS
    return np.repeat(label, data.Y.shape[1])


def _weights(A, e, fold) -> tuple[np.ndarray, float]:
    """Ridge weights, their strength by the folds, and the share of e explained in folds left out."""
    size = np.sqrt(np.mean(A**2, axis=0))
    size[size <= 1e-9 * size.max()] = np.inf
    A = A / size
    eye, best = len(A) * np.eye(A.shape[1]), (np.inf, RIDGES[0])
    whole, parts = (A.T @ A, A.T @ e), []
    for f in range(FOLDS):
        out = fold == f
        parts.append((out, whole[0] - A[out].T @ A[out], whole[1] - A[out].T @ e[out]))
    for ridge in RIDGES:
        error = sum(float(np.sum((e[out] - A[out] @ np.linalg.solve(H + ridge * eye, g)) ** 2)) for out, H, g in parts)
        best = min(best, (error, ridge))
    w = np.linalg.solve(whole[0] + best[1] * eye, whole[1]) / size
    return w, 1.0 - best[0] / max(float(e @ e), 1e-300)


def leftover(problem: Problem, fit: Fit, held: Fit) -> Leftover | None:
    """What maps on top of a fitted hypothesis explain of its held-out residual.

    Parameters
    ----------
    fit, held : the hypothesis on the training and on the held-out recordings, start states fitted on both.

    Returns
    -------
    Leftover, or None for a simulator that is a black box or runs in Python: some hundred simulations take too long.
    """
    if problem.plant.black_box is not None or problem.plant.rhs is None or len(fit.model.located) > 2:
        return None
    held_out = len(problem.test.U)
    problem, fit, held = _on_stretches(problem, fit, held)
    train, test = problem.train, problem.test
    sides = [(data, *_signals(problem, data, f, S)) for data, f, S in
             zip((train, test), (fit, held), _responses(problem, fit, held), strict=True)]
    (e, A), (q, B) = (_free_of_starts(*side) for side in sides)
    w, validated = _weights(A, e, _folds(train))
    before, after = (problem.sigma**2 * np.mean(r.reshape(test.Y.shape) ** 2, axis=0) for r in (q, q - B @ w))
    noise = fit_noise((e - A @ w).reshape(train.Y.shape), train.segments)
    (e, A), (q, B) = (_free_of_starts(data, *(_white(noise, data, M) for M in both)) for data, *both in sides)
    rest = q - B @ _weights(A, e, _folds(train))[0]
    evidence = 0.5 * float(q @ q - rest @ rest) * held_out / len(test.U)
    return Leftover(before, after, validated, evidence)


def _on_stretches(problem: Problem, fit: Fit, held: Fit) -> tuple[Problem, Fit, Fit]:
    """The same on stretches of long recordings: some hundred responses to all of them would not fit in memory."""
    found = []
    for data, f in ((problem.train, fit), (problem.test, held)):
        if len(data.U) > LONG:
            data, index = data.windows(evenly(problem, data, LONG))
            start = part_of(f, data, index).X0  # hidden states begin anew in every stretch
            f = fit_starts(f.model, data, problem.sigma, f.theta, start, problem.ranges)
        found.append((data, f))
    (train, fit), (test, held) = found
    return replace(problem, train=train, test=test), fit, held
