"""Proximity-control bundle method of Vizer et al. (2014), sections 2.5-2.6, for F(theta) = ||error||_inf².

At the serious iterate x the ideal model is, with Sigma the error and d the (relative) step,

    phi(d) = max_omega lambda_1( Sigma* Sigma + (dSigma d)* Sigma + Sigma* (dSigma d) ),
    (18)

approached from below by cutting planes alpha + g'd: for a unit eigenvector e at a trial step, alpha = |Sigma
e|² and g_i = 2 Re e* Sigma* (d_i Sigma) e, the vector of partial derivatives (the printed (20) is one
directional derivative). Each trial minimises the planes plus (tau/2)|d|². A trial that lowers F enough
becomes the next x; otherwise planes at the trial are added, and tau grows when the ideal model itself was too
optimistic.
"""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
import scipy.sparse as sp

from pwaid.hinfstruct.problem import ActiveSet, MatchingProblem
from pwaid.hinfstruct.smooth import parameter_scale
from pwaid.hinfstruct.statespace import freeze

__all__ = ["NonsmoothRun", "proximity_bundle"]


@dataclass(frozen=True)
class NonsmoothRun:
    """Where a nonsmooth method ended.

    Attributes
    ----------
    theta : array
    value : float
        max_i ||error_i||_inf at theta.
    predicted : float
        Relative decrease that the last local model still promises; at most the tolerance when converged.
    converged : bool
    trace : array
        The value after each iteration, the start first.
    """

    theta: np.ndarray
    value: float
    predicted: float
    converged: bool
    trace: np.ndarray

    def __post_init__(self):
        freeze(self)


def proximity_bundle(
    problem: MatchingProblem,
    theta: np.ndarray,
    *,
    max_iterations: int = 300,
    tol: float = 1e-5,
    target: float = 0.0,
) -> NonsmoothRun:
    """Minimise the H-infinity error from a stable start by the proximity-control bundle method.

    Parameters
    ----------
    max_iterations : int
        Trial points, serious or not.
    tol : float
        Stop when the cutting-plane model promises a relative decrease of F below this.
    target : float
        Stop when the value is within 1e-4 of this known lower bound.
    """
    found = problem.active(theta, 0.3)
    if found is None:
        return NonsmoothRun(theta, np.inf, np.inf, False, np.array([np.inf]))
    value, active = found
    tau, trace, predicted = value**2, [value], np.inf
    scale = parameter_scale(theta)
    ideal = _ideal_set(problem, theta, active)
    planes = _planes(ideal, np.zeros_like(theta), 0.5)
    low, high = problem.bounds
    for _ in range(max_iterations):
        if value <= target * (1 + 1e-4) or value <= 1e-13 * problem.gain:
            return NonsmoothRun(theta, value, 0.0, True, np.array(trace))
        step, model_value, weights = _trial(planes, scale, tau)
        F = value**2
        predicted = (F - model_value) / F
        if predicted <= tol:
            return NonsmoothRun(theta, value, max(predicted, 0.0), True, np.array(trace))
        new_theta = np.clip(theta + scale * step, low, high)
        trial = problem.active(new_theta, 0.3)
        gained = -np.inf if trial is None else (F - trial[0] ** 2) / (F - model_value)
        if gained >= 0.1:
            theta, (value, active) = new_theta, trial
            scale = parameter_scale(theta)
            ideal = _ideal_set(problem, theta, active)
            planes = _planes(ideal, np.zeros_like(theta), 0.5)
            tau = tau * 0.5 if gained > 0.5 else tau
        else:
            if trial is not None:  # frequencies that became high at the trial belong to the ideal model
                keep = trial[1].gains() >= 0.9 * trial[0]
                extra = problem.linearise(theta, trial[1].case[keep], trial[1].omega[keep])
                ideal = _join(ideal, extra)
            ideal_value = float(_ideal_gains(ideal, scale * step).max())
            if (F - ideal_value) / (F - model_value) >= 0.3:
                tau *= 2.0  # the ideal model agrees with the planes, yet F does not fall: stay closer
            planes = _add(planes, _planes(ideal, scale * step, 0.9), weights)
            if tau > 1e12 * F:
                break
        trace.append(value)
    return NonsmoothRun(theta, value, float(predicted), False, np.array(trace))


