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
    "CENTRAL",
    "QUICK",
    "Centring",
    "Direction",
    "DualPoint",
    "InteriorState",
    "Operators",
    "Point",
    "Progress",
    "advance",
    "begin_direction",
    "cold_start",
    "dual_point",
    "shifted",
]

CORRECTORS = 8
LEAST_GAIN = 0.01
TO_BOUNDARY = 0.99
LEAST_TARGET = 1e-6
# Solves that make a dual point fulfil its equation: at most this many.
REFINEMENTS = 3
# λ − |ν| stays above this fraction of λ, so that rounding never makes it 0.
CLEARANCE = 1e-15
# From this many operations a factorisation on, single precision is faster: below, calls and copies take the time.
SINGLE_PAYS = 2e8
# Diagonal shifts tried, as fractions of the diagonal, when rounding makes a factorisation break down.
SHIFTS = (0.0, 1e-14, 1e-12, 1e-10, 1e-8)


@dataclass(frozen=True)
class Centring:
    """How an iteration trades progress for centrality.

    Attributes
    ----------
    ambition : float
        The target μ, as a fraction of Mehrotra's: the correctors make up for it.
    low, high : float
        Gondzio's correctors leave products between these multiples of the target alone.
    stretch : float
        How much longer a step each corrector tries.
    enough : float
        A step this long needs no further corrector.
    """

    ambition: float
    low: float
    high: float
    stretch: float
    enough: float


# While the iterate may serve as a warm start it stays central; after that each factorisation goes as far as it can.
CENTRAL = Centring(ambition=0.5, low=0.2, high=10.0, stretch=0.2, enough=0.95)
QUICK = Centring(ambition=0.1, low=0.5, high=3.0, stretch=0.4, enough=0.9)


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
class Point:
    """At an iterate: Hv, c − Hv − Fᵀν, and Fv."""

    image: np.ndarray
    left_over: np.ndarray
    hinges: np.ndarray


@dataclass(eq=False)
class Operators:
    """What every λ of a problem shares, and the precision in which this solve factorises."""

    F: sparse.csr_matrix
    FT: sparse.csr_matrix
    H: sparse.csr_matrix
    c: np.ndarray
    K: NormalMatrix
    single: bool
    _seen: tuple | None = None

    @classmethod
    def of(cls, problem: HingeProblem) -> Operators:
        """The problem's own matrices, in the forms that multiply fast."""
        K = problem.normal_matrix
        return cls(problem.F, problem.F.T.tocsr(), problem.H.tocsr(), problem.c, K, K.tree.flops > SINGLE_PAYS)

    def at(self, state: InteriorState) -> Point:
        """The products at an iterate, computed once."""
        if self._seen is None or self._seen[0] is not state:
            image = self.H @ state.v
            point = Point(image, self.c - image - self.FT @ state.nu, self.F @ state.v)
            self._seen = (state, point)
        return self._seen[1]

    def factorise(self, D: np.ndarray, diagonal: np.ndarray | None = None, shifts: tuple[float, ...] = SHIFTS) -> bool:
        """Factorise in single precision for as long as that is good enough, then in double; whether it worked."""
        if self.single:
            if self.K.factorise(D, diagonal=diagonal, single=True):
                return True
            self.single = False
        return any(self.K.factorise(D, shift=shift, diagonal=diagonal) for shift in shifts)


