"""The smallest λ with a flat solution, between two certified bounds.

With c = Aᵀ(y − A ŷ_aff) (2014 eq. 13–15; (15b) lost its "= 0" in print),

    λmax = min { ‖z‖_∞ : Fᵀz = c } = max { cᵀv : ‖F v‖₁ ≤ 1 }.

Any z that fulfils the equation gives an upper bound, any v a lower one. The linear programme

    minimise λ   subject to Fᵀz = c,  a = λ − z ≥ 0,  b = λ + z ≥ 0

has multipliers v of the equation and p, q ≥ 0 with Fv = p − q, Σ(p + q) = 1: the hinge problem without its loss and
with λ free. So the engine's interior point method solves it (`pwaid.engine.bordered`), over the same elimination
order.

Where F has N̂ − d − 1 rows (d = 1) only one z fulfils the equation, and λmax is its largest entry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import sparse

from pwaid.engine.bordered import RANGES, BorderedDirection, BorderedSystem, Held
from pwaid.engine.interior import QUICK, InteriorState, Operators, advance
from pwaid.errors import InputError, SolverError
from pwaid.problem import HingeProblem

__all__ = ["LambdaMax", "lambda_max"]

# Bounds farther apart than this fraction are an error; between this and tol they are returned (see `width`).
USELESS = 1e-2
MAX_ITERATIONS = 60
# Both bounds are computed once the products say that the width is below this many times tol, or nothing works any more.
NEARLY = 10.0
# Single precision may misplace λ by a percent; closer than this it would be left below its smallest value.
COARSE = 0.1
STEPS_WITHOUT_GAIN = 8
# Solves that make an upper bound exact: at most this many; what is left is charged with this times ‖v‖_∞.
REFINEMENTS = 5
GENEROUS = 2.0
# A charge above this fraction of tol is no bound: v may still be far from the one that counts.
SLIGHT = 0.1
# Both act as if no less were asked for: rounding may not allow it, and what was reached is returned then.
LEAST_TOL = 1e-6
# The first λ, as a multiple of the bound that the least-squares z gives, and how much of Σ(p + q) follows its v.
FIRST = 2.0
BENT = 0.3


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
    bounds = _Bounds(replace(Operators.of(problem), H=no_loss, c=c / size), affine, tol)
    state = bounds.start(problem.row_norms)
    if bounds.width > tol:
        bounds.tighten(state, problem.row_norms**2)
    lower, upper = bounds.lower, bounds.upper
    if not bounds.width <= USELESS:
        raise SolverError(
            f"λmax is only known to lie between {lower * size:.6g} and {upper * size:.6g}; "
            "normalise the inputs (scaling=), or use a blue-noise mesh"
        )
    return LambdaMax(min(lower, upper) * size, upper * size)


class _Bounds:
    """The bounds for ops.c and how they come together."""

    def __init__(self, ops: Operators, affine: np.ndarray, tol: float):
        self.ops, self.tol, self.held = ops, tol, Held(affine)
        self.lower, self.upper = 0.0, np.inf

    @property
    def width(self) -> float:
        return 1.0 - self.lower / self.upper

    def start(self, norms: np.ndarray) -> InteriorState:
        """The z of least weighted norm and its v, with p and q well above zero and λ well above z."""
        ops, weights, mask = self.ops, 1.0 / norms, self.held.mask()
        ops.factorise(weights, float(weights @ norms**2) / mask.sum() * mask)

        def multipliers(left: np.ndarray) -> np.ndarray:
            return weights * (ops.F @ ops.K.solve(left))

        v = ops.K.solve(ops.c)
        hinges = ops.F @ v
        z = weights * hinges
        most = float(np.abs(z).max())
        if z.size == ops.c.size - self.held.vertices.size:
            bend = np.zeros_like(z)
            bend[np.abs(z).argmax()] = np.sign(z[np.abs(z).argmax()])
            only = np.zeros_like(ops.c)
            for _ in range(REFINEMENTS):
                only += ops.K.solve(ops.FT @ (weights * (bend - ops.F @ only)))
            self.see(only, z, multipliers)
        scale, share = BENT / float(np.abs(hinges).sum()), 0.5 * (1.0 - BENT) / z.size
        p, q = (np.maximum(sign * scale * hinges, 0.0) + share for sign in (1.0, -1.0))
        return InteriorState(scale * v, p, q, z, FIRST * most)

    def tighten(self, state: InteriorState, squares: np.ndarray) -> None:
        """Interior point iterations until the bounds are within tol or come no closer."""
        ranges, idle, last = RANGES, 0, None
        for _ in range(MAX_ITERATIONS):
            system = BorderedSystem(self.ops, state, self.held, squares, ranges)
            if not system.works:
                break
            ranges, last = system.ranges, system
            state = advance(BorderedDirection(system, state), QUICK).state
            remaining = 2 * state.nu.size * state.mu / state.lam
            self.ops.single = self.ops.single and remaining > COARSE
            if not remaining <= NEARLY * max(self.tol, LEAST_TOL):
                continue
            before = self.upper - self.lower
            self.see(state.v, state.nu, system.multipliers)
            idle = 0 if self.upper - self.lower < 0.99 * before else idle + 1
            if self.width <= self.tol or idle >= STEPS_WITHOUT_GAIN:
                return
        if last is not None and not np.isfinite(self.upper):
            self.see(state.v, state.nu, last.multipliers)

    def see(self, v: np.ndarray, z: np.ndarray, multipliers: Callable[[np.ndarray], np.ndarray]) -> None:
        """The lower bound of v, and the upper bound of z once it fulfils Fᵀz = c.

        `multipliers` makes up for what z lacks. What it still lacks then, r, is charged with ‖r‖₁ times a generous
        bound of ‖v‖_∞ where ‖Fv‖₁ = 1.
        """
        ops, best = self.ops, np.inf
        v = v - self.held.affine @ (self.held.affine.T @ v)
        spent = float(np.abs(ops.F @ v).sum())
        if not (np.isfinite(spent) and spent > 0.0):
            return
        self.lower = max(self.lower, float(ops.c @ v) / spent)
        reach = GENEROUS * float(np.abs(v).max()) / spent
        left = ops.c - ops.FT @ z
        for _ in range(REFINEMENTS):
            z = z + multipliers(left)
            left = ops.c - ops.FT @ z
            charge, most = reach * float(np.abs(left).sum()), float(np.abs(z).max())
            before, best = best, min(best, charge + most)
            if charge <= SLIGHT * max(self.tol, LEAST_TOL) * most:
                self.upper = min(self.upper, charge + most)
            if charge <= 0.01 * self.tol * most or best > (1.0 - 0.01 * self.tol) * before:
                break
