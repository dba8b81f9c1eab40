"""`solve_engine`: the interior point method run to a certified gap."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from pwaid.engine.interior import (
    CENTRAL,
    QUICK,
    DualPoint,
    InteriorState,
    Operators,
    Point,
    advance,
    begin_direction,
    cold_start,
    dual_point,
    shifted,
)
from pwaid.errors import InputError
from pwaid.problem import Certificate, HingeProblem
from pwaid.solution import Solution, Status, affine_solution

__all__ = ["solve_engine"]

# The iterate kept for the next λ is the first one whose gap is this fraction of what the affine fit leaves: later
# ones lie too near the boundary of the box, earlier ones too far from the solution.
KEEP_AT = 0.3
STEPS_WITHOUT_GAIN = 12
# A state is of use for λ within this factor of its own; farther off a cold start is quicker.
NEAR = 2.0


def solve_engine(
    problem: HingeProblem,
    lam: float,
    *,
    tol: float = 1e-4,
    warm_start: InteriorState | None = None,
    max_iterations: int = 100,
) -> Solution:
    """Solve the hinge problem by an interior point method to a certified relative gap.

    The first call for a problem also orders its unknowns; later calls, for any λ, reuse that. Not for use from
    several threads on one problem at once.

    Parameters
    ----------
    problem : HingeProblem
    lam : float
        λ > 0.
    tol : float
        Largest certified relative gap (P − D)/P of the point returned.
    warm_start : InteriorState, optional
        `Solution.state` of a λ within a factor of 2; of one farther off it is not used.
    max_iterations : int
        Factorisations at most.

    Returns
    -------
    Solution
        `gap` is computed at `values` by `problem.certificate`, whatever the status.

    Raises
    ------
    InputError
        λ or tol are not positive, or warm_start belongs to another problem.
    """
    lam, tol = _positive(lam, "lam"), _positive(tol, "tol")
    began = time.perf_counter()
    if problem.is_affine:
        return affine_solution(problem, lam, time.perf_counter() - began)
    state = _begin(problem, lam, warm_start)
    ops = Operators.of(problem)
    best = _Best(problem, lam)
    kept, status, iteration, message = None, Status.MAX_ITERATIONS, 0, ""
    while iteration < max_iterations:
        iteration += 1
        direction = begin_direction(ops, state)
        if direction is None:
            status, message = Status.STALLED, "the reduced system is singular to rounding"
            break
        progress = advance(direction, CENTRAL if kept is None else QUICK)
        state = progress.state
        best.see(state.v, ops.at(state), dual_point(ops, progress, best.negligible(tol)))
        if kept is None and best.remaining <= KEEP_AT:
            kept = state
        if best.gap <= tol and best.certificate.gap <= tol:
            status = Status.SOLVED
            break
        if best.steps_without_gain >= STEPS_WITHOUT_GAIN:
            status = Status.STALLED
            break
    return best.solution(iteration, began, status, kept, message)


def _positive(value: float, name: str) -> float:
    try:
        value = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}; expected a number > 0") from None
    if value == 0.0 and name == "lam":
        raise InputError(
            "lam is 0; expected λ > 0: where the data leave vertices undetermined least squares has no unique "
            "solution; a small λ such as 1e-8·lambda_max(problem) picks the one with the smallest hinges"
        )
    if not 0.0 < value < math.inf:
        raise InputError(f"{name} is {value!r}; expected a finite number > 0")
    return value


def _begin(problem: HingeProblem, lam: float, warm_start: Any) -> InteriorState:
    if warm_start is None:
        return cold_start(problem, lam)
    if not isinstance(warm_start, InteriorState) or warm_start.nu.size != problem.n_hinges:
        raise InputError("warm_start is not a state of this problem and method; pass Solution.state of the same mesh")
    if not 1.0 / NEAR <= lam / warm_start.lam <= NEAR:
        return cold_start(problem, lam)
    return shifted(warm_start, lam)


class _Best:
    """The best primal point and the best dual point so far; together they give the gap."""

    def __init__(self, problem: HingeProblem, lam: float):
        self.problem, self.lam = problem, lam
        self.affine = problem.affine_values
        self.values, self.nu = self.affine, np.zeros(problem.n_hinges)
        self.dual_values = self.affine
        self.primal, self.dual = problem.objective(self.affine, lam), 0.0
        self.first, self.steps_without_gain = self.primal, 0

    @property
    def gap(self) -> float:
        return (self.primal - self.dual) / self.primal

    @property
    def remaining(self) -> float:
        """The gap over that between the affine fit and the same bound."""
        return (self.primal - self.dual) / max(self.first - self.dual, np.finfo(float).tiny)

    def negligible(self, tol: float) -> float:
        """A residual of the dual equation, in the 1-norm, that costs a hundredth of the tolerance at most."""
        reach = max(np.sqrt(2.0 * self.problem.affine_loss), float(np.abs(self.values - self.affine).max()))
        return 0.01 * tol * self.primal / reach

    def see(self, v: np.ndarray, at: Point, dual: DualPoint) -> None:
        before, problem = self.gap, self.problem
        loss = problem.affine_loss - float(problem.c @ v) + 0.5 * float(v @ at.image)
        primal = loss + self.lam * float(np.abs(at.hinges).sum())
        if primal < self.primal:
            self.primal, self.values = primal, self.affine + v
        reach = float(np.abs(self.values - self.affine).max())
        bound = problem.dual_bound(dual.v, dual.image, dual.left_over, dual.nu, reach, self.lam)
        if bound > self.dual:
            self.dual, self.dual_values, self.nu = bound, self.affine + dual.v, dual.nu
        self.steps_without_gain = 0 if self.gap < 0.99 * before else self.steps_without_gain + 1

    @property
    def certificate(self) -> Certificate:
        return self.problem.certificate(self.values, self.dual_values, self.nu, self.lam)

    def solution(self, iterations: int, began: float, status: Status, state: Any, message: str) -> Solution:
        certificate = self.certificate
        return Solution(
            values=self.values.copy(), lam=self.lam, objective=certificate.primal, gap=certificate.gap, status=status,
            iterations=iterations, seconds=time.perf_counter() - began, method="engine", nu=self.nu.copy(),
            n_broken=self.problem.n_broken(self.values), state=state, message=message,
        )  # fmt: skip
