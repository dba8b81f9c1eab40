"""Least squares on the simulation error: Levenberg-Marquardt with every start state eliminated.

    minimise over (a, z, x0)   Σ ‖(y - ŷ)/σ‖² + Σ (a/prior)²

a are logarithms of nominal-parameter ratios, z the effects' parameters, x0 one start state per
segment. A start state touches its own segment only, so it is eliminated by a Schur complement and
a data set with a hundred segments costs as many simulations as one with a single segment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.model import Model

__all__ = ["Fit", "Jacobian", "fit_model", "fit_starts", "jacobian", "output_rows", "weighted"]

WIDTHS = (1.0, 10.0, 2.0)  # factors on the difference steps, one after the other where one stalls among kinks
CLIP = 1e3  # weighted residuals beyond this count as this: a runaway simulation is bad, not infinite


@dataclass(frozen=True)
class Fit:
    """The end of a fit: parameters, start states, simulated outputs and states, cost."""

    model: Model
    theta: np.ndarray
    X0: np.ndarray
    cost: float
    Y: np.ndarray
    X: np.ndarray
    iterations: int

    def residual(self, data: Dataset) -> np.ndarray:
        """Recorded minus simulated outputs, (N, ny)."""
        return data.Y - self.Y


@dataclass(frozen=True)
class Jacobian:
    """Derivatives of the weighted outputs: G (N ny, globals) and S (N ny, nx) by start state of the own segment."""

    G: np.ndarray
    S: np.ndarray


def weighted(Y, data: Dataset, sigma) -> np.ndarray:
    """Recorded minus simulated outputs in units of sigma, clipped, laid out sample by sample."""
    return np.clip((data.Y - Y) / sigma, -CLIP, CLIP).ravel()


def _rough(model: Model) -> bool:
    """Whether events put kinks into the cost."""
    return any(e.effect.proximal or e.effect.id in ("end_stop", "backlash", "overflow") for e in model.located)


def _steps(model: Model, theta):
    """Difference steps: wide enough to average over the kinks that events make."""
    rough = _rough(model)
    steps = np.full(model.size, 2e-3 if rough else 2e-4)
    k = model.np
    for e in model.located:
        for q in e.effect.quantities:
            steps[k] = (5e-3 if rough else 1e-3) * (1.0 if q.log else max(abs(theta[k]), 0.03))
            k += 1
    return steps


def jacobian(model: Model, theta, X0, data: Dataset, sigma, Y, ranges, want_states: bool = True,
             bounds=None, wide: float = 1.0) -> Jacobian:
    """Forward differences around (theta, X0); `ranges` (nx,) are the states' magnitudes, `wide` scales the steps."""
    X0, ranges = model.opened(X0), model.start_ranges(ranges)
    n, nx = data.Y.size, X0.shape[1]
    G, S, asked = np.empty((n, model.size)), np.zeros((n, nx)), []
    steps = wide * _steps(model, theta)
    for k, step in enumerate(steps):
        moved = theta.copy()
        if bounds is not None and theta[k] + step > bounds[1][k]:
            steps[k] = -step
        moved[k] += steps[k]
        asked.append((moved, X0))
    own = (1e-3 if any(e.effect.proximal for e in model.located) else 1e-4) * np.maximum(ranges, 1e-9)
    for i in range(nx if want_states else 0):
        moved = X0.copy()
        moved[:, i] += own[i]
        asked.append((theta, moved))
    found = [(simulated - Y) / sigma for simulated in model.simulate_many(asked, data)]
    for k in range(model.size):
        G[:, k] = np.clip(found[k] / steps[k], -1e9, 1e9).ravel()
    for i, change in enumerate(found[model.size:]):
        S[:, i] = np.clip(change, -1e9, 1e9).ravel() / own[i]
    return Jacobian(G, S)


def output_rows(data: Dataset) -> list[slice]:
    """Rows of every segment among outputs laid out sample by sample, as `Jacobian` holds them."""
    ny = data.Y.shape[1]
    return [slice(int(a) * ny, int(b) * ny) for a, b in data.segments[:, :2]]


