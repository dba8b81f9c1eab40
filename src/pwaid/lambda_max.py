"""The smallest λ with a flat solution, between two certified bounds.

With c = Aᵀ(y − A ŷ_aff) (2014 eq. 13–15; (15b) lost its "= 0" in print),

    λmax = min { ‖z‖_∞ : Fᵀz = c } = max { cᵀv : ‖F v‖₁ ≤ 1 }.

Any z that fulfils the equation gives an upper bound, any v a lower one. The linear programme is solved by an
interior point method; its z is then made to fulfil Fᵀz = c to rounding by a solve with FᵀF.
"""

from __future__ import annotations

import clarabel
import numpy as np
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from pwaid.errors import InputError, SolverError
from pwaid.problem import HingeProblem

__all__ = ["LambdaMax", "lambda_max"]

# Bounds farther apart than this fraction are an error; between this and tol they are returned (see `width`).
USELESS = 1e-2


class LambdaMax(float):
    """λmax as a float (its upper bound), with the certified `lower` and `upper` bounds.

    At any λ ≥ `upper` the affine fit is optimal; at any λ < `lower` it is not.
    """

    lower: float
    upper: float

    def __new__(cls, lower: float, upper: float) -> LambdaMax:
        self = super().__new__(cls, upper)
        self.lower, self.upper = float(lower), float(upper)
        return self

    def __getnewargs__(self) -> tuple[float, float]:
        return self.lower, self.upper

    @property
    def width(self) -> float:
        """(upper − lower)/upper; 0 when both are 0."""
        return (self.upper - self.lower) / self.upper if self.upper > 0.0 else 0.0

    def __repr__(self) -> str:
        return f"LambdaMax({self.upper:.9g}, lower={self.lower:.9g})"


def lambda_max(problem: HingeProblem, *, tol: float = 1e-6) -> LambdaMax:
    """The smallest λ whose solution is affine (2014 eq. 15).

    Parameters
    ----------
    problem : HingeProblem
    tol : float
        Largest relative distance between the bounds.

    Returns
    -------
    LambdaMax
        A float, the upper bound, with `.lower` and `.upper`; 0.0 when y is affine to rounding.

    Raises
    ------
    InputError
        tol is not in (0, 1).
    SolverError
        The bounds did not come within 1 % of each other; between tol and 1 % they are returned as they are.
    """
    if not 0.0 < tol < 1.0:
        raise InputError(f"tol is {tol!r}; expected a relative width between 0 and 1, such as 1e-6")
    if problem.is_affine:
        return LambdaMax(0.0, 0.0)
    F, c, affine = problem.F, problem.c, problem.affine_basis
    c = c - affine @ (affine.T @ c)
    size = float(np.linalg.norm(c))
    if size == 0.0:
        return LambdaMax(0.0, 0.0)
    lower, upper = 0.0, np.inf
    for power in (0.5, 0.0, 1.0):  # slivers: no one scaling of the rows serves every weighting
        v, z = _linear_programme(F, c / size, problem.row_norms**power, tol)
        upper = min(upper, float(np.abs(_repair(F, c / size, z, problem.row_norms, affine)).max()))
        spent = float(np.abs(F @ v).sum())
        if np.isfinite(spent) and spent > 0.0:
            lower = max(lower, abs(float(c / size @ v)) / spent)
        if upper - lower <= tol * upper:
            break
    if not upper - lower <= USELESS * upper:
        raise SolverError(
            f"λmax is only known to lie between {lower * size:.6g} and {upper * size:.6g}; "
            "normalise the inputs (scaling=), or use a blue-noise mesh"
        )
    return LambdaMax(min(lower, upper) * size, upper * size)


def _linear_programme(F, c, scale, tol):
    """v and z of min t subject to Fᵀz = c, −t ≤ z ≤ t, by Clarabel, with z and F scaled by `scale`."""
    m, n = F.shape
    G = sparse.diags_array(1.0 / scale) @ F
    eye, ones = sparse.diags_array(1.0 / scale), -np.ones((m, 1))
    A = sparse.block_array([[G.T, None], [eye, ones], [-eye, ones]]).tocsc()
    b = np.concatenate([c, np.zeros(2 * m)])
    q = np.zeros(m + 1)
    q[-1] = 1.0
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = min(1e-9, 1e-3 * tol)
    settings.max_threads = 1
    cones = [clarabel.ZeroConeT(n), clarabel.NonnegativeConeT(2 * m)]
    result = clarabel.DefaultSolver(sparse.csc_matrix((m + 1, m + 1)), q, A, b, cones, settings).solve()
    return np.asarray(result.z)[:n], np.asarray(result.x)[:m] / scale


def _repair(F, c, z, norms, affine):
    """z moved least (weighted by the norms of the rows) to fulfil Fᵀz = c to rounding.

    FᵀF is singular on the affine functions; it is definite once d + 1 vertices in general position are held.
    """
    n = F.shape[1]
    held = linalg.qr(affine.T, pivoting=True, mode="r")[1][: affine.shape[1]]
    free = np.setdiff1d(np.arange(n), held)
    weights = 1.0 / norms
    K = (F.T @ sparse.diags_array(weights) @ F).tocsc()
    factor = sparse_linalg.splu(
        K[free][:, free], permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    for _ in range(3):
        step = np.zeros(n)
        step[free] = factor.solve((c - F.T @ z)[free])
        z = z + weights * (F @ step)
    return z
