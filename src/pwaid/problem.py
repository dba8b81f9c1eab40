"""The convex problem and its certificate.

    minimise over ŷ   P(ŷ) = ½ ‖y − A ŷ‖² + λ ‖F ŷ‖₁                                   (2014 eq. 12)

Only H = AᵀA, c = Aᵀy and yᵀy enter, so N may be far larger than memory (`HingeProblem.from_statistics`).

Certificate. For any r, ν with Aᵀr = Fᵀν and ‖ν‖_∞ ≤ λ, weak duality gives P ≥ D = yᵀr − ½ ‖r‖². A pair (v, ν) with
H v + Fᵀν = c gives r = y − A v; scaling r and ν by t = min(1, λ/‖ν‖_∞) makes it feasible. What is left of the
equation, q = c − H v − Fᵀν, is charged to the bound with ‖q‖₁ times a generous bound of the optimum's distance from
the affine fit, the larger of those of ŷ and v and of ‖ỹ‖₂, √N times its RMS (q is rounding for a pair that fulfils
the equation; a pair that does not gets no useful bound). The gap of the point returned is
(P(ŷ) − D) / P(ŷ): every tolerance in pwaid means this number.

Affine functions cost nothing (F annihilates them), so c and yᵀy are taken relative to the best affine fit ŷ_aff:
this changes neither problem nor gap (‖Fŷ_aff‖₁, zero but for rounding, is charged too) and keeps digits when y has
a large mean or trend.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

from pwaid.assembly import SampleSums
from pwaid.cholesky import NormalMatrix
from pwaid.delaunay import SimplexMesh
from pwaid.errors import InputError
from pwaid.lerp import barycentric_rows, hinge_matrix
from pwaid.recording import check_finite, check_samples

__all__ = ["Certificate", "HingeProblem"]

# A hinge counts as broken when its extrapolation error exceeds this fraction of the RMS of y about its affine fit.
BROKEN = 1e-4
# A residual of this fraction of y is rounding.
EXACT = 1e-11
# So is a gradient of this fraction of what the largest column of A and y could give.
ROUNDED = 1e-14


@dataclass(frozen=True)
class Certificate:
    """Primal value, dual bound and relative gap of a point."""

    primal: float
    dual: float

    @property
    def gap(self) -> float:
        """(P − D)/P, the certified relative distance to the optimum; 0 when P is 0."""
        if self.primal <= 0.0:
            return 0.0
        return (self.primal - self.dual) / self.primal


class HingeProblem:
    """½ ‖y − A ŷ‖² + λ ‖F ŷ‖₁ for every λ.

    Parameters
    ----------
    A : sparse matrix, shape (N, n_points)
        Interpolation matrix.
    F : sparse matrix, shape (n_hinges, n_points)
        Hinge matrix.
    y : array_like, shape (N,)
        Measured outputs.
    points : ndarray, shape (n_points, d), optional
        Mesh vertices. They give the null space of F (affine functions) at once; without them it is computed.
    affine_basis : ndarray, shape (n_points, k), optional
        An orthonormal basis of the null space of F, where it holds more than the affine functions (extra linear
        unknowns). Instead of `points`.
    n_dropped : int
        How many samples were left out because they lie outside the mesh (for reports).

    Raises
    ------
    InputError
        Shapes that do not fit, NaN, or fewer than 3 samples (d + 2 in `from_data` and `from_chunks`).
    """

    def __init__(
        self, A: Any, F: Any, y: Any, *, points: Any = None, affine_basis: Any = None, n_dropped: int = 0
    ):
        A = sparse.csr_matrix(A)
        y = np.asarray(y, dtype=float)
        if y.ndim == 2 and y.shape[1] == 1:
            y = y[:, 0]
        if y.ndim != 1 or y.size != A.shape[0]:
            raise InputError(f"y has shape {y.shape}; expected ({A.shape[0]},), one output a row of A")
        check_finite(y, "y")
        check_finite(A.data, "A")
        self.A, self.y = A, y
        self._setup((A.T @ A).tocsc(), A.T @ y, float(y @ y), F, y.size, points)
        if affine_basis is not None:
            self.affine_basis = np.asarray(affine_basis, dtype=float)
        self.n_dropped = n_dropped

    @classmethod
    def from_statistics(cls, AtA: Any, Aty: Any, yty: float, F: Any, n: int, *, points: Any = None) -> HingeProblem:
        """From the sufficient statistics AᵀA, Aᵀy, yᵀy of `n` samples, never holding A."""
        self = cls.__new__(cls)
        self.A = self.y = None
        self.n_dropped = 0
        Aty = np.asarray(Aty, dtype=float)
        check_finite(Aty, "Aty")
        self._setup(sparse.csc_matrix(AtA), Aty, float(yty), F, int(n), points)
        return self

    @classmethod
    def from_data(
        cls, mesh: SimplexMesh, X: Any, y: Any, *, weighting: str = "pairs", outside: str = "raise"
    ) -> HingeProblem:
        """Build A and F for samples (X, y) on a mesh.

        Parameters
        ----------
        mesh : SimplexMesh
        X : array_like, shape (N, d)
        y : array_like, shape (N,)
        weighting : {"pairs", "hinge", "htv"}
        outside : {"raise", "drop"}
            Whether samples outside the mesh raise `OutsideMeshError` or are left out (counted in `n_dropped`).
        """
        X, y = check_samples(X, y, dimension=mesh.dimension)
        if outside not in ("raise", "drop"):
            raise InputError(f"outside is {outside!r}; expected 'raise' or 'drop'")
        simplex, weights = mesh.locate(X)
        if outside == "raise":
            mesh.require_inside(simplex, X)
        inside = simplex >= 0
        if inside.sum() < mesh.dimension + 2:
            raise InputError(
                f"{int(inside.sum())} of {len(X)} samples lie inside the mesh; expected at least "
                f"{mesh.dimension + 2}: are mesh and samples in the same units?"
            )
        A = barycentric_rows(mesh, simplex[inside], weights[inside])
        F = hinge_matrix(mesh, weighting)
        return cls(A, F, y[inside], points=mesh.normalised, n_dropped=int((~inside).sum()))

    @classmethod
    def from_chunks(
        cls, mesh: SimplexMesh, chunks: Any, *, weighting: str = "pairs", outside: str = "raise"
    ) -> HingeProblem:
        """From samples that come in chunks, in memory that does not grow with their number.

        Parameters
        ----------
        mesh : SimplexMesh
        chunks : iterable of (X, y)
            X of shape (n, d) and y of shape (n,) each; a generator that reads a file will do.
        weighting, outside
            As in `from_data`.
        """
        sums = SampleSums(mesh, outside=outside)
        sums.add_all(chunks)
        if sums.n < mesh.dimension + 2:
            raise InputError(
                f"{sums.n} of {sums.n + sums.n_dropped} samples lie inside the mesh; expected at least "
                f"{mesh.dimension + 2}: are mesh and samples in the same units?"
            )
        F = hinge_matrix(mesh, weighting)
        self = cls.from_statistics(sums.AtA, sums.Aty, sums.yty, F, sums.n, points=mesh.normalised)
        self.n_dropped = sums.n_dropped
        return self

    def _setup(self, H, Aty, yty, F, n_samples, points) -> None:
        F = sparse.csr_matrix(F)
        if F.shape[1] != H.shape[0] or H.shape[0] != H.shape[1] or Aty.shape != (H.shape[0],):
            raise InputError(
                f"A gives {H.shape[0]} grid points, Aᵀy has shape {Aty.shape} and F has {F.shape[1]} columns; "
                "expected all three for the same mesh"
            )
        check_finite(F.data, "F")
        if n_samples < 3:
            raise InputError(f"{n_samples} samples came; expected at least d + 2 (3 in one dimension)")
        self.H, self.F, self.n_samples = H, F, n_samples
        self.Aty, self.yty = Aty, yty
        if points is not None:
            points = np.asarray(points, dtype=float)
            if points.ndim != 2 or points.shape[0] != H.shape[0]:
                raise InputError(f"points have shape {points.shape}; expected ({H.shape[0]}, d)")
        self._points = points

    @cached_property
    def normal_matrix(self) -> NormalMatrix:
        """H + FᵀDF for any diagonal D: ordered once, factorised by every solver. Not for several threads at once."""
        return NormalMatrix(self.H, self.F, self._points)

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled: all but the factorisation, which is large and soon made again."""
        return {k: v for k, v in self.__dict__.items() if k != "normal_matrix"}

    # -- the affine part -------------------------------------------------------------------------------------

    @cached_property
    def affine_basis(self) -> np.ndarray:
        """An orthonormal basis of the null space of F, shape (n_points, d + 1)."""
        if self._points is not None:
            return np.linalg.qr(np.column_stack([np.ones(len(self._points)), self._points]))[0]
        return _null_space(self.F)

    @cached_property
    def affine_values(self) -> np.ndarray:
        """ŷ of the affine least-squares fit (2014 eq. 13), shape (n_points,): the solution for λ ≥ λmax.

        Raises
        ------
        InputError
            The samples do not determine it: collinear inputs, or fewer than d + 1 distinct samples.
        """
        V = self.affine_basis
        if not self.is_determined:
            raise InputError(
                f"the {self.n_samples} samples do not determine an affine function of the {V.shape[1] - 1} inputs: "
                "the inputs are collinear, or too few samples are distinct; leave out the redundant input"
            )
        return V @ self._affine_fit[0]

    @cached_property
    def _affine_fit(self) -> tuple[np.ndarray, int]:
        """Coefficients of the affine fit in `affine_basis`, and the rank of their equations."""
        V = self.affine_basis
        coefficients, _, rank, _ = np.linalg.lstsq(V.T @ (self.H @ V), V.T @ self.Aty, rcond=1e-13)
        return coefficients, int(rank)

    @property
    def is_determined(self) -> bool:
        """Whether the samples determine their affine fit."""
        return self._affine_fit[1] == self.affine_basis.shape[1]

    @cached_property
    def _affine_leak(self) -> float:
        """‖F ŷ_aff‖₁: zero but for rounding."""
        return self.penalty(self.affine_values)

    @cached_property
    def _centred(self) -> tuple[np.ndarray, float]:
        """Aᵀỹ and ‖ỹ‖² with ỹ = y − A ŷ_aff."""
        affine = self.affine_values
        if self.y is not None:
            residual = self.y - self.A @ affine
            return self.A.T @ residual, float(residual @ residual)
        c = self.Aty - self.H @ affine
        return c, max(0.0, float(self.yty - affine @ (self.Aty + c)))

    @property
    def c(self) -> np.ndarray:
        """Aᵀ(y − A ŷ_aff), shape (n_points,): the gradient of the loss at the affine fit, negated."""
        return self._centred[0]

    @property
    def affine_loss(self) -> float:
        """½ ‖y − A ŷ_aff‖², the value of the problem for λ ≥ λmax."""
        return 0.5 * self._centred[1]

    @cached_property
    def is_affine(self) -> bool:
        """Whether the affine fit is best at every λ, so that λmax = 0: y is affine to rounding (RMS 1e-11 of y's own),
        nothing can bend, or bending gains nothing, as where an input has two values only."""
        size = np.sqrt(self.H.diagonal().max(initial=0.0) * self.yty)
        return self.is_exact or self.n_hinges == 0 or bool(np.abs(self.c).max(initial=0.0) <= ROUNDED * size)

    @property
    def is_exact(self) -> bool:
        """Whether y is an affine function of x to rounding."""
        return self.affine_loss <= 0.5 * EXACT**2 * self.yty

    # -- judging ---------------------------------------------------------------------------------------------

    @property
    def n_points(self) -> int:
        """N̂, the number of unknowns."""
        return self.H.shape[0]

    @property
    def n_hinges(self) -> int:
        """M, the number of hinges."""
        return self.F.shape[0]

    @cached_property
    def row_norms(self) -> np.ndarray:
        """Euclidean norms of the rows of F, shape (n_hinges,)."""
        return np.sqrt(np.asarray(self.F.multiply(self.F).sum(axis=1)).ravel())

    def loss(self, values: np.ndarray) -> float:
        """½ ‖y − A ŷ‖²."""
        if self.y is not None:
            residual = self.y - self.A @ values
            return 0.5 * float(residual @ residual)
        move = values - self.affine_values
        c, centred = self._centred
        return max(0.0, 0.5 * (centred - 2.0 * float(c @ move) + float(move @ (self.H @ move))))

    def penalty(self, values: np.ndarray) -> float:
        """‖F ŷ‖₁."""
        return float(np.abs(self.F @ values).sum())

    def objective(self, values: np.ndarray, lam: float) -> float:
        """P(ŷ) at λ."""
        return self.loss(values) + lam * self.penalty(values)

    def n_broken(self, values: np.ndarray) -> int:
        """Hinges whose extrapolation error, row scaled to norm 1, exceeds 1e-4 of the RMS of y − affine fit."""
        scale = np.sqrt(2.0 * self.affine_loss / self.n_samples)
        return int(np.count_nonzero(np.abs(self.F @ values) > BROKEN * scale * self.row_norms))

    def certificate(self, values: np.ndarray, dual_values: np.ndarray, nu: np.ndarray, lam: float) -> Certificate:
        """Judge ŷ by a pair (v, ν) with H v + Fᵀν = c + H ŷ_aff.

        Parameters
        ----------
        values : ndarray, shape (n_points,)
            ŷ, the point judged.
        dual_values : ndarray, shape (n_points,)
            v; often ŷ itself.
        nu : ndarray, shape (n_hinges,)
            ν; need not be feasible.
        lam : float
            λ > 0.
        """
        move = dual_values - self.affine_values
        image = self.H @ move
        left_over = self.c - image - self.F.T @ nu
        reach = np.abs(values - self.affine_values).max(initial=0.0)
        return Certificate(self.objective(values, lam), self.dual_bound(move, image, left_over, nu, reach, lam))

    def dual_bound(
        self, move: np.ndarray, image: np.ndarray, left_over: np.ndarray, nu: np.ndarray, reach: float, lam: float
    ) -> float:
        """The certificate's D for a pair (v, ν), from products at hand.

        Parameters
        ----------
        move, image, left_over : ndarray, shape (n_points,)
            v − ŷ_aff, H (v − ŷ_aff), and c − H (v − ŷ_aff) − Fᵀν with c relative to the affine fit.
        nu : ndarray, shape (n_hinges,)
        reach : float
            ‖ŷ − ŷ_aff‖_∞ of the point judged.
        lam : float
        """
        largest = np.abs(nu).max(initial=0.0)
        t = 1.0 if largest <= lam else lam / largest
        c, centred = self._centred
        rr = max(0.0, centred - 2.0 * float(c @ move) + float(move @ image))
        yr = centred - float(c @ move)
        reach = max(np.abs(move).max(initial=0.0), reach, centred**0.5)
        charge = float(np.abs(left_over).sum() * reach) + lam * self._affine_leak
        return max(0.0, t * yr - 0.5 * t * t * rr - t * charge)

    def certify(
        self, values: np.ndarray, nu: np.ndarray, lam: float, *, weights: np.ndarray | None = None
    ) -> tuple[Certificate, np.ndarray]:
        """Judge ŷ and a multiplier from any solver: make them dual feasible by a linear solve first.

        v solves (H + FᵀWF) v = c + Fᵀ(WFŷ − ν); then (v, ν + WF(v − ŷ)) fulfils the equation of the certificate
        exactly, whatever the rank of A.

        Parameters
        ----------
        values, nu, lam
            As in `certificate`.
        weights : ndarray, shape (n_hinges,), optional
            The diagonal of W up to a factor: how much each multiplier may move; 1/row_norms² by default.

        Returns
        -------
        certificate : Certificate
        nu : ndarray, shape (n_hinges,)
            The repaired multiplier.
        """
        weights = 1.0 / self.row_norms**2 if weights is None else weights
        weights = weights * (self.H.diagonal().sum() / float(weights @ self.row_norms**2))
        if not self.normal_matrix.factorise(weights) and not self.normal_matrix.factorise(weights, shift=1e-12):
            return Certificate(self.objective(values, lam), 0.0), nu
        v = values - self.affine_values
        for _ in range(2):  # the second round removes the rounding of the first
            step = self.normal_matrix.solve(self.c - self.H @ v - self.F.T @ nu)
            v, nu = v + step, nu + weights * (self.F @ step)
        return self.certificate(values, v + self.affine_values, nu, lam), nu


def _null_space(F: sparse.csr_matrix) -> np.ndarray:
    """An orthonormal basis of the null space of F by block inverse iteration on FᵀF with rows of norm 1."""
    norms = np.sqrt(np.asarray(F.multiply(F).sum(axis=1)).ravel())
    if np.any(norms == 0):
        raise InputError(f"{int((norms == 0).sum())} rows of F are zero; expected one extrapolation error a row")
    G = sparse.diags_array(1.0 / norms) @ F
    K = (G.T @ G).tocsc()
    size = float(K.diagonal().max())
    factor = sparse_linalg.splu((K + 1e-13 * size * sparse.eye_array(K.shape[0])).tocsc())
    width = int(np.diff(F.indptr).max()) + 4
    V = np.random.default_rng(0).standard_normal((K.shape[0], min(width, K.shape[0])))
    for _ in range(6):
        V = np.linalg.qr(factor.solve(V))[0]
    _, coordinates = np.linalg.eigh(V.T @ (K @ V))
    V = V @ coordinates
    null = np.linalg.norm(G @ V, axis=0) <= 1e-7 * np.sqrt(size)
    if not null.any():
        raise InputError("F has no null space; expected a hinge matrix, which annihilates affine functions")
    return np.ascontiguousarray(V[:, null])
