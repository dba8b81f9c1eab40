"""λ paths with warm starts, and the choice of λ by data the fit has not seen.

The useful range of λ is known in advance: at λmax the map is flat, and some decades below it follows the noise
(2014 section 5.1). A path solves a log grid downwards, each λ started from its neighbour.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from pwaid.delaunay import SimplexMesh
from pwaid.errors import InputError
from pwaid.lambda_max import lambda_max
from pwaid.problem import HingeProblem
from pwaid.pwa_map import PWAMap
from pwaid.recording import check_finite, check_samples
from pwaid.solution import Path, Solution, Status
from pwaid.solve import METHODS, solve

__all__ = ["RULES", "cross_validate", "fold_labels", "fold_squares", "lambda_grid", "solve_path"]

RULES = ("min", "1se")
UNDETERMINED = (
    "fold {} is left out of the cross-validation: without it the samples do not determine an affine function, since an "
    "input moves there only"
)
NO_FOLD = (
    "every fold holds all movement of some input, so none can be held out; use random folds, or choose λ by other data"
)
Progress = Callable[[int, int, Solution], None]


def lambda_grid(largest: float, n_lambdas: int = 30, ratio: float = 1e-4, start: float = 1.0) -> np.ndarray:
    """`n_lambdas` values from start·largest down to ratio·largest, evenly spaced in the logarithm."""
    if n_lambdas < 1 or int(n_lambdas) != n_lambdas:
        raise InputError(f"n_lambdas is {n_lambdas}; expected a whole number of at least 1")
    if not 0.0 < ratio < start:
        raise InputError(f"ratio is {ratio} and start {start}; expected 0 < ratio < start")
    return np.geomspace(start * largest, ratio * largest, int(n_lambdas))


def solve_path(
    problem: HingeProblem,
    *,
    n_lambdas: int = 30,
    ratio: float = 1e-4,
    start: float = 1.0,
    lambdas: Any = None,
    tol: float = 1e-4,
    method: str = "auto",
    X_val: Any = None,
    y_val: Any = None,
    mesh: SimplexMesh | None = None,
    rule: str = "min",
    warm_start: bool = True,
    progress: Progress | None = None,
) -> Path:
    """Solve the hinge problem over a decreasing grid of λ.

    Parameters
    ----------
    problem : HingeProblem
    n_lambdas, ratio, start : int, float, float
        The grid: λ from start·λmax to ratio·λmax (2014 Example 1 uses start = 2, ratio = 1e-4).
    lambdas : array_like, optional
        An explicit grid instead; sorted downwards.
    tol : float
        Certified relative gap of every solution.
    method : str
        As in `solve`.
    X_val, y_val : array_like, shapes (M, d) and (M,), optional
        Held-out data; need `mesh`. Points outside the mesh are left out and counted in `Path.warnings`.
    mesh : SimplexMesh, optional
        The problem's mesh; every solution then carries its map.
    rule : {"min", "1se"}
        What `Path.best` is: the least held-out RMSE, or the largest λ within one standard error of it.
    warm_start : bool
        Start each λ from its neighbour; False only to measure what that saves.
    progress : callable, optional
        Called as progress(i, n, solution) after each λ.

    Returns
    -------
    Path
        One solution a λ, or one at λ = 1 where λmax is 0. A λ whose solve fails keeps its place with the status
        ``FAILED``.
    """
    _check_options(rule, method)
    if (X_val is None) != (y_val is None):
        raise InputError("give both X_val and y_val, or neither")
    if X_val is not None and mesh is None:
        raise InputError("held-out data came without mesh=; pass the problem's mesh to evaluate the maps")
    judge = None if X_val is None else _HeldOut(mesh, X_val, y_val)
    notes = [] if judge is None else list(judge.notes)
    if mesh is not None and mesh.n_points != problem.n_points:
        raise InputError(f"the mesh has {mesh.n_points} points, the problem {problem.n_points}; pass its own mesh")
    if problem.is_affine:
        why = "the output is an affine function of the inputs to rounding" if problem.is_exact else (
            "no hinge of this mesh lowers the error of the affine fit")
        notes.append(f"{why}: λmax is 0 and the map is flat")
        grid, largest = np.array([1.0]), 0.0
    else:
        largest = float(lambda_max(problem)) if lambdas is None else np.nan
        grid = lambda_grid(largest, n_lambdas, ratio, start) if lambdas is None else _explicit(lambdas)
    solutions = _solve_grid(problem, grid, tol, method, mesh, warm_start, progress)
    path = Path(grid, tuple(solutions), largest, rule=rule, warnings=tuple(notes))
    if judge is None:
        return path
    errors = np.array([judge.rmse(s) for s in solutions])
    return replace(path, validation_rmse=errors[:, 0], validation_se=errors[:, 1])


def cross_validate(
    mesh: SimplexMesh,
    X: Any,
    y: Any,
    *,
    k: int = 5,
    folds: str = "random",
    weighting: str = "pairs",
    n_lambdas: int = 30,
    ratio: float = 1e-4,
    start: float = 1.0,
    tol: float = 1e-4,
    method: str = "auto",
    rule: str = "min",
    rng: Any = None,
    outside: str = "raise",
    progress: Progress | None = None,
) -> Path:
    """A path on all data whose error at each λ comes from K-fold cross-validation.

    A fold's λ is scaled by its share of the samples, since the loss is a sum over them.

    Parameters
    ----------
    mesh, X, y, weighting, outside
        As in `HingeProblem.from_data`.
    k : int
        Number of folds, at least 2.
    folds : {"random", "blocks"}
        Random samples, or k runs of neighbouring samples: use blocks for time series, whose neighbours repeat each
        other.
    rng : seed or Generator, optional
        For random folds.

    Returns
    -------
    Path
        `validation_rmse` is the root of the mean squared error over folds; `validation_se` its standard error from
        the spread between folds. Folds without which the samples do not determine an affine function are left out
        and named in `warnings`. Where the affine fit is best at every λ the path holds that one solution, and its error
        over all samples.
    """
    _check_options(rule, method)
    X, y = check_samples(X, y, dimension=mesh.dimension)
    problem = HingeProblem.from_data(mesh, X, y, weighting=weighting, outside=outside)
    if problem.is_affine:
        return solve_path(problem, tol=tol, method=method, mesh=mesh, X_val=X, y_val=y, rule=rule, progress=progress)
    label = fold_labels(len(X), k, folds, rng)
    largest = float(lambda_max(problem))
    grid = lambda_grid(largest, n_lambdas, ratio, start)

    def pose(train):
        return HingeProblem.from_data(mesh, X[train], y[train], weighting=weighting, outside=outside)

    def judge(test):
        held = _HeldOut(mesh, X[test], y[test])
        return lambda solution: held.rmse(solution)[0] ** 2

    squared, notes = fold_squares(label, grid, pose, judge, tol, method)
    path = solve_path(problem, lambdas=grid, tol=tol, method=method, mesh=mesh, rule=rule, progress=progress)
    rmse = np.sqrt(squared.mean(axis=0))
    spread = squared.std(axis=0, ddof=min(1, len(squared) - 1)) / np.sqrt(len(squared))
    error = spread / (2.0 * np.maximum(rmse, np.finfo(float).tiny))
    return replace(path, lambda_max=largest, validation_rmse=rmse, validation_se=error,
                   warnings=(*path.warnings, *notes))


def fold_squares(label: np.ndarray, grid: np.ndarray, pose: Callable, judge: Callable, tol: float,
                 method: str = "auto") -> tuple[np.ndarray, list[str]]:
    """Mean squared error on held-out samples, a row a fold and a column a λ; and what to say of folds left out.

    Parameters
    ----------
    label : (N,) fold of every sample. grid : (n,) λ of the problem on all samples.
    pose : from a mask of samples to their `HingeProblem`.
    judge : from the mask of the held-out samples to a function from a `Solution` to their mean squared error.

    Raises
    ------
    InputError
        Where no fold can be held out.
    """
    squared, lost = [], []
    for fold in np.unique(label):
        train = label != fold
        part = pose(train)
        if not part.is_determined:
            lost.append(UNDETERMINED.format(fold))
            continue
        error = judge(~train)
        if part.is_affine:
            squared.append(np.full(len(grid), error(solve(part, 1.0))))
            continue
        path = solve_path(part, lambdas=grid * train.mean(), tol=tol, method=method)
        squared.append([error(s) for s in path.solutions])
    if not squared:
        raise InputError(NO_FOLD)
    return np.array(squared), lost


def fold_labels(n: int, k: int, folds: str = "random", rng: Any = None) -> np.ndarray:
    """A fold number 0…k−1 for each of `n` samples, in random order or in blocks of neighbours."""
    if not 2 <= k <= n:
        raise InputError(f"k = {k} folds of {n} samples; expected 2 ≤ k ≤ {n}")
    if folds not in ("random", "blocks"):
        raise InputError(f"folds is {folds!r}; expected 'random' or 'blocks'")
    label = np.arange(n) * k // n
    return np.random.default_rng(rng).permutation(label) if folds == "random" else label


class _HeldOut:
    """Held-out samples and their RMSE for a solution."""

    def __init__(self, mesh: SimplexMesh, X: Any, y: Any):
        X, y = mesh.check_points(X), np.asarray(y, dtype=float).reshape(-1)
        check_finite(y, "y_val")
        if len(X) != len(y):
            raise InputError(f"X_val has {len(X)} samples and y_val {len(y)}; expected the same number")
        inside = mesh.contains(X)
        if not inside.any():
            raise InputError("every held-out sample lies outside the mesh; are mesh and samples in the same units?")
        self.notes = []
        if not inside.all():
            self.notes.append(f"{int((~inside).sum())} of {len(X)} held-out samples lie outside the mesh: left out")
        self.mesh, self.X, self.y = mesh, X[inside], y[inside]

    def rmse(self, solution: Solution) -> tuple[float, float]:
        """RMSE and its standard error; NaN for a failed solve."""
        if solution.status is Status.FAILED:
            return np.nan, np.nan
        squared = (self.y - PWAMap(self.mesh, solution.values)(self.X)) ** 2
        rmse = float(np.sqrt(squared.mean()))
        error = float(squared.std() / np.sqrt(len(squared)))
        return rmse, error / (2.0 * max(rmse, np.finfo(float).tiny))


def _solve_grid(problem, grid, tol, method, mesh, warm_start, progress) -> list[Solution]:
    """A solution for each λ, with warm_start each from the last one that left a state."""
    solutions: list[Solution] = []
    state = None
    for i, lam in enumerate(grid):
        solution = _attempt(problem, float(lam), tol, method, state, solutions)
        if warm_start and solution.state is not None:
            state = solution.state
        solutions.append(solution if mesh is None else solution.on(mesh))
        if progress is not None:
            progress(i, len(grid), solutions[-1])
    return solutions


def _attempt(problem, lam, tol, method, state, before) -> Solution:
    """A solution, or a place-holder with the status FAILED: a path never dies midway."""
    try:
        return solve(problem, lam, tol=tol, method=method, warm_start=state)
    except InputError:
        raise
    except (ArithmeticError, RuntimeError, ValueError, MemoryError, np.linalg.LinAlgError) as error:
        values = before[-1].values.copy() if before else problem.affine_values.copy()
        return Solution(
            values=values,
            lam=lam,
            objective=problem.objective(values, lam),
            gap=np.inf,
            status=Status.FAILED,
            iterations=0,
            seconds=0.0,
            method=method,
            nu=np.zeros(problem.n_hinges),
            n_broken=problem.n_broken(values),
            message=f"{type(error).__name__}: {error}",
        )


def _check_options(rule: str, method: str) -> None:
    if rule not in RULES:
        raise InputError(f"rule is {rule!r}; expected one of {', '.join(map(repr, RULES))}")
    if method not in METHODS:
        raise InputError(f"method is {method!r}; expected one of {', '.join(map(repr, METHODS))}")


def _explicit(lambdas: Any) -> np.ndarray:
    grid = np.sort(np.asarray(lambdas, dtype=float).ravel())[::-1]
    if grid.size == 0 or not np.all(np.isfinite(grid)) or grid[-1] <= 0:
        raise InputError("lambdas must be positive finite numbers, at least one")
    return grid
