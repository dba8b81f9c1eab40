"""Held-out fits of a piecewise affine map beside a linear block, for the maps of one and of two variables."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import sparse

from pwaid.lambda_max import lambda_max
from pwaid.path import lambda_grid, solve_path
from pwaid.problem import HingeProblem
from pwaid.solve import solve

__all__ = ["BLOCKS", "heldout_errors", "learn_map", "linear_block", "shifted_copies", "time_folds"]

BLOCKS = 20


def time_folds(n: int) -> np.ndarray:
    """Interleaved blocks of neighbours in five folds."""
    return (np.arange(n) * BLOCKS // n) % 5


def heldout_errors(design, penalty, D, w, fold) -> np.ndarray:
    """Weighted squared error, on folds left out, of a ridge fit of every column of D (N, m)."""
    total = np.zeros(D.shape[1])
    small = 1e-9 * np.eye(design.shape[1])
    for f in range(5):
        train, test = fold != f, fold == f
        X = design[train]
        XtW = X.T * w[train]
        H = XtW @ X
        scale = np.trace(H) / len(H)
        b = np.linalg.solve(H + scale * (penalty + small), XtW @ D[train])
        total += w[test] @ (D[test] - design[test] @ b) ** 2
    return total


def linear_block(candidates: Mapping[str, np.ndarray], names) -> np.ndarray:
    """The named candidates as standardised columns (N, len(names))."""
    M = np.column_stack([candidates[n] for n in names])
    return (M - M.mean(axis=0)) / np.maximum(M.std(axis=0), 1e-300)


def shifted_copies(d, rng, count) -> np.ndarray:
    """d (N,) and `count` circular shifts of it, as columns."""
    n = len(d)
    return np.column_stack([d, *(np.roll(d, int(s)) for s in rng.integers(n // 20, n - n // 20, count))])


def _problem(mesh, A, F, y, w, others) -> HingeProblem:
    """The hinge problem of the map with the other candidates as extra linear columns."""
    n, k, root = A.shape[1], others.shape[1], np.sqrt(w)
    rows = sparse.csr_matrix(sparse.hstack([A, sparse.csr_matrix(others)]).multiply(root[:, None]))
    ridge = sparse.hstack([sparse.csr_matrix((k, n)), np.sqrt(1e-8 * len(y)) * sparse.eye_array(k)])
    plane = np.column_stack([np.ones(n), linear_block(dict(enumerate(mesh.points.T)), range(mesh.dimension))])
    basis = np.zeros((n + k, plane.shape[1] + k))
    basis[:n, :plane.shape[1]] = np.linalg.qr(plane)[0]
    basis[n:, plane.shape[1]:] = np.eye(k)
    return HingeProblem(sparse.vstack([rows, ridge]), sparse.hstack([F, sparse.csr_matrix((F.shape[0], k))]),
                        np.append(root * y, np.zeros(k)), affine_basis=basis)


def learn_map(mesh, A, F, d, w, others, fold, base):
    """The ℓ1 map of d over a mesh, beside linear columns; λ by block cross-validation (one standard error rule).

    Parameters
    ----------
    A, F : interpolation (N, n) and hinge matrix of the mesh. d, w : (N,) samples and weights.
    others : (N, k) linear columns. fold : (N,) fold of each sample.
    base : (N, m) columns of the fit that the gain is measured against.

    Returns
    -------
    values (n,), partial (N,): d without the linear columns' share; gain: held-out, over `base`.
    """
    n, size = A.shape[1], float(np.std(d)) or 1.0
    y = d / size
    whole = _problem(mesh, A, F, y, w, others)
    grid = lambda_grid(float(lambda_max(whole)), 10, 1e-4)
    errors = []
    for f in range(5):
        train, test = fold != f, fold == f
        path = solve_path(_problem(mesh, A[train], F, y[train], w[train], others[train]), lambdas=grid * train.mean(),
                          tol=1e-3)
        errors.append([w[test] @ (y[test] - A[test] @ s.values[:n] - others[test] @ s.values[n:]) ** 2
                       for s in path.solutions])
    errors = np.array(errors)
    mean = errors.mean(axis=0)
    best = int(np.argmin(mean))
    within = mean <= mean[best] + errors.std(axis=0, ddof=1)[best] / np.sqrt(5)
    chosen = int(np.flatnonzero(within)[0])
    before = heldout_errors(base, np.zeros((base.shape[1],) * 2), y[:, None], w, fold)[0]
    values = solve(whole, grid[chosen], tol=1e-3).values
    return size * values[:n], d - size * others @ values[n:], float(1.0 - errors[:, chosen].sum() / before)
