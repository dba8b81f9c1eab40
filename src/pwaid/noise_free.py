"""The map with the fewest hinges through noise-free samples (2014 eq. 16, 19, Theorem 6, Corollary 7).

The restricted isometry constant of Theorem 6 cannot be computed at size, so the solution at hand is certified
instead. With J the hinges it leaves unbroken, the solution of (19) is the only one when
  1. A is injective on the null space of F_J: no change of ŷ keeps both the samples and J's hinges, and
  2. a dual vector ν, Fᵀν in the range of Aᵀ and |ν| ≤ 1, is strictly inside the box on J: |ν_J| ≤ 1 − margin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

from pwaid.errors import InputError, SolverError
from pwaid.problem import HingeProblem

__all__ = ["NoiseFreeSolution", "solve_noise_free"]

# A margin or a smallest singular value below this is not told from zero (the cone solver stops near 1e-8).
STRICT = 1e-5


@dataclass(frozen=True, eq=False)
class NoiseFreeSolution:
    """The solution of (19) and what is certified about it.

    Attributes
    ----------
    values : ndarray, shape (n_points,)
    penalty : float
        ‖Fŷ‖₁.
    gap : float
        Relative gap between ‖Fŷ‖₁ and the dual bound.
    residual : float
        Largest |Aŷ − y|, unit of y.
    n_broken : int
    smallest_singular_value : float
        Of [A; F_J], rows of F scaled to norm 1; zero when A is not injective there.
    dual_margin : float
        1 − max |ν_J|.
    """

    values: np.ndarray
    penalty: float
    gap: float
    residual: float
    n_broken: int
    smallest_singular_value: float
    dual_margin: float

    @property
    def unique(self) -> bool:
        """Whether the certificate proves that no other map is as good."""
        return self.smallest_singular_value > STRICT and self.dual_margin > STRICT


def solve_noise_free(problem: HingeProblem, *, tol: float = 1e-8) -> NoiseFreeSolution:
    """Solve (19), minimise ‖Fŷ‖₁ subject to Aŷ = y, and certify uniqueness.

    Raises
    ------
    InputError
        No map on this mesh meets all samples (they are noisy, or the mesh is too coarse), or A is not held.
    SolverError
        The cone solver broke down.
    """
    if problem.A is None:
        raise InputError("the noise-free problem needs A and y; this problem holds only their statistics")
    if problem.is_exact:
        values, every = problem.affine_values, np.ones(problem.n_hinges, dtype=bool)
        missed = float(np.abs(problem.A @ values - problem.y).max())
        return NoiseFreeSolution(values, 0.0, 0.0, missed, 0, _smallest_singular_value(problem, every), 1.0)
    from pwaid.reference import minimise_penalty  # cvxpy takes a second to load

    values, nu, status = minimise_penalty(problem, tol=tol)
    residual = float(np.abs(problem.A @ values - problem.y).max())
    size = float(np.sqrt(2.0 * problem.affine_loss / problem.n_samples))
    if "infeasible" in status or residual > 1e-4 * max(size, np.finfo(float).tiny):
        raise InputError(
            f"no map on this mesh meets the {problem.n_samples} samples exactly (largest miss {residual:.3g}): they "
            "are noisy or the mesh is too coarse; use solve with λ > 0"
        )
    if "optimal" not in status:
        raise SolverError(f"the cone solver ended with {status!r}; try a blue-noise mesh or scale the inputs")
    nu = _repair(problem, nu)
    jumps = problem.F @ values
    broken = np.abs(jumps) > 1e-6 * problem.row_norms * size
    penalty = float(np.abs(jumps).sum())
    # ν scaled into the box keeps Fᵀν in the range of Aᵀ, so νᵀFŷ is a lower bound of ‖Fŷ‖₁
    largest = max(1.0, float(np.abs(nu).max(initial=0.0)))
    bound = float(nu @ jumps) / largest
    margin = 1.0 - float(np.abs(nu[~broken]).max(initial=0.0)) / largest
    return NoiseFreeSolution(
        values=values,
        penalty=penalty,
        gap=(penalty - bound) / penalty if penalty > 0 else 0.0,
        residual=residual,
        n_broken=int(broken.sum()),
        smallest_singular_value=_smallest_singular_value(problem, ~broken),
        dual_margin=margin,
    )


def _repair(problem: HingeProblem, nu: np.ndarray) -> np.ndarray:
    """The nearest ν with Fᵀν exactly in the range of Aᵀ.

    Fᵀ(ν − δ) = Aᵀp for some p; with δ = F v this reads FᵀF v + Aᵀp = Fᵀν and A v = 0 picks the smallest δ.
    """
    n, m = problem.n_points, problem.n_samples
    F, A = problem.F, problem.A
    small = 1e-10
    FtF = (F.T @ F + small * sparse.eye_array(n)).tocsc()
    K = sparse.block_array([[FtF, A.T], [A, -small * sparse.eye_array(m)]]).tocsc()
    rhs = np.concatenate([F.T @ nu, np.zeros(m)])
    factor = sparse_linalg.splu(K)
    x = factor.solve(rhs)
    exact = sparse.block_array([[F.T @ F, A.T], [A, None]]).tocsr()
    for _ in range(3):
        x = x + factor.solve(rhs - exact @ x)
    return nu - F @ x[:n]


def _smallest_singular_value(problem: HingeProblem, unbroken: np.ndarray) -> float:
    """Of [A; F_J] with rows of F scaled to norm 1, by inverse iteration."""
    FJ = sparse.diags_array(1.0 / problem.row_norms[unbroken]) @ problem.F[unbroken]
    M = (problem.H + FJ.T @ FJ).tocsc()
    size = float(M.diagonal().max())
    factor = sparse_linalg.splu((M + 1e-15 * size * sparse.eye_array(M.shape[0])).tocsc())
    v = np.random.default_rng(0).standard_normal(M.shape[0])
    for _ in range(50):
        v = factor.solve(v / np.linalg.norm(v))
    v /= np.linalg.norm(v)
    return float(np.sqrt(max(0.0, v @ (M @ v)) / size))
