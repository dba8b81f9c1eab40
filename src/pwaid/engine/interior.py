"""A primal–dual interior point method for the hinge problem.

    minimise ½ vᵀHv − cᵀv + λ Σ (p + q)   subject to F v = p − q,  p, q ≥ 0

with v relative to the affine fit. The multiplier ν of the equation has a = λ − ν ≥ 0 and b = λ + ν ≥ 0 as the
multipliers of p and q. Newton's equations reduce to

    (H + FᵀDF) Δv = r_d + FᵀD (r_p + r_a/a − r_b/b),     D = 1/(p/a + q/b),

one N̂ × N̂ system with a fixed pattern, factorised once an iteration (`pwaid.cholesky`). A solve costs a tenth of
the factorisation or less, so each factorisation serves Mehrotra's predictor and corrector and then several of
Gondzio's centrality correctors, which lengthen the step.

The dual point of an iterate is made exact by one more solve: with δ = K⁻¹(c − Hv − Fᵀν), the pair (v + δ, ν + DFδ)
fulfils the equation of the certificate; D is small where ν is near its bound, so ν hardly leaves the box.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from pwaid.cholesky import NormalMatrix
from pwaid.engine import kernels
from pwaid.problem import HingeProblem

__all__ = ["InteriorState", "Operators", "Progress", "advance", "cold_start", "dual_point", "shifted"]

# Gondzio's correctors: how many at most, how much longer a step each tries, which products it leaves alone.
CORRECTORS = 4
STRETCH = 0.3
LOW, HIGH = 0.1, 10.0
LEAST_GAIN = 0.01
TO_BOUNDARY = 0.99
GOOD_STEP = 0.95
# λ − |ν| stays above this fraction of λ, so that rounding never makes it 0.
CLEARANCE = 1e-15
# Diagonal shifts tried, as fractions of the diagonal, when rounding makes a factorisation break down.
SHIFTS = (0.0, 1e-14, 1e-12, 1e-10, 1e-8)


@dataclass(frozen=True, eq=False)
class InteriorState:
    """An interior iterate at one λ; hand it on as `warm_start`."""

    v: np.ndarray
    p: np.ndarray
    q: np.ndarray
    nu: np.ndarray
    lam: float

    @property
    def mu(self) -> float:
        """The mean complementarity product."""
        return float(kernels.complementarity(self.p, self.q, self.nu, self.lam))


@dataclass(frozen=True, eq=False)
class Operators:
    """What every λ of a problem shares."""

    F: sparse.csr_matrix
    FT: sparse.csr_matrix
    H: sparse.csr_matrix
    c: np.ndarray
    K: NormalMatrix

    @classmethod
    def of(cls, problem: HingeProblem) -> Operators:
        """Analyse the pattern once."""
        F, H = problem.F, problem.H.tocsr()
        return cls(F, F.T.tocsr(), H, problem.c, NormalMatrix(H, F, problem._points))


@dataclass(frozen=True)
class Progress:
    """What one step did: the iterate, the weights it was found with, and the length of the step."""

    state: InteriorState
    weights: np.ndarray
    step: float


def cold_start(problem: HingeProblem, lam: float) -> InteriorState:
    """The affine fit, ν = 0, and all products equal to the affine fit's loss over the number of products."""
    m = problem.n_hinges
    slack = np.full(m, problem.affine_loss / (2 * m) / lam)
    return InteriorState(np.zeros(problem.n_points), slack, slack.copy(), np.zeros(m), lam)


def shifted(state: InteriorState, lam: float) -> InteriorState:
    """An iterate of one λ moved to another: ν follows the box; p and q rise together until no product is small."""
    nu = state.nu * (lam / state.lam)
    moved = replace(state, nu=nu, lam=lam)
    mu = moved.mu
    lift = np.maximum(0.0, np.maximum(mu / (lam - nu) - state.p, mu / (lam + nu) - state.q))
    return replace(moved, p=state.p + lift, q=state.q + lift)


