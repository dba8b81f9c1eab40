"""The square-root loss of 2011: minimise ‖y − Aŷ‖₂ + w‖Fŷ‖₁ (2011 eq. 11, 12).

Its solutions are those of the squared loss at w = λ/‖y − Aŷ(λ)‖: the same path with other labels. The label w does
not depend on the size of the noise, so one w suits data of any noise level. `solve_sqrt` finds the λ of a w by the
fixed point λ = w‖y − Aŷ(λ)‖ with secant steps inside a bracket (λ/‖y − Aŷ(λ)‖ never decreases with λ).
"""

from __future__ import annotations

import numpy as np

from pwaid.errors import SolverError
from pwaid.problem import HingeProblem
from pwaid.solution import Solution
from pwaid.solve import check_lambda, solve

__all__ = ["solve_sqrt", "sqrt_gap", "sqrt_weight"]


def sqrt_weight(problem: HingeProblem, solution: Solution) -> float:
    """The w of 2011 at which a solution of the squared loss is optimal; ∞ when it interpolates the data."""
    residual = np.sqrt(2.0 * problem.loss(solution.values))
    return float(solution.lam / residual) if residual > 0 else np.inf


def sqrt_gap(problem: HingeProblem, solution: Solution, w: float) -> float:
    """Certified relative gap of a solution's values in ‖y − Aŷ‖₂ + w‖Fŷ‖₁.

    Any q, μ with Aᵀq = Fᵀμ, ‖q‖₂ ≤ 1 and ‖μ‖_∞ ≤ w give the lower bound yᵀq; here they are the solution's r and ν,
    scaled.
    """
    residual = np.sqrt(2.0 * problem.loss(solution.values))
    primal = residual + w * problem.penalty(solution.values)
    if primal == 0.0 or residual == 0.0:
        return 0.0 if primal == 0.0 else 1.0
    # yᵀr = ‖r‖² + νᵀFŷ, with Aᵀr = Fᵀν (shift of y by an affine function changes neither side)
    yr = residual**2 + float(solution.nu @ (problem.F @ solution.values))
    scale = min(1.0 / residual, w / max(np.abs(solution.nu).max(initial=0.0), np.finfo(float).tiny))
    return float((primal - scale * yr) / primal)


def solve_sqrt(
    problem: HingeProblem, w: float, *, tol: float = 1e-4, method: str = "auto", max_solves: int = 60
) -> Solution:
    """Minimise ‖y − Aŷ‖₂ + w‖Fŷ‖₁.

    Returns
    -------
    Solution
        Of the squared loss at the λ that belongs to w; `sqrt_gap` certifies it for the square-root loss. For small
        w the map interpolates the samples to the tolerance.

    Raises
    ------
    InputError
        w ≤ 0.
    SolverError
        The λ of this w was not found to the tolerance.
    """
    w = check_lambda(w)
    lam = w * np.sqrt(2.0 * problem.affine_loss)
    if lam == 0.0:
        return solve(problem, w, tol=tol, method=method)
    low, high, state, best = 0.0, np.inf, None, None
    trace: list[tuple[float, float]] = []
    for _ in range(max_solves):
        solution = solve(problem, lam, tol=0.1 * tol, method=method, warm_start=state)
        state = solution.state
        gap = sqrt_gap(problem, solution, w)
        if best is None or gap < best[0]:
            best = (gap, solution)
        if gap <= tol:
            return solution
        proposal = w * np.sqrt(2.0 * problem.loss(solution.values))
        if proposal < lam:
            high = min(high, lam)
        else:
            low = max(low, lam)
        trace.append((np.log(lam), np.log(max(proposal, np.finfo(float).tiny) / lam)))
        lam = _next(trace, proposal, low, high)
    raise SolverError(f"the λ of w = {w:.3g} was not found in {max_solves} solves (gap {best[0]:.1e}); relax tol")


def _next(trace: list[tuple[float, float]], proposal: float, low: float, high: float) -> float:
    """A secant step in log λ where it stays in the bracket, else the fixed-point step, else the middle."""
    if len(trace) > 1:
        (x0, g0), (x1, g1) = trace[-2:]
        step = x1 - g1 * (x1 - x0) / (g1 - g0) if abs(g1 - g0) > 1e-9 * abs(g1) else -np.inf
        if (np.log(low) if low > 0 else -700.0) < step < np.log(high):
            return float(np.exp(step))
    return proposal if low < proposal < high else float(np.sqrt(low * high))
