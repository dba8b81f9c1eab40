"""Prox-linear method: the nonsmooth minimax with exact spectral-norm cones.

    minimise over d, t   t + (mu/2) |d|²   subject to   || E_k + sum_i dE_k,i d_i ||_2 <= t   for active
    (case, omega) k

is the linearised problem (18) kept whole: no cutting planes, the spectral norm of each linearised error
enters as a positive semidefinite cone. Trial frequencies of a rejected step join the set. d is relative:
theta + scale * d. The iteration ends when the unweighted local model promises nothing more.
"""

from __future__ import annotations

import clarabel
import numpy as np
import scipy.sparse as sp

from pwaid.hinfstruct.nonsmooth import NonsmoothRun
from pwaid.hinfstruct.problem import ActiveSet, MatchingProblem
from pwaid.hinfstruct.smooth import parameter_scale

__all__ = ["prox_linear"]


def prox_linear(
    problem: MatchingProblem,
    theta: np.ndarray,
    *,
    max_iterations: int = 80,
    tol: float = 1e-5,
    fraction: float = 0.5,
    radius: float = 0.5,
    target: float = 0.0,
    scale: np.ndarray | None = None,
) -> NonsmoothRun:
    """Minimise the H-infinity error from a stable start.

    Parameters
    ----------
    tol : float
        Stop when the local model, with a proximity weight mu of at most 1e-3 of the value, promises a
        relative decrease below this within relative parameter steps of ``radius``.
    fraction : float
        Peaks of at least this fraction of the norm enter the local model.
    radius : float
        Largest relative step the local model may take.
    target : float
        Stop when the value is within 1e-4 of this (a known lower bound).
    scale : array, optional
        Size of each parameter, kept fixed; default their present absolute values.
    """
    found = problem.active(theta, fraction)
    if found is None:
        return NonsmoothRun(theta, np.inf, np.inf, False, np.array([np.inf]))
    value, active = found
    fixed, scale = scale, parameter_scale(theta) if scale is None else scale
    low, high = problem.bounds
    mu, trace, predicted = 1e-2 * value, [value], np.inf
    extra: list[tuple[int, float]] = []
    for _ in range(max_iterations):
        if value <= target * (1 + 1e-4) or value <= 1e-13 * problem.gain:
            return NonsmoothRun(theta, value, 0.0, True, np.array(trace))
        model = _with_extra(problem, theta, active, extra)
        step, bound = _solve(model, scale, mu, radius, (low - theta) / scale, (high - theta) / scale)
        if step is None:
            mu *= 10.0
            if mu > 1e8 * value:
                break
            continue
        predicted = (value - bound) / value
        if predicted <= tol:
            # A heavily weighted step promises little by itself: ask the unweighted model before stopping.
            if mu <= 1e-3 * value:
                return NonsmoothRun(theta, value, max(predicted, 0.0), True, np.array(trace))
            mu = 1e-4 * value
            continue
        trial = problem.active(theta + scale * step, fraction)
        gained = -np.inf if trial is None else (value - trial[0]) / (value - bound)
        if gained >= 0.05:
            theta, (value, active) = theta + scale * step, trial
            scale, extra = parameter_scale(theta) if fixed is None else fixed, extra[-6:]
            mu = mu * (0.25 if gained > 0.7 else 1.0)
        else:
            mu = max(4.0 * mu, 1e-5 * value)
            if trial is not None:
                fresh = trial[1].gains() >= 0.9 * trial[0]
                extra = extra[-12:] + list(zip(trial[1].case[fresh], trial[1].omega[fresh], strict=True))
        trace.append(value)
        if mu > 1e8 * value:
            break
    return NonsmoothRun(theta, value, float(predicted), False, np.array(trace))


def _with_extra(problem: MatchingProblem, theta: np.ndarray, active: ActiveSet, extra) -> ActiveSet:
    if not extra:
        return active
    more = problem.linearise(theta, [e[0] for e in extra], [e[1] for e in extra])
    return ActiveSet(
        *(np.concatenate([getattr(active, f), getattr(more, f)]) for f in ("case", "omega", "error", "slope"))
    )


def _solve(active: ActiveSet, scale, mu, radius, low, high) -> tuple[np.ndarray | None, float]:
    """The conic problem; returns (relative step, linearised maximum)."""
    slope = active.slope * scale[None, :, None, None]
    k, size, ny, nu = slope.shape
    side = ny + nu
    # Complex Hermitian [[t I, E], [E*, t I]] as a real symmetric matrix of twice the size.
    blocks = np.zeros((k, size + 2, 2 * side, 2 * side))
    blocks[:, 0] = _embed(active.error, ny)
    blocks[:, 1 : size + 1] = _embed(slope, ny)
    blocks[:, size + 1] = np.eye(2 * side)
    svec = _svec(blocks)  # (k, size + 2, rows)
    # s = b - A x in the cone: b = constant, A = -(columns of d and t).
    cone_a = -np.moveaxis(svec[:, 1:], 1, 2).reshape(-1, size + 1)
    cone_b = svec[:, 0].ravel()
    eye = np.hstack([np.eye(size), np.zeros((size, 1))])
    box_a, box_b = np.vstack([eye, -eye]), np.concatenate(
        [np.minimum(radius, high), np.minimum(radius, -low)]
    )
    unit = float(active.gains().max())
    cone_a[:, -1] *= unit  # t in units of the present value
    A = sp.csc_matrix(np.vstack([box_a, cone_a / unit]))
    b = np.concatenate([box_b, cone_b / unit])
    P = sp.diags([*np.full(size, mu / unit), 0.0]).tocsc()
    q = np.concatenate([np.zeros(size), [1.0]])
    cones = [clarabel.NonnegativeConeT(2 * size), *[clarabel.PSDTriangleConeT(2 * side)] * k]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 60
    settings.max_threads = 1
    solution = clarabel.DefaultSolver(P, q, A, b, cones, settings).solve()
    x = np.array(solution.x)
    if str(solution.status) not in ("Solved", "AlmostSolved") or not np.isfinite(x).all():
        return None, np.inf
    step = np.clip(x[:-1], -np.minimum(radius, -low), np.minimum(radius, high))
    return step, float(active.gains(scale * step).max())


def _embed(E: np.ndarray, ny: int) -> np.ndarray:
    """[[0, E], [E*, 0]] as real symmetric matrices [[Re, -Im], [Im, Re]]."""
    side = E.shape[-1] + ny
    H = np.zeros((*E.shape[:-2], side, side), dtype=complex)
    H[..., :ny, ny:] = E
    H[..., ny:, :ny] = np.conj(np.swapaxes(E, -1, -2))
    return np.concatenate(
        [np.concatenate([H.real, -H.imag], axis=-1), np.concatenate([H.imag, H.real], axis=-1)], axis=-2
    )


def _svec(M: np.ndarray) -> np.ndarray:
    """Upper triangle column by column, off-diagonal entries times sqrt(2): Clarabel's order."""
    n = M.shape[-1]
    j, i = np.tril_indices(n)  # column-major upper triangle: i <= j
    return M[..., i, j] * np.where(i == j, 1.0, np.sqrt(2.0))