def _step(J: Jacobian, r, rows, prior, theta, mu, ranges):
    """One damped Gauss-Newton step with start states eliminated; returns (globals, starts)."""
    n = J.G.shape[1]
    H, g = J.G.T @ J.G, J.G.T @ r
    H[np.arange(n), np.arange(n)] += prior**2
    g = g - prior**2 * theta
    H[np.arange(n), np.arange(n)] *= 1 + mu
    H[np.arange(n), np.arange(n)] += 1e-12 * (1 + np.max(np.diag(H), initial=0.0))
    saved = []
    for s in rows:
        S = J.S[s] * ranges
        A = S.T @ S
        A[np.diag_indices_from(A)] *= 1 + mu
        A[np.diag_indices_from(A)] += 1e-10 * (np.trace(A) + 1e-12) + 1e-12
        B, b = S.T @ J.G[s], S.T @ r[s]
        try:
            AB = np.linalg.solve(A, np.column_stack([B, b]))
        except np.linalg.LinAlgError:
            return None
        H -= B.T @ AB[:, :-1]
        g = g - B.T @ AB[:, -1]
        saved.append(AB)
    H[np.arange(n), np.arange(n)] += 1e-10 * (1 + np.abs(np.diag(H)).max(initial=0.0))
    try:
        d = np.linalg.solve(H, g) if n else np.zeros(0)
    except np.linalg.LinAlgError:
        return None
    starts = np.array([(AB[:, -1] - AB[:, :-1] @ d) * ranges for AB in saved])
    return d, starts


def fit_model(model: Model, data: Dataset, sigma, theta, X0, ranges, iterations: int = 25, tol: float = 1e-4,
              hold_globals: bool = False) -> Fit:
    """Fit from one start.

    Parameters
    ----------
    sigma : (ny,) residual weights, in the outputs' units.
    theta : (model.size,) start of the global parameters.
    X0 : (n_segments, nx) start states; more columns where an effect hides a store (see `Model.opened`).
    ranges : (nx,) magnitudes of the states, for scaling and difference steps.
    hold_globals : fit the start states only, as for held-out recordings.
    """
    rows = output_rows(data)
    low, high = model.bounds(data.sample_time)
    prior = np.concatenate([1 / np.log1p(model.settings.tolerance), np.zeros(model.nz)])
    theta = np.clip(np.asarray(theta, dtype=float), low, high)
    X0, ranges = model.opened(X0), model.start_ranges(ranges)
    Y, X = model.simulate(theta, X0, data)
    r = weighted(Y, data, sigma)
    cost = r @ r + np.sum((prior * theta) ** 2)
    mu, done = 1e-3, 0
    widths = list(WIDTHS) if _rough(model) and iterations >= 10 and not hold_globals else [1.0]
    while done < iterations:
        done += 1
        if hold_globals:
            J = jacobian(_Frozen(model, theta), theta[:0], X0, data, sigma, Y, ranges)
        else:
            J = jacobian(model, theta, X0, data, sigma, Y, ranges, bounds=(low, high), wide=widths[0])
        improved = False
        for _ in range(7):
            step = _step(J, r, rows, prior[:0] if hold_globals else prior,
                         theta[:0] if hold_globals else theta, mu,
                         ranges)
            if step is None:
                mu *= 10
                continue
            new = theta if hold_globals else np.clip(theta + step[0], low, high)
            X0n = model.filled(X0 + step[1])
            Yn, Xn = model.simulate(new, X0n, data)
            rn = weighted(Yn, data, sigma)
            cn = rn @ rn + np.sum((prior * new) ** 2)
            if np.isfinite(cn) and cn < cost:
                improved = True
                break
            mu = max(mu, 1e-6) * 8
        if not improved:
            widths.pop(0)
            if not widths:
                break
            mu = 1e-3
            continue
        gain = (cost - cn) / max(cost, 1e-300)
        theta, X0, Y, X, r, cost = new, X0n, Yn, Xn, rn, cn
        mu = max(mu / 8, 1e-9)
        if gain < tol:
            widths.pop(0)
            if not widths:
                break
            mu = 1e-3
    return Fit(model, theta, X0, float(cost), Y, X, done)


class _Frozen:
    """A model whose globals are fixed, so that only start states are differentiated."""

    def __init__(self, model, theta):
        self._model, self._theta, self.located, self.np = model, theta, (), 0
        self.size, self.opened, self.start_ranges = 0, model.opened, model.start_ranges

    def simulate(self, _, X0, data):
        return self._model.simulate(self._theta, X0, data)

    def simulate_many(self, asked, data):
        return self._model.simulate_many([(self._theta, X0) for _, X0 in asked], data)


def fit_starts(model: Model, data: Dataset, sigma, theta, X0, ranges, iterations: int = 8) -> Fit:
    """Fit the start states with everything else held."""
    return fit_model(model, data, sigma, theta, X0, ranges, iterations, 1e-5, hold_globals=True)
