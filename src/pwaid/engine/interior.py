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

import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from pwaid.cholesky import NormalMatrix
from pwaid.engine import kernels
from pwaid.problem import HingeProblem

__all__ = [
    "Direction",
    "InteriorState",
    "Operators",
    "Progress",
    "advance",
    "begin_direction",
    "cold_start",
    "dual_point",
    "shifted",
]

# Gondzio's correctors: how many at most, how much longer a step each tries, which products it leaves alone.
CORRECTORS = 4
STRETCH = 0.2
LOW, HIGH = 0.5, 10.0
LEAST_GAIN = 0.01
TO_BOUNDARY = 0.99
GOOD_STEP = 0.95
LEAST_TARGET = 1e-6
# Solves that make a dual point fulfil its equation: at most this many.
REFINEMENTS = 3
# λ − |ν| stays above this fraction of λ, so that rounding never makes it 0.
CLEARANCE = 1e-15
# From this many operations a factorisation on, single precision is faster: below, calls and copies take the time.
SINGLE_PAYS = 2e8
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


@dataclass(eq=False)
class Operators:
    """What every λ of a problem shares, and the precision in which this solve factorises."""

    F: sparse.csr_matrix
    FT: sparse.csr_matrix
    H: sparse.csr_matrix
    c: np.ndarray
    K: NormalMatrix
    single: bool

    @classmethod
    def of(cls, problem: HingeProblem) -> Operators:
        """The problem's own matrices, in the forms that multiply fast."""
        K = problem.normal_matrix
        return cls(problem.F, problem.F.T.tocsr(), problem.H.tocsr(), problem.c, K, K.tree.flops > SINGLE_PAYS)

    def factorise(self, D: np.ndarray, diagonal: np.ndarray | None = None) -> bool:
        """Factorise in single precision for as long as that is good enough, then in double; whether it worked."""
        if self.single:
            if self.K.factorise(D, diagonal=diagonal, single=True):
                return True
            self.single = False
        return any(self.K.factorise(D, shift=shift, diagonal=diagonal) for shift in SHIFTS)


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


class Direction:
    """Δv, Δp, Δq, Δν (and Δλ = 0), built up from several right-hand sides over one factorisation."""

    def __init__(self, ops: Operators, state: InteriorState, D: np.ndarray):
        self.ops, self.state, self.D = ops, state, D
        self.dv = np.zeros_like(state.v)
        self.dp, self.dq, self.dnu = (np.zeros_like(state.nu) for _ in range(3))
        self.dlam = 0.0

    def residuals(self) -> tuple[np.ndarray, np.ndarray]:
        """What the iterate lacks in c = Hv + Fᵀν and in Fv = p − q."""
        ops, s = self.ops, self.state
        return ops.c - ops.H @ s.v - ops.FT @ s.nu, s.p - s.q - ops.F @ s.v

    def add(self, ra: np.ndarray, rb: np.ndarray, rd: np.ndarray | None = None, rp: np.ndarray | None = None) -> None:
        """Add the direction of a right-hand side; no rd, rp: zero."""
        ops, s = self.ops, self.state
        g = kernels.reduce(self.D, np.zeros_like(ra) if rp is None else rp, ra, rb, s.nu, s.lam)
        right = ops.FT @ g
        dv = ops.K.solve(right if rd is None else rd + right)
        self.dv += dv
        kernels.expand(
            self.D * (ops.F @ dv) - g, 0.0, ra, rb, s.p, s.q, s.nu, s.lam, self.dnu, self.dp, self.dq
        )

    def copy(self) -> Direction:
        """A copy that can grow on its own."""
        other = copy.copy(self)
        other.dv, other.dp, other.dq, other.dnu = (x.copy() for x in (self.dv, self.dp, self.dq, self.dnu))
        return other

    @property
    def parts(self) -> tuple:
        """What the kernels take of iterate and direction."""
        s = self.state
        return s.p, s.q, s.nu, s.lam, self.dp, self.dq, self.dnu, self.dlam

    @property
    def longest(self) -> float:
        """The longest step that stays inside."""
        return float(kernels.longest_step(*self.parts))

    def taken(self, step: float) -> InteriorState:
        """The iterate after the step."""
        s = self.state
        lam = s.lam + step * self.dlam
        inside = lam * (1.0 - CLEARANCE)
        nu = np.clip(s.nu + step * self.dnu, -inside, inside)
        return InteriorState(s.v + step * self.dv, s.p + step * self.dp, s.q + step * self.dq, nu, lam)


def advance(direction: Direction) -> Progress:
    """One iteration over a fresh factorisation: predict, correct, centre, step."""
    s = direction.state
    direction.add(-s.p * (s.lam - s.nu), -s.q * (s.lam + s.nu), *direction.residuals())
    mu, alpha = s.mu, min(1.0, direction.longest)
    after = kernels.trial(*direction.parts, alpha)
    target = mu * min(1.0, max(LEAST_TARGET, (after / mu) ** 3))
    ra, rb = np.empty_like(s.nu), np.empty_like(s.nu)
    kernels.second_order(direction.dp, direction.dq, direction.dnu, direction.dlam, target, ra, rb)
    direction.add(ra, rb)
    alpha = direction.longest
    for _ in range(CORRECTORS):
        if alpha >= GOOD_STEP:
            break
        kernels.centrality_targets(*direction.parts, min(1.0, alpha + STRETCH), target, LOW, HIGH, ra, rb)
        better = direction.copy()
        better.add(ra, rb)
        longer = better.longest
        gain = longer - alpha
        if gain > 0.0:
            direction, alpha = better, longer
        if gain < LEAST_GAIN:
            break
    step = min(1.0, TO_BOUNDARY * alpha)
    return Progress(direction.taken(step), direction.D, step)


def begin_direction(ops: Operators, s: InteriorState) -> Direction | None:
    """Factorise for an iterate; None when rounding makes every try break down."""
    D = kernels.weights(s.p, s.q, s.nu, s.lam)
    return Direction(ops, s, D) if ops.factorise(D) else None


def dual_point(ops: Operators, progress: Progress, negligible: float) -> tuple[np.ndarray, np.ndarray]:
    """(v, ν) near the iterate with ‖c − Hv − Fᵀν‖₁ ≤ negligible if rounding allows, by the last factorisation."""
    v, nu = progress.state.v, progress.state.nu
    left = np.inf
    for _ in range(REFINEMENTS):
        residual = ops.c - ops.H @ v - ops.FT @ nu
        size = float(np.abs(residual).sum())
        if size > 0.5 * left or size <= negligible:
            break
        left = size
        delta = ops.K.solve(residual)
        v, nu = v + delta, nu + progress.weights * (ops.F @ delta)
    return v, nu