@dataclass(frozen=True)
class Progress:
    """What one step did: the iterate, and the weights it was found with."""

    state: InteriorState
    weights: np.ndarray


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
    """Δv, Δp, Δq, Δν (and Δλ = 0), built up from several right-hand sides over one factorisation.

    `longest` holds the longest steps of v, p, q and of ν, λ. The loss couples them, so both are the shorter one.
    """

    apart = False

    def __init__(self, ops: Operators, state: InteriorState, D: np.ndarray):
        self.ops, self.state, self.D = ops, state, D
        self.dv = np.zeros_like(state.v)
        self.rows = np.zeros((3, state.nu.size))
        self.dlam, self.longest = 0.0, np.full(2, np.inf)

    def plus(self, side: np.ndarray, rd: np.ndarray | None = None) -> Direction:
        """This direction and that of a right-hand side (`kernels`); no rd: zero."""
        right = self.ops.FT @ side[2]
        return self._moved(self.ops.K.solve(right if rd is None else rd + right), 0.0, side)

    def _moved(self, dv: np.ndarray, dlam: float, side: np.ndarray) -> Direction:
        s, out = self.state, copy.copy(self)
        out.dv, out.dlam = self.dv + dv, self.dlam + dlam
        out.rows, *longest = kernels.expand(
            self.ops.F @ dv, self.D, side, dlam, s.p, s.q, s.nu, s.lam, self.rows, self.dlam
        )
        out.longest = np.array(longest) if self.apart else np.full(2, min(longest))
        return out

    def taken(self, primal: float, dual: float) -> InteriorState:
        """The iterate after both steps."""
        s = self.state
        lam = s.lam + dual * self.dlam
        p, q, nu = kernels.taken(s.p, s.q, s.nu, self.rows, primal, dual, lam * (1.0 - CLEARANCE))
        return InteriorState(s.v + primal * self.dv, p, q, nu, lam)


def advance(direction: Direction, centring: Centring) -> Progress:
    """One iteration over a fresh factorisation: predict, correct, centre, step."""
    s, D = direction.state, direction.D
    point, side = direction.ops.at(s), np.empty((3, D.size))
    kernels.predictor_side(s.p, s.q, s.nu, s.lam, D, point.hinges, side)
    direction = direction.plus(side, point.left_over)
    mu = s.mu
    after = kernels.trial(s.p, s.q, s.nu, s.lam, direction.rows, direction.dlam, *np.minimum(1.0, direction.longest))
    target = mu * min(1.0, max(LEAST_TARGET, centring.ambition * (after / mu) ** 3))
    kernels.corrector_side(s.nu, s.lam, direction.rows, direction.dlam, D, target, side)
    direction = direction.plus(side)
    for _ in range(CORRECTORS):
        alpha = np.minimum(1.0, direction.longest)
        if alpha.min() >= centring.enough:
            break
        reach = np.minimum(1.0, alpha + centring.stretch)
        kernels.centrality_side(
            s.p, s.q, s.nu, s.lam, direction.rows, direction.dlam, D, *reach,
            centring.low * target, centring.high * target, side,
        )  # fmt: skip
        better = direction.plus(side)
        gain = float((np.minimum(1.0, better.longest) - alpha).mean())
        if gain > 0.0:
            direction = better
        if gain < LEAST_GAIN:
            break
    steps = np.minimum(1.0, TO_BOUNDARY * direction.longest)
    return Progress(direction.taken(*steps), D)


def begin_direction(ops: Operators, s: InteriorState) -> Direction | None:
    """Factorise for an iterate; None when rounding makes every try break down."""
    D = kernels.weights(s.p, s.q, s.nu, s.lam)
    return Direction(ops, s, D) if ops.factorise(D) else None


@dataclass(frozen=True, eq=False)
class DualPoint:
    """A pair (v, ν), v relative to the affine fit, with Hv and what it lacks in c = Hv + Fᵀν."""

    v: np.ndarray
    nu: np.ndarray
    image: np.ndarray
    left_over: np.ndarray


def dual_point(ops: Operators, progress: Progress, negligible: float) -> DualPoint:
    """A pair near the iterate that lacks `negligible` (1-norm) at most, if rounding allows; by the last factors."""
    v, nu = progress.state.v, progress.state.nu
    point = ops.at(progress.state)
    image, residual = point.image, point.left_over
    left = np.inf
    for _ in range(REFINEMENTS):
        size = float(np.abs(residual).sum())
        if size > 0.5 * left or size <= negligible:
            break
        left = size
        delta = ops.K.solve(residual)
        v, nu = v + delta, nu + progress.weights * (ops.F @ delta)
        image = ops.H @ v
        residual = ops.c - image - ops.FT @ nu
    return DualPoint(v, nu, image, residual)