def _ideal_set(problem: MatchingProblem, theta: np.ndarray, active: ActiveSet) -> ActiveSet:
    """Peaks and a coarse grid, linearised at the serious iterate."""
    grid = problem.grid(24)
    cases = np.repeat(np.arange(len(problem.models)), grid.size)
    return _join(active, problem.linearise(theta, cases, np.tile(grid, len(problem.models))))


def _join(a: ActiveSet, b: ActiveSet) -> ActiveSet:
    return ActiveSet(
        *(np.concatenate([getattr(a, f), getattr(b, f)]) for f in ("case", "omega", "error", "slope"))
    )


def _hermitian(ideal: ActiveSet, step: np.ndarray) -> np.ndarray:
    change = np.einsum("p,kpyu->kyu", step, ideal.slope)
    adjoint = np.conj(np.swapaxes(ideal.error, 1, 2))
    cross = adjoint @ change
    return adjoint @ ideal.error + cross + np.conj(np.swapaxes(cross, 1, 2))


def _ideal_gains(ideal: ActiveSet, step: np.ndarray) -> np.ndarray:
    return np.linalg.eigvalsh(_hermitian(ideal, step))[:, -1]


def _planes(ideal: ActiveSet, step: np.ndarray, fraction: float) -> tuple[np.ndarray, np.ndarray]:
    """Cutting planes (alpha, g) of the ideal model at the frequencies with at least ``fraction`` of its value
    there.
    """
    values, vectors = np.linalg.eigh(_hermitian(ideal, step))
    top = values[:, -1].max()
    rows = values[:, -1] >= top - (1 - fraction) * abs(top)
    e = vectors[rows, :, -1]
    image = np.einsum("kyu,ku->ky", ideal.error[rows], e)
    alpha = np.sum(np.abs(image) ** 2, axis=1)
    g = 2 * np.einsum("ky,kpyu,ku->kp", image.conj(), ideal.slope[rows], e).real
    return alpha, g


def _add(planes, new, weights):
    """Keep the planes that carried weight and their aggregate, add the new ones."""
    alpha, g = planes
    used = weights > 1e-6
    return (
        np.concatenate([alpha[used], [weights @ alpha], new[0]]),
        np.vstack([g[used], weights @ g, new[1]]),
    )


def _trial(planes, scale: np.ndarray, tau: float) -> tuple[np.ndarray, float, np.ndarray]:
    """Step minimising max_j (alpha_j + g_j' d) + (tau/2)|d|²: its dual is a quadratic over the simplex."""
    alpha, g = planes
    g = g * scale
    unit = float(alpha.max())
    m = alpha.size
    # Dual, in units of F: minimise |g'w|²/(2 tau unit) - alpha'w/unit over w >= 0, sum w = 1, written with r
    # = g'w.
    root = g.T / np.sqrt(tau * unit)
    n = root.shape[0]
    P = sp.diags([*np.zeros(m), *np.ones(n)]).tocsc()
    q = np.concatenate([-alpha / unit, np.zeros(n)])
    top = np.concatenate([np.ones(m), np.zeros(n)])[None]
    A = sp.csc_matrix(
        np.vstack([top, np.hstack([root, -np.eye(n)]), np.hstack([-np.eye(m), np.zeros((m, n))])])
    )
    b = np.concatenate([[1.0], np.zeros(n + m)])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    cones = [clarabel.ZeroConeT(1 + n), clarabel.NonnegativeConeT(m)]
    w = np.maximum(np.array(clarabel.DefaultSolver(P, q, A, b, cones, settings).solve().x)[:m], 0.0)
    w = w / w.sum() if w.sum() > 0 else np.full(m, 1 / m)
    step = -(w @ g) / tau
    return step, float(np.max(alpha + g @ step)), w
