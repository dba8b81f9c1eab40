"""Alternating direction method of multipliers for the hinge problem (2014 Algorithm 1).

    minimise ½ ‖y − A v‖² + Σ w_i |z_i|   subject to G v = z

with G = D⁻¹F, D the square roots of F's row norms (slivers give rows that differ by factors of hundreds) and
w = λ D. With the scaled multiplier u,

    v ← (AᵀA + ρGᵀG)⁻¹ (Aᵀy + ρGᵀ(z − u))
    z ← S_{w/ρ}(Gv + u)                     (the paper's line 5 has a ρ too many)
    u ← u + Gv − z

over-relaxed by α = 1.7. One sparse factorisation serves until ρ changes; ρ follows λ along a path and is balanced
between primal and dual residual at a few iterations that double in distance. The iterate returned is v: the
multiplier ν = D⁻¹ρ(Gv − z + u) of the update just solved fulfils Aᵀ(y − Av) = Fᵀν, which certifies it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

from pwaid.errors import InputError
from pwaid.problem import HingeProblem
from pwaid.solution import Solution, Status

__all__ = ["ADMMState", "factorise", "solve_admm"]

RELAXATION = 1.7
CHECK_EVERY = 10
FIRST_BALANCE = 20
# ρ is left alone while the residuals differ by less than this factor: each change costs a factorisation.
BALANCED = 1.5


@dataclass(frozen=True, eq=False)
class ADMMState:
    """Where an ADMM run stands; hand it on as `warm_start`.

    `z` and `u` are the split variable and the scaled multiplier, `rho` the penalty, `lam` the λ they belong to.
    """

    z: np.ndarray
    u: np.ndarray
    rho: float
    lam: float


def factorise(K: sparse.spmatrix) -> Any:
    """Sparse factorisation of a symmetric positive definite matrix (SuperLU in symmetric mode)."""
    return sparse_linalg.splu(
        sparse.csc_matrix(K),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


@dataclass
class _Operators:
    """The row-scaled hinge matrix and the factorised update."""

    problem: HingeProblem
    scale: np.ndarray
    G: sparse.csr_matrix
    GT: sparse.csr_matrix
    GtG: sparse.csc_matrix
    factor: Any = None

    @classmethod
    def of(cls, problem: HingeProblem) -> _Operators:
        scale = np.sqrt(problem.row_norms)
        G = (sparse.diags_array(1.0 / scale) @ problem.F).tocsr()
        return cls(problem, scale, G, G.T.tocsr(), (G.T @ G).tocsc())

    def set_rho(self, rho: float) -> None:
        self.factor = factorise(self.problem.H + rho * self.GtG)


def _init(ops: _Operators, lam: float, warm_start: ADMMState | None) -> ADMMState:
    n_hinges = ops.G.shape[0]
    if warm_start is not None:
        if not isinstance(warm_start, ADMMState) or warm_start.z.size != n_hinges:
            raise InputError(
                "warm_start does not belong to this problem; pass Solution.state of the same mesh and method"
            )
        # w/ρ, the threshold, keeps its size: ρ follows λ, and the multiplier ρu follows the box.
        return replace(warm_start, rho=warm_start.rho * lam / warm_start.lam, lam=lam)
    size = ops.problem.H.diagonal().sum() / ops.GtG.diagonal().sum()
    return ADMMState(np.zeros(n_hinges), np.zeros(n_hinges), 100.0 * size, lam)


def _step(ops: _Operators, state: ADMMState, w: np.ndarray):
    """One iteration; returns the new state, v (relative to the affine fit), ν and the two residual ratios."""
    rho = state.rho
    v = ops.factor.solve(ops.problem.c + rho * (ops.GT @ (state.z - state.u)))
    Gv = ops.G @ v
    nu = rho * (Gv - state.z + state.u) / ops.scale
    relaxed = RELAXATION * Gv + (1.0 - RELAXATION) * state.z + state.u
    z = np.sign(relaxed) * np.maximum(np.abs(relaxed) - w / rho, 0.0)
    u = relaxed - z
    tiny = np.finfo(float).tiny
    primal = np.linalg.norm(Gv - z) / max(np.linalg.norm(Gv), np.linalg.norm(z), tiny)
    dual = np.linalg.norm(z - state.z) / max(np.linalg.norm(u), tiny)
    return replace(state, z=z, u=u), v, nu, primal, dual


def _balance(state: ADMMState, primal: float, dual: float) -> ADMMState:
    """ρ moved towards equal residuals, u with it so that the multiplier ρu stays."""
    factor = np.sqrt(max(primal, 1e-12) / max(dual, 1e-12))
    if 1.0 / BALANCED < factor < BALANCED:
        return state
    factor = float(np.clip(factor, 0.1, 10.0))
    return replace(state, rho=state.rho * factor, u=state.u / factor)


def solve_admm(
    problem: HingeProblem,
    lam: float,
    *,
    tol: float = 1e-4,
    warm_start: ADMMState | None = None,
    max_iterations: int = 5000,
) -> Solution:
    """Solve the hinge problem by ADMM to a certified relative gap.

    Parameters
    ----------
    problem : HingeProblem
    lam : float
        λ > 0.
    tol : float
        Largest certified relative gap.
    warm_start : ADMMState, optional
        `Solution.state` of a neighbouring λ.
    max_iterations : int
        When to give up; the status then says so.
    """
    began = time.perf_counter()
    ops = _Operators.of(problem)
    state = _init(ops, lam, warm_start)
    ops.set_rho(state.rho)
    w = lam * ops.scale
    balance_at, best, iteration = FIRST_BALANCE, None, 0
    while iteration < max_iterations:
        iteration += 1
        state, v, nu, primal, dual = _step(ops, state, w)
        if iteration % CHECK_EVERY == 0 or iteration == max_iterations:
            values = v + problem.affine_values
            certificate = problem.certificate(values, values, nu, lam)
            if best is None or certificate.gap < best[0].gap:
                best = (certificate, values, nu)
            if certificate.gap <= tol:
                break
        if iteration == balance_at:
            balance_at *= 2
            moved = _balance(state, primal, dual)
            if moved is not state:
                state = moved
                ops.set_rho(state.rho)
    certificate, values, nu = best
    return Solution(
        values=values,
        lam=lam,
        objective=certificate.primal,
        gap=certificate.gap,
        status=Status.SOLVED if certificate.gap <= tol else Status.MAX_ITERATIONS,
        iterations=iteration,
        seconds=time.perf_counter() - began,
        method="admm",
        nu=nu,
        n_broken=problem.n_broken(values),
        state=state,
    )
