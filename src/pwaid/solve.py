"""One entry to every solver of the hinge problem."""

from __future__ import annotations

from typing import Any

import numpy as np

from pwaid.admm import ADMMState, solve_admm
from pwaid.engine import solve_engine
from pwaid.errors import InputError
from pwaid.problem import HingeProblem
from pwaid.solution import Solution, affine_solution

__all__ = ["METHODS", "SOLVERS", "check_lambda", "solve"]

SOLVERS = ("clarabel", "osqp")
METHODS = ("auto", "engine", "admm", *SOLVERS)


def check_lambda(lam: Any) -> float:
    """λ as a positive float, or an `InputError`."""
    try:
        lam = float(lam)
    except (TypeError, ValueError) as error:
        raise InputError(f"lam is {lam!r}; expected a positive number") from error
    if lam == 0.0:
        raise InputError(
            "lam is 0: plain least squares, which is not unique where simplices hold no data; "
            "use a small positive λ such as 1e-6 * lambda_max(problem)"
        )
    if not (np.isfinite(lam) and lam > 0):
        raise InputError(f"lam is {lam}; expected a positive finite number")
    return lam


def solve(
    problem: HingeProblem,
    lam: float,
    *,
    method: str = "auto",
    tol: float = 1e-4,
    warm_start: Any = None,
    max_iterations: int | None = None,
) -> Solution:
    """Solve ½‖y − Aŷ‖² + λ‖Fŷ‖₁ for one λ (2014 eq. 12).

    Parameters
    ----------
    problem : HingeProblem
    lam : float
        λ > 0.
    method : {"auto", "engine", "admm", "clarabel", "osqp"}
        ``"auto"`` is our interior point engine, and ADMM (2014 Algorithm 1) where rounding stops it before the
        tolerance; ``"clarabel"`` and ``"osqp"`` go through cvxpy and serve as judges.
    tol : float
        Largest certified relative gap (P − D)/P.
    warm_start : object, optional
        `Solution.state` of a neighbouring λ, same problem and method; the judges ignore it.
    max_iterations : int, optional
        For the iterative methods.

    Returns
    -------
    Solution
        Its `status` says whether the tolerance was met; nothing is raised when it was not.

    Raises
    ------
    InputError
        λ ≤ 0, unknown method, or a warm start of another problem.
    """
    lam = check_lambda(lam)
    if method not in METHODS:
        raise InputError(f"method is {method!r}; expected one of {', '.join(map(repr, METHODS))}")
    if not 0.0 < tol < 1.0:
        raise InputError(f"tol is {tol}; expected a relative gap between 0 and 1, e.g. 1e-4")
    if problem.is_affine:
        return affine_solution(problem, lam)
    if method in SOLVERS:
        from pwaid.reference import solve_reference  # cvxpy takes a second to load

        return solve_reference(problem, lam, solver=method, tol=tol)
    limit = {} if max_iterations is None else {"max_iterations": int(max_iterations)}
    if method == "admm":
        return solve_admm(problem, lam, tol=tol, warm_start=warm_start, **limit)
    start = None if method == "auto" and isinstance(warm_start, ADMMState) else warm_start
    solution = solve_engine(problem, lam, tol=tol, warm_start=start, **limit)
    if method == "auto" and not solution.status.ok:
        other = solve_admm(problem, lam, tol=tol, **limit)
        return other if other.gap < solution.gap else solution
    return solution
