"""The smallest λ with a flat solution, between two certified bounds.

With c = Aᵀ(y − A ŷ_aff) (2014 eq. 13–15; (15b) lost its "= 0" in print),

    λmax = min { ‖z‖_∞ : Fᵀz = c } = max { cᵀv : ‖F v‖₁ ≤ 1 }.

Any z that fulfils the equation gives an upper bound, any v a lower one. The linear programme

    minimise λ   subject to Fᵀz = c,  a = λ − z ≥ 0,  b = λ + z ≥ 0

has multipliers v of the equation and p, q ≥ 0 with Fv = p − q, Σ(p + q) = 1: the hinge problem without its loss and
with λ free. So the engine's interior point method solves it; its Newton system FᵀDF, bordered by the one column
that belongs to λ, has the same pattern and shares the elimination order. FᵀDF is singular on the affine functions
and every right-hand side is orthogonal to them, so holding d + 1 vertices in general position by any spring changes
nothing and makes it definite.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import linalg, sparse

from pwaid.engine import kernels
from pwaid.engine.interior import CENTRAL, Direction, InteriorState, Operators, Progress, advance
from pwaid.errors import InputError, SolverError
from pwaid.problem import HingeProblem

__all__ = ["LambdaMax", "lambda_max"]

# Bounds farther apart than this fraction are an error; between this and tol they are returned (see `width`).
USELESS = 1e-2
MAX_ITERATIONS = 60
STEPS_WITHOUT_GAIN = 8
# Solves that make an upper bound exact: at most this many; what is left is charged with this times ‖v‖_∞.
REFINEMENTS = 5
GENEROUS = 2.0
# The first λ, as a multiple of the bound that the least-squares z gives.
FIRST = 1.5


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
    affine = problem.affine_basis
    c = problem.c - affine @ (affine.T @ problem.c)
    size = float(np.linalg.norm(c))
    if size == 0.0:
        return LambdaMax(0.0, 0.0)
    no_loss = sparse.csr_matrix(problem.H.shape)
    lower, upper = _bounds(replace(Operators.of(problem), H=no_loss, c=c / size), affine, problem.row_norms, tol)
    if not upper - lower <= USELESS * upper:
        raise SolverError(
            f"λmax is only known to lie between {lower * size:.6g} and {upper * size:.6g}; "
            "normalise the inputs (scaling=), or use a blue-noise mesh"
        )
    return LambdaMax(min(lower, upper) * size, upper * size)


def _bounds(ops: Operators, affine: np.ndarray, norms: np.ndarray, tol: float) -> tuple[float, float]:
    """The bounds for ops.c, by interior point iterations until they are within tol."""
    held = np.zeros(ops.c.size)
    held[linalg.qr(affine.T, pivoting=True, mode="r")[1][: affine.shape[1]]] = 1.0
    state, upper = _start(ops, held, 1.0 / norms)
    lower, idle = 0.0, 0
    for _ in range(MAX_ITERATIONS):
        direction = _begin(ops, state, held)
        if direction is None or not direction.stiffness > 0.0:
            break
        progress = advance(direction, CENTRAL)
        state, before = progress.state, upper - lower
        v = state.v - affine @ (affine.T @ state.v)
        spent = float(np.abs(ops.F @ v).sum())
        if np.isfinite(spent) and spent > 0.0:
            lower = max(lower, float(ops.c @ v) / spent)
            upper = min(upper, _upper(ops, progress, GENEROUS * float(np.abs(v).max()) / spent, tol))
        idle = 0 if upper - lower < 0.99 * before else idle + 1
        if upper - lower <= tol * upper or idle >= STEPS_WITHOUT_GAIN:
            break
    return lower, upper


def _factorise(ops: Operators, D: np.ndarray, held: np.ndarray) -> float | None:
    """Factorise FᵀDF with springs as stiff as its rows at the held vertices; the stiffness, None on breakdown."""
    spring = float(D @ np.asarray(ops.F.multiply(ops.F).sum(axis=1)).ravel()) / held.size
    return spring if ops.factorise(D, spring * held) else None


def _start(ops: Operators, held: np.ndarray, weights: np.ndarray) -> tuple[InteriorState, float]:
    """v = 0, p = q, and the z of least weighted norm, with λ well above it."""
    _factorise(ops, weights, held)
    z = np.zeros_like(weights)
    for _ in range(2):
        z += weights * (ops.F @ ops.K.solve(ops.c - ops.FT @ z))
    upper = float(np.abs(z).max())
    share = np.full(z.size, 0.5 / z.size)
    return InteriorState(np.zeros_like(ops.c), share, share.copy(), z, FIRST * upper), upper


def _begin(ops: Operators, s: InteriorState, held: np.ndarray) -> _BorderedDirection | None:
    D = kernels.weights(s.p, s.q, s.nu, s.lam)
    spring = _factorise(ops, D, held)
    return None if spring is None else _BorderedDirection(ops, s, D, spring)


def _upper(ops: Operators, progress: Progress, reach: float, tol: float) -> float:
    """A bound from a z with Fᵀz = c, found by refining the iterate's with the last factorisation.

    What z still lacks, r = c − Fᵀz, is charged with ‖r‖₁ times `reach`, a generous bound of ‖v‖_∞ where ‖F v‖₁ = 1.
    """
    z, bound = progress.state.nu, np.inf
    left = ops.c - ops.FT @ z
    for _ in range(REFINEMENTS):
        z = z + progress.weights * (ops.F @ ops.K.solve(left))
        left = ops.c - ops.FT @ z
        before, bound = bound, min(bound, float(np.abs(z).max() + reach * np.abs(left).sum()))
        if bound > (1.0 - 0.01 * tol) * before:
            break
    return bound


class _BorderedDirection(Direction):
    """A direction in which λ moves too: Σ(p + q) = 1 closes the system."""

    def __init__(self, ops: Operators, s: InteriorState, D: np.ndarray, spring: float):
        super().__init__(ops, s, D)
        self.spring = spring
        pa, qb = s.p / (s.lam - s.nu), s.q / (s.lam + s.nu)
        self.e = pa - qb
        self.moving = D * self.e
        self.border = ops.FT @ self.moving
        self.v_lam = ops.K.solve(self.border)
        self.stiffness = float((pa + qb).sum() - self.e @ (self.moving - D * (ops.F @ self.v_lam)))

    def plus(self, side: np.ndarray, rd: np.ndarray | None = None) -> Direction:
        s = self.state
        missing = 0.0 if rd is None else 1.0 - float(s.p.sum() + s.q.sum())
        v = self._solved(side, rd)
        gained = side[0] / (s.lam - s.nu) + side[1] / (s.lam + s.nu)
        drive = float(gained.sum() + self.border @ v - self.e @ side[2]) - missing
        dlam = drive / self.stiffness
        side[2] -= dlam * self.moving
        return self._moved(v - dlam * self.v_lam, dlam, side)
