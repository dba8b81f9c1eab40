"""The same problems in cvxpy: the judge of our own solvers, and the solver of the rarely needed ones.

Every function scales the outputs to RMS 1 about their affine fit before it hands the problem over, and judges the
answer with the certificate of `pwaid.problem`, not with the solver's own words.
"""

from __future__ import annotations

import time
import warnings
from typing import Any

import cvxpy as cp
import numpy as np

from pwaid.errors import InputError, SolverError
from pwaid.problem import HingeProblem
from pwaid.solution import Solution, Status

__all__ = ["SOLVERS", "minimise_penalty", "solve_reference", "solve_sqrt_reference"]

SOLVERS = ("clarabel", "osqp")


def _options(solver: str, tol: float) -> dict[str, Any]:
    """Solver settings for a relative accuracy of `tol`."""
    if solver == "clarabel":
        tight = min(1e-8, tol * 1e-2)
        return {"solver": cp.CLARABEL, "tol_gap_rel": tight, "tol_gap_abs": tight, "tol_feas": tight}
    tight = max(1e-9, min(1e-5, tol * 1e-2))
    return {"solver": cp.OSQP, "eps_abs": tight, "eps_rel": tight, "max_iter": 200_000, "polishing": True}


def _run(program: cp.Problem, solver: str, tol: float) -> str:
    """Solve; returns the solver's own status, raises `SolverError` when there is no point at all."""
    if solver not in SOLVERS:
        raise InputError(f"solver is {solver!r}; expected one of {', '.join(map(repr, SOLVERS))}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # cvxpy warns of inaccurate answers; the certificate judges them
            program.solve(**_options(solver, tol))
    except cp.SolverError as error:
        raise SolverError(f"{solver} broke down ({error}); try another method") from error
    return str(program.status)


def _scale(problem: HingeProblem) -> float:
    return float(np.sqrt(2.0 * problem.affine_loss / problem.n_samples)) or 1.0


def _loss(problem: HingeProblem, v: cp.Variable, size: float) -> cp.Expression:
    """½‖y − Aŷ‖² about the affine fit, in units of size²; a constant is left out without A."""
    if problem.A is not None:
        residual = (problem.y - problem.A @ problem.affine_values) / size
        return 0.5 * cp.sum_squares(problem.A @ v - residual)
    return 0.5 * cp.quad_form(v, cp.psd_wrap(problem.H)) - (problem.c / size) @ v


def solve_reference(problem: HingeProblem, lam: float, *, solver: str = "clarabel", tol: float = 1e-4) -> Solution:
    """Solve the hinge problem (2014 eq. 12) with Clarabel (interior point) or OSQP (ADMM) through cvxpy.

    Raises
    ------
    SolverError
        The solver returned no point.
    """
    began = time.perf_counter()
    size = _scale(problem)
    v, z = cp.Variable(problem.n_points), cp.Variable(problem.n_hinges)
    hinges = z == problem.F @ v
    program = cp.Problem(cp.Minimize(_loss(problem, v, size) + lam / size * cp.norm1(z)), [hinges])
    own_status = _run(program, solver, tol)
    if v.value is None or hinges.dual_value is None:
        raise SolverError(f"{solver} returned no point (its status: {own_status}); try another method")
    values = size * np.asarray(v.value) + problem.affine_values
    nu = size * np.asarray(hinges.dual_value)
    candidates = [problem.certify(values, sign * nu, lam) for sign in (1.0, -1.0)]  # cvxpy's sign is its own
    certificate, nu = min(candidates, key=lambda pair: pair[0].gap)
    return Solution(
        values=values,
        lam=lam,
        objective=certificate.primal,
        gap=certificate.gap,
        status=Status.SOLVED if certificate.gap <= tol else Status.STALLED,
        iterations=int(program.solver_stats.num_iters or 0),
        seconds=time.perf_counter() - began,
        method=solver,
        nu=nu,
        n_broken=problem.n_broken(values),
        message=f"{solver}: {own_status}",
    )


def solve_sqrt_reference(problem: HingeProblem, w: float, *, tol: float = 1e-6) -> tuple[np.ndarray, float]:
    """Minimise ‖y − Aŷ‖₂ + w‖Fŷ‖₁ (2011 eq. 11) directly as a cone program.

    Returns
    -------
    values : ndarray, shape (n_points,)
    objective : float
    """
    if problem.A is None:
        raise InputError("the square-root reference needs A and y; this problem holds only their statistics")
    size = _scale(problem)
    v = cp.Variable(problem.n_points)
    residual = (problem.y - problem.A @ problem.affine_values) / size
    program = cp.Problem(cp.Minimize(cp.norm(problem.A @ v - residual, 2) + w * cp.norm1(problem.F @ v)))
    _run(program, "clarabel", tol)
    if v.value is None:
        raise SolverError(f"clarabel returned no point (its status: {program.status})")
    values = size * np.asarray(v.value) + problem.affine_values
    objective = float(np.linalg.norm(problem.y - problem.A @ values)) + w * problem.penalty(values)
    return values, objective


def minimise_penalty(problem: HingeProblem, *, tol: float = 1e-8) -> tuple[np.ndarray, np.ndarray, str]:
    """Minimise ‖Fŷ‖₁ subject to Aŷ = y (2014 eq. 19).

    Returns
    -------
    values : ndarray, shape (n_points,)
    nu : ndarray, shape (n_hinges,)
        Dual vector with Fᵀν in the range of Aᵀ and ‖ν‖_∞ ≤ 1 (to the solver's tolerance).
    status : str
        The solver's own status; ``"infeasible"`` when no map on this mesh meets the samples.
    """
    size = _scale(problem)
    v, z = cp.Variable(problem.n_points), cp.Variable(problem.n_hinges)
    residual = (problem.y - problem.A @ problem.affine_values) / size
    hinges = z == problem.F @ v
    program = cp.Problem(cp.Minimize(cp.norm1(z)), [hinges, problem.A @ v == residual])
    status = _run(program, "clarabel", tol)
    if v.value is None or hinges.dual_value is None:
        return problem.affine_values, np.zeros(problem.n_hinges), status
    values = size * np.asarray(v.value) + problem.affine_values
    nu = np.asarray(hinges.dual_value)
    sign = np.sign(nu @ (problem.F @ values)) or 1.0
    return values, sign * nu, status