class _Direction:
    """Δv, Δp, Δq, Δν, built up from several right-hand sides over one factorisation."""

    def __init__(self, ops: Operators, state: InteriorState, D: np.ndarray):
        self.ops, self.state, self.D = ops, state, D
        self.dv = np.zeros_like(state.v)
        self.dp, self.dq, self.dnu = (np.zeros_like(state.nu) for _ in range(3))

    def add(self, rd, rp, ra, rb) -> None:
        ops, s = self.ops, self.state
        g = kernels.reduce(self.D, rp, ra, rb, s.nu, s.lam)
        dv = ops.K.solve(rd + ops.FT @ g)
        self.dv += dv
        kernels.expand(self.D, g, ops.F @ dv, ra, rb, s.p, s.q, s.nu, s.lam, self.dnu, self.dp, self.dq)

    def copy(self) -> _Direction:
        other = _Direction.__new__(_Direction)
        other.ops, other.state, other.D = self.ops, self.state, self.D
        other.dv, other.dp, other.dq, other.dnu = (x.copy() for x in (self.dv, self.dp, self.dq, self.dnu))
        return other

    @property
    def longest(self) -> float:
        s = self.state
        return float(kernels.longest_step(s.p, s.q, s.nu, s.lam, self.dp, self.dq, self.dnu))

    def taken(self, step: float) -> InteriorState:
        s = self.state
        inside = s.lam * (1.0 - CLEARANCE)
        nu = np.clip(s.nu + step * self.dnu, -inside, inside)
        return InteriorState(s.v + step * self.dv, s.p + step * self.dp, s.q + step * self.dq, nu, s.lam)


def advance(ops: Operators, s: InteriorState) -> Progress | None:
    """One iteration: factorise, predict, correct, centre, step. None when no factorisation succeeds."""
    D = kernels.weights(s.p, s.q, s.nu, s.lam)
    if not any(ops.K.factorise(D, shift) for shift in SHIFTS):
        return None
    rd = ops.c - ops.H @ s.v - ops.FT @ s.nu
    rp = s.p - s.q - ops.F @ s.v
    direction = _Direction(ops, s, D)
    direction.add(rd, rp, -s.p * (s.lam - s.nu), -s.q * (s.lam + s.nu))
    mu, alpha = s.mu, min(1.0, direction.longest)
    after = kernels.trial(s.p, s.q, s.nu, s.lam, direction.dp, direction.dq, direction.dnu, alpha)
    target = mu * min(1.0, max(1e-6, (after / mu) ** 3))
    zero_d, zero_p, ra, rb = np.zeros_like(rd), np.zeros_like(rp), np.empty_like(rp), np.empty_like(rp)
    kernels.second_order(direction.dp, direction.dq, direction.dnu, target, ra, rb)
    direction.add(zero_d, zero_p, ra, rb)
    alpha = direction.longest
    for _ in range(CORRECTORS):
        if alpha >= GOOD_STEP:
            break
        kernels.centrality_targets(
            s.p, s.q, s.nu, s.lam, direction.dp, direction.dq, direction.dnu, min(1.0, alpha + STRETCH),
            target, LOW, HIGH, ra, rb,
        )  # fmt: skip
        better = direction.copy()
        better.add(zero_d, zero_p, ra, rb)
        longer = better.longest
        gain = longer - alpha
        if gain > 0.0:
            direction, alpha = better, longer
        if gain < LEAST_GAIN:
            break
    step = min(1.0, TO_BOUNDARY * alpha)
    return Progress(direction.taken(step), D, step)


def dual_point(ops: Operators, progress: Progress) -> tuple[np.ndarray, np.ndarray]:
    """(v, ν) near the iterate with Hv + Fᵀν = c to rounding, by a solve with the last factorisation."""
    v, nu = progress.state.v, progress.state.nu
    delta = ops.K.solve(ops.c - ops.H @ v - ops.FT @ nu)
    return v + delta, nu + progress.weights * (ops.F @ delta)
