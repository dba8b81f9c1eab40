"""PWARegressor: the whole procedure as a scikit-learn estimator."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from scipy import sparse
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from pwaid.delaunay import SimplexMesh
from pwaid.errors import InputError
from pwaid.lambda_max import lambda_max
from pwaid.lerp import barycentric_rows, hinge_matrix
from pwaid.path import RULES, fold_labels, fold_squares, lambda_grid
from pwaid.problem import HingeProblem
from pwaid.pwa_map import OUTSIDE_RULES, PWAMap
from pwaid.solve import check_lambda, solve

__all__ = ["PWARegressor"]

# Facets multiply with each dimension (docs/limits.md); above this many inputs some enter linearly.
MESH_DIMENSIONS = 4
CHOSEN_DIMENSIONS = 3
# On the squared coefficients of standardised linear inputs, a sample: makes them unique when inputs repeat each other.
RIDGE = 1e-8


def _varies(X: np.ndarray) -> np.ndarray:
    """Which columns vary, by more than rounding."""
    return np.ptp(X, axis=0) > 1e-12 * np.abs(X).max(axis=0, initial=0.0)


class PWARegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):
    """Continuous piecewise-affine regression by ℓ1-sparse hinges on a Delaunay mesh.

    The model is f(x) = Π(x_H) + β·x_L: a PWA map of the inputs H that are meshed, and a linear term of the rest.

    Parameters
    ----------
    n_points : int
        Number of mesh vertices, placed with the density of the data.
    lam : "cv" or float
        λ by K-fold cross-validation, or a given λ > 0 (loss ½‖y − ŷ‖², a sum over samples).
    lam_ratio : float, optional
        λ as a fraction of λmax instead; overrides `lam`.
    weighting : {"htv", "pairs", "hinge"}
        What the penalty measures; ``"htv"`` does not depend on the mesh.
    cv : int
        Number of folds.
    folds : {"random", "blocks"}
        Random folds, or runs of neighbouring samples (time series).
    rule : {"min", "1se"}
        The λ of least held-out error, or the largest within one standard error of it.
    n_lambdas, ratio : int, float
        The grid of λ, from λmax to ratio·λmax.
    hinge_features : "auto" or sequence of int
        Which inputs are meshed. ``"auto"``: all when there are at most four, else the three whose own PWA curve
        explains most of what a linear fit leaves; the others enter linearly.
    outside : {"affine", "nan", "raise"}
        What `predict` does outside the mesh.
    tol : float
        Certified relative gap of the solutions.
    random_state : int, Generator or None
        For mesh and folds.

    Attributes
    ----------
    maps_ : list of PWAMap
        One an output, over the meshed inputs.
    linear_ : ndarray, shape (n_outputs, n_linear_features)
        β.
    lam_ : ndarray, shape (n_outputs,)
        The λ used.
    mesh_ : SimplexMesh
    hinge_features_, linear_features_ : ndarray of int
    gaps_ : ndarray, shape (n_outputs,)
        Certified gaps.
    cv_rmse_, lambdas_ : list of ndarray
        Cross-validation error over λ, when λ was chosen so.

    Raises
    ------
    InputError
        (a ValueError) NaN, constant or collinear meshed inputs, too few samples, unknown options.
    """

    def __init__(
        self,
        n_points: int = 2000,
        *,
        lam: Any = "cv",
        lam_ratio: float | None = None,
        weighting: str = "htv",
        cv: int = 5,
        folds: str = "random",
        rule: str = "min",
        n_lambdas: int = 20,
        ratio: float = 1e-4,
        hinge_features: Any = "auto",
        outside: str = "affine",
        tol: float = 1e-3,
        random_state: Any = None,
    ):
        self.n_points = n_points
        self.lam = lam
        self.lam_ratio = lam_ratio
        self.weighting = weighting
        self.cv = cv
        self.folds = folds
        self.rule = rule
        self.n_lambdas = n_lambdas
        self.ratio = ratio
        self.hinge_features = hinge_features
        self.outside = outside
        self.tol = tol
        self.random_state = random_state

    # -- fitting ---------------------------------------------------------------------------------------------

    def fit(self, X: Any, y: Any) -> PWARegressor:
        """Learn the map.

        Parameters
        ----------
        X : array_like, shape (N, n_features)
        y : array_like, shape (N,) or (N, n_outputs)
        """
        for name, value, known in (("rule", self.rule, RULES), ("outside", self.outside, OUTSIDE_RULES)):
            if value not in known:
                raise InputError(f"{name} is {value!r}; expected one of {', '.join(map(repr, known))}")
        X, y = validate_data(self, X, y, dtype=float, multi_output=True, y_numeric=True)
        self._single = y.ndim == 1
        Y = y[:, None] if self._single else y
        if len(X) < 3:
            raise InputError(f"{len(X)} samples came; at least 3 samples are needed (n_samples = {len(X)})")
        rng = np.random.default_rng(self._seed())
        self.hinge_features_ = self._choose(X, Y)
        self.linear_features_ = np.setdiff1d(np.arange(X.shape[1]), self.hinge_features_)
        inputs = X[:, self.hinge_features_]
        self.mesh_ = SimplexMesh.from_data(inputs, self.n_points, rng)
        simplex, weights = self.mesh_.locate(inputs)
        self.mesh_.require_inside(simplex, inputs)
        rest = X[:, self.linear_features_]
        self._centre = rest.mean(axis=0)
        self._size = np.where(_varies(rest), rest.std(axis=0), np.inf)  # what never moved counts for nothing
        A = self._extended(barycentric_rows(self.mesh_, simplex, weights), rest)
        F = hinge_matrix(self.mesh_, self.weighting)
        F = sparse.csr_matrix(sparse.hstack([F, sparse.csr_matrix((F.shape[0], rest.shape[1]))]))
        label = self._folds(len(X), rng)
        results = [self._fit_output(A, F, column, label) for column in Y.T]
        solutions, self.lambdas_, self.cv_rmse_ = map(list, zip(*results, strict=True))
        n = self.mesh_.n_points
        self.maps_ = [PWAMap(self.mesh_, s.values[:n]) for s in solutions]
        self.linear_ = np.array([s.values[n:] for s in solutions])
        self.lam_ = np.array([s.lam for s in solutions])
        self.gaps_ = np.array([s.gap for s in solutions])
        return self

    def _fit_output(self, A, F, y, label):
        """Choose λ for one output and solve on all samples."""
        problem = self._problem(A, F, y)
        if problem.is_affine:
            return solve(problem, 1.0), np.array([]), np.array([])
        if self.lam_ratio is not None:
            lam = check_lambda(self.lam_ratio) * float(lambda_max(problem))
        elif isinstance(self.lam, str):
            if self.lam != "cv":
                raise InputError(f"lam is {self.lam!r}; expected 'cv' or a positive number")
            return self._cross_validated(problem, A, F, y, label)
        else:
            lam = check_lambda(self.lam)
        return solve(problem, lam, tol=self.tol), np.array([]), np.array([])

    def _cross_validated(self, problem, A, F, y, label):
        grid = lambda_grid(float(lambda_max(problem)), self.n_lambdas, self.ratio)

        def pose(train):
            return self._problem(A[train], F, y[train])

        def judge(test):
            return lambda solution: float(np.mean((y[test] - A[test] @ solution.values) ** 2))

        squared, lost = fold_squares(label, grid, pose, judge, self.tol)
        for note in lost:
            warnings.warn(note, stacklevel=4)
        mean = squared.mean(axis=0)
        best = int(np.argmin(mean))
        if self.rule == "1se":
            error = squared.std(axis=0, ddof=min(1, len(squared) - 1))[best] / np.sqrt(len(squared))
            best = int(np.flatnonzero(mean <= mean[best] + error)[0])
        return solve(problem, grid[best], tol=self.tol), grid, np.sqrt(mean)

    def _problem(self, A, F, y) -> HingeProblem:
        """The problem with the linear block appended; both blocks' affine functions cost nothing."""
        n, k = self.mesh_.n_points, A.shape[1] - self.mesh_.n_points
        if k:
            ridge = sparse.hstack([sparse.csr_matrix((k, n)), np.sqrt(RIDGE * len(y)) * sparse.eye_array(k)])
            A, y = sparse.csr_matrix(sparse.vstack([A, ridge])), np.append(y, np.zeros(k))
        affine = np.column_stack([np.ones(n), self.mesh_.normalised])
        basis = np.zeros((n + k, affine.shape[1] + k))
        basis[:n, : affine.shape[1]] = np.linalg.qr(affine)[0]
        basis[n:, affine.shape[1] :] = np.eye(k)
        return HingeProblem(A, F, y, affine_basis=basis)

    def _extended(self, A: sparse.csr_matrix, rest: np.ndarray) -> sparse.csr_matrix:
        return sparse.csr_matrix(sparse.hstack([A, sparse.csr_matrix((rest - self._centre) / self._size)]))

    def _seed(self) -> Any:
        state = self.random_state
        return state.randint(2**31 - 1) if isinstance(state, np.random.RandomState) else state

    def _folds(self, n: int, rng: np.random.Generator) -> np.ndarray:
        return fold_labels(n, min(int(self.cv), n), self.folds, rng)

    def _choose(self, X: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """The inputs that are meshed; constant ones never are."""
        varies = np.flatnonzero(_varies(X))
        if not isinstance(self.hinge_features, str):
            chosen = np.asarray(self.hinge_features)
            mask = chosen.dtype == bool and chosen.shape == (X.shape[1],)
            chosen = np.flatnonzero(chosen) if mask else np.unique(chosen.astype(int))
            if chosen.size == 0 or chosen.min() < 0 or chosen.max() >= X.shape[1]:
                raise InputError(f"hinge_features is {self.hinge_features!r}; expected columns 0 to {X.shape[1] - 1}")
            return chosen
        if self.hinge_features != "auto":
            raise InputError(f"hinge_features is {self.hinge_features!r}; expected 'auto' or column numbers")
        if varies.size == 0:
            raise InputError("every input is constant; expected at least one that varies")
        if varies.size <= MESH_DIMENSIONS:
            return varies
        gains = [_curve_gain(X, Y, j) for j in varies]
        return np.sort(varies[np.argsort(gains)[::-1][:CHOSEN_DIMENSIONS]])

    # -- using -----------------------------------------------------------------------------------------------

    def predict(self, X: Any) -> np.ndarray:
        """Outputs, shape (N,) or (N, n_outputs)."""
        check_is_fitted(self)
        X = validate_data(self, X, dtype=float, reset=False)
        inputs = X[:, self.hinge_features_]
        rest = (X[:, self.linear_features_] - self._centre) / self._size
        columns = [f(inputs, outside=self.outside) + rest @ b for f, b in zip(self.maps_, self.linear_, strict=True)]
        return columns[0] if self._single else np.column_stack(columns)


def _curve_gain(X: np.ndarray, Y: np.ndarray, j: int, n_knots: int = 8) -> float:
    """Share of the linear fit's squared residual that a PWA curve of input j removes (knots at quantiles)."""
    linear = np.column_stack([np.ones(len(X)), X])
    knots = np.unique(np.quantile(X[:, j], np.linspace(0, 1, n_knots + 2)[1:-1]))
    hinges = np.maximum(X[:, [j]] - knots, 0.0)

    def left(design: np.ndarray) -> float:
        return float(np.sum((Y - design @ np.linalg.lstsq(design, Y, rcond=None)[0]) ** 2))

    before = left(linear)
    return 1.0 - left(np.column_stack([linear, hinges])) / before if before > 0 else 0.0
