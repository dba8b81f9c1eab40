"""NARX / PWARX: a PWA map made into a dynamic model (2014 eq. 21–22).

    y(k) = Π(C φ(k)) + Θ φ(k),   φ(k) = [y(k−1) … y(k−n_a), u(k) … u(k−n_b)]

By default the map bends along every regressor (C = I, no Θ), as in the papers. The number of simplices grows fast
with the dimension, so from four regressors on name the few along which the system is nonlinear (`nonlinear`): the
others enter linearly. This stays the same convex problem, with A extended by the columns Wᵀφ and F by zeros, where
the columns of W span the regressor directions that C does not see.

The mesh lives in C φ, normalised by Σ^(−1/2) of the data (2014 Example 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import null_space

from pwaid.delaunay import SimplexMesh
from pwaid.dynamics.narx_model import NARXModel
from pwaid.dynamics.regressors import Lags, as_recordings
from pwaid.errors import InputError
from pwaid.lambda_max import lambda_max
from pwaid.lerp import barycentric_rows, hinge_matrix
from pwaid.problem import HingeProblem
from pwaid.pwa_map import PWAMap
from pwaid.recording import Recording, check_finite
from pwaid.scaling import Scaling
from pwaid.solve import solve

__all__ = ["NARX", "NARXPath", "NARXProblem"]

# A free run counts as diverged when it exceeds the largest output it was fitted on by this factor.
DIVERGED = 1e3


@dataclass(frozen=True, eq=False)
class NARXPath:
    """Models over a decreasing grid of λ.

    Attributes
    ----------
    lambdas : ndarray, shape (n,)
    models : tuple of NARXModel
    solutions : tuple
        For each λ the solution of each output.
    free_run_rmse : ndarray, shape (n,)
        On the validation recordings; infinite where a run diverged.
    one_step_rmse : ndarray, shape (n,)
        On the validation recordings.
    """

    lambdas: np.ndarray
    models: tuple[NARXModel, ...]
    solutions: tuple
    free_run_rmse: np.ndarray
    one_step_rmse: np.ndarray

    @property
    def best_index(self) -> int:
        """Where the free run is best.

        Raises
        ------
        InputError
            Every free run diverged.
        """
        if not np.isfinite(self.free_run_rmse).any():
            raise InputError("every free run on the validation recordings diverged; try other lags or larger λ")
        return int(np.argmin(self.free_run_rmse))

    @property
    def best(self) -> NARXModel:
        """The model with the smallest free-run error on the validation recordings."""
        return self.models[self.best_index]


@dataclass(frozen=True, eq=False)
class NARXProblem:
    """The convex problem of each output, and what turns its solution into a model.

    Attributes
    ----------
    problems : tuple of HingeProblem
        One an output, with unknowns [ŷ, w]: vertex values and the linear part along W.
    mesh : SimplexMesh
    lags : Lags
    select, complement : ndarray
        C, shape (d, size of φ), and W, shape (size of φ, n_w).
    limit : float
        Divergence limit of the models.
    n_dropped : int
        Samples outside the mesh, left out.
    """

    problems: tuple[HingeProblem, ...]
    mesh: SimplexMesh
    lags: Lags
    select: np.ndarray
    complement: np.ndarray
    limit: float
    n_dropped: int

    def model(self, unknowns: np.ndarray) -> NARXModel:
        """The model of unknowns [ŷ, w], shape (n_points + n_w, n_outputs)."""
        n = self.mesh.n_points
        theta = (self.complement @ unknowns[n:]).T
        return NARXModel(self.lags, self.mesh, unknowns[:n], self.select, theta, self.limit)

    def linear(self) -> NARXModel:
        """The affine model (ARX with offset), which every λ ≥ λmax gives."""
        return self.model(np.column_stack([p.affine_values for p in self.problems]))

    def lambda_max(self) -> float:
        """The smallest λ at which every output's model is affine."""
        return max(float(lambda_max(p)) for p in self.problems)

    def solve(self, lam: float, *, tol: float = 1e-4, warm_start: Sequence | None = None) -> tuple:
        """The solution of each output at λ; `warm_start` takes the solutions of a neighbouring λ."""
        states = [None] * len(self.problems) if warm_start is None else [s.state for s in warm_start]
        return tuple(
            solve(p, lam, tol=tol, warm_start=state) for p, state in zip(self.problems, states, strict=True)
        )

    def path(
        self, lambdas: Any, validation: Recording | Sequence[Recording], *, tol: float = 1e-4, outside: str = "affine"
    ) -> NARXPath:
        """Models over decreasing λ with warm starts, judged by free run on validation recordings."""
        lambdas = np.sort(np.atleast_1d(np.asarray(lambdas, float)))[::-1]
        check_finite(lambdas, "lambdas")
        if lambdas.size == 0 or lambdas[-1] <= 0:
            raise InputError(f"lambdas are {lambdas.tolist()}; expected positive numbers")
        validation = as_recordings(validation)
        models, solutions, free, ahead, last = [], [], [], [], None
        for lam in lambdas:
            last = self.solve(float(lam), tol=tol, warm_start=last)
            model = self.model(np.column_stack([s.values for s in last]))
            models.append(model)
            solutions.append(last)
            free.append(model.free_run_rmse(validation, outside=outside))
            errors = [model.predict(r, outside="affine")[model.first :] - r.outputs[model.first :] for r in validation]
            ahead.append(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
        return NARXPath(lambdas, tuple(models), tuple(solutions), np.array(free), np.array(ahead))


@dataclass(frozen=True)
class NARX:
    """Structure of a NARX model.

    Parameters
    ----------
    output_lags : int
        n_a: past outputs y(k−1) … y(k−n_a).
    input_lags : int
        n_b: past inputs u(k−1) … u(k−n_b), of every input.
    direct : bool
        Whether u(k) is a regressor too. 2014 Example 2 is ``NARX(output_lags=2, input_lags=0, direct=True)``.
    nonlinear : sequence of str, or array_like of shape (d, size of φ), optional
        Names of the regressors along which the map bends, e.g. ``("y(k-1)", "u(k)")``, or the matrix C of
        combinations. All of them by default.

    Notes
    -----
    Several outputs are supported: each has its own map, on one common mesh.
    """

    output_lags: int = 2
    input_lags: int = 1
    direct: bool = True
    nonlinear: Any = None

    def __post_init__(self) -> None:
        Lags(self.output_lags, self.input_lags, self.direct)

    @property
    def lags(self) -> Lags:
        """The orders."""
        return Lags(self.output_lags, self.input_lags, self.direct)

    def names(self, recording: Recording) -> tuple[str, ...]:
        """Names of all regressors φ for a recording's channels."""
        return self.lags.names(recording.output_names, recording.input_names)

    def select(self, recording: Recording) -> np.ndarray:
        """C, shape (d, size of φ)."""
        names = self.names(recording)
        if self.nonlinear is None:
            return np.eye(len(names))
        if all(isinstance(n, str) for n in self.nonlinear):
            unknown = [n for n in self.nonlinear if n not in names]
            if unknown or len(self.nonlinear) == 0 or len(set(self.nonlinear)) < len(self.nonlinear):
                raise InputError(f"nonlinear is {tuple(self.nonlinear)}; expected different names out of {names}")
            return np.eye(len(names))[[names.index(n) for n in self.nonlinear]]
        C = np.atleast_2d(np.asarray(self.nonlinear, dtype=float))
        if C.ndim != 2 or C.shape[1] != len(names) or np.linalg.matrix_rank(C) < len(C):
            raise InputError(
                f"nonlinear has shape {C.shape}; expected independent rows, one coefficient for each of {names}"
            )
        return C

    def regressors(self, recordings: Recording | Sequence[Recording]) -> tuple[np.ndarray, np.ndarray]:
        """X = C φ, shape (N, d), and the outputs they predict, shape (N, n_outputs); for any map fitter."""
        recordings = as_recordings(recordings)
        phi, y = self.lags.build(recordings)
        return phi @ self.select(recordings[0]).T, y

    def mesh(self, recordings: Recording | Sequence[Recording], n_points: int = 1000, rng: Any = None) -> SimplexMesh:
        """A mesh that follows the density of the data and covers them all, normalised by Σ^(−1/2)."""
        X, _ = self.regressors(recordings)
        return SimplexMesh.from_data(X, n_points, rng, scaling=Scaling.covariance(X))

    def problem(
        self,
        recordings: Recording | Sequence[Recording],
        mesh: SimplexMesh | None = None,
        *,
        n_points: int = 1000,
        weighting: str = "htv",
        rng: Any = None,
    ) -> NARXProblem:
        """The convex problem of one-step prediction on recordings.

        Parameters
        ----------
        recordings : Recording or sequence of Recording
            Regressors never straddle two of them.
        mesh : SimplexMesh, optional
            Over C φ in physical units; by default `mesh` with `n_points` and `rng`.
        weighting : {"pairs", "hinge", "htv"}
        """
        recordings = as_recordings(recordings)
        if mesh is None:
            mesh = self.mesh(recordings, n_points, rng)
        C = self.select(recordings[0])
        if mesh.dimension != len(C):
            raise InputError(f"the mesh has {mesh.dimension} dimensions, the map bends along {len(C)} regressors")
        phi, Y = self.lags.build(recordings)
        X = phi @ C.T
        simplex, weights = mesh.locate(X)
        inside = simplex >= 0
        if inside.sum() < phi.shape[1] + 2:
            raise InputError(
                f"{int(inside.sum())} of {len(X)} samples lie inside the mesh; expected at least {phi.shape[1] + 2}: "
                "are mesh and recordings in the same units?"
            )
        W = _complement(C, phi[inside])
        A = barycentric_rows(mesh, simplex[inside], weights[inside])
        F = hinge_matrix(mesh, weighting)
        points = mesh.normalised
        if W.shape[1]:
            A = sparse.hstack([A, sparse.csr_matrix(phi[inside] @ W)], format="csr")
            F = sparse.hstack([F, sparse.csr_matrix((F.shape[0], W.shape[1]))], format="csr")
            points = np.block(
                [[points, np.zeros((len(points), W.shape[1]))], [np.zeros((W.shape[1], len(C))), np.eye(W.shape[1])]]
            )
        problems = tuple(HingeProblem(A, F, y, points=points) for y in Y[inside].T)
        limit = DIVERGED * max(float(np.abs(Y).max()), np.finfo(float).tiny)
        return NARXProblem(problems, mesh, self.lags, C, W, limit, int((~inside).sum()))

    def fit(
        self,
        recordings: Recording | Sequence[Recording],
        lam: float,
        mesh: SimplexMesh | None = None,
        *,
        n_points: int = 1000,
        weighting: str = "htv",
        tol: float = 1e-4,
        rng: Any = None,
    ) -> NARXModel:
        """The model at one λ; `math.inf` gives the affine one. For a choice of λ see `NARXProblem.path`."""
        problem = self.problem(recordings, mesh, n_points=n_points, weighting=weighting, rng=rng)
        if lam == np.inf:
            return problem.linear()
        return problem.model(np.column_stack([s.values for s in problem.solve(lam, tol=tol)]))

    def wrap(self, maps: PWAMap | Sequence[PWAMap], *, theta: Any = None, limit: float = np.inf) -> NARXModel:
        """A model from maps that were fitted elsewhere, one an output, all on the same mesh.

        Parameters
        ----------
        maps : PWAMap or sequence of PWAMap
            Over the regressors in the order of `names`; `nonlinear` must be None or a matrix.
        theta : array_like, shape (n_outputs, size of φ), optional
            The linear part.
        limit : float
            Divergence limit; by default only what floating point cannot hold counts.
        """
        maps = (maps,) if isinstance(maps, PWAMap) else tuple(maps)
        if not maps or any(m.mesh is not maps[0].mesh for m in maps):
            raise InputError("expected one map or several on the same mesh object")
        d = maps[0].mesh.dimension
        if self.nonlinear is not None and any(isinstance(n, str) for n in self.nonlinear):
            raise InputError("a map can be wrapped when nonlinear is None or a matrix, not names")
        C = np.eye(d) if self.nonlinear is None else np.atleast_2d(np.asarray(self.nonlinear, float))
        theta = np.zeros((len(maps), C.shape[1])) if theta is None else np.atleast_2d(np.asarray(theta, float))
        limit = min(limit, np.sqrt(np.finfo(float).max))
        return NARXModel(self.lags, maps[0].mesh, np.column_stack([m.values for m in maps]), C, theta, limit)


def _complement(C: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """W: a basis of the directions that C does not see, scaled so that each Wᵀφ has unit variance."""
    W = null_space(C)
    if W.shape[1] == 0:
        return W
    deviation = (phi @ W).std(axis=0)
    if np.any(deviation == 0):
        raise InputError("a regressor that enters linearly is constant in the recordings; leave it out")
    return W / deviation
