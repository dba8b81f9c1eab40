"""Newton's equations of the linear programme that `pwaid.lambda_max` solves, in which λ moves too.

With D = 1/(p/a + q/b) and e = p/a − q/b they reduce to

    FᵀDF Δv + FᵀDe Δλ = r₁,     −(FᵀDe)ᵀ Δv + s Δλ = r₂,     s = Σ (p/a + q/b − D e²).

FᵀDF is singular on the affine functions, to which r₁ is orthogonal: d + 1 vertices in general position, held by any
spring, change nothing there. It is nearly singular along the optimal v as well, where only hinges at their bound bend
and D vanishes; what lies along v is Δλ's to settle. So one more vertex is held, with its force t an unknown: then
eliminating Δv first loses nothing, and a 2 × 2 system gives Δλ and t.

Where rounding makes the factorisation break down, the stiffest hinges are softened: D becomes D/(1 + δD), which is a
proximal term δ Δν² in the multiplier. The equation Fᵀν = c of the step stays exact, and at the solution Δν = 0.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from pwaid.engine import kernels
from pwaid.engine.interior import Direction, InteriorState, Operators

__all__ = ["BorderedDirection", "BorderedSystem", "Held"]

# Stiffest over softest hinge, D‖Fᵢ‖², at most: the next one is taken where a factorisation breaks down.
RANGES = (1e17, 1e15, 1e13, 1e11, 1e9, 1e7)


class Held:
    """Vertices in general position, whose springs leave affine right-hand sides alone.

    Parameters
    ----------
    affine : ndarray, shape (n, d + 1)
        A basis of the affine functions' values.
    """

    def __init__(self, affine: np.ndarray):
        self.affine = affine
        self.vertices = linalg.qr(affine.T, pivoting=True, mode="r")[1][: affine.shape[1]]
        self._to_coefficients = linalg.inv(affine[self.vertices])

    def mask(self, *also: int) -> np.ndarray:
        """1 at the vertices and at others given, 0 elsewhere."""
        mask = np.zeros(len(self.affine))
        mask[self.vertices] = 1.0
        mask[list(also)] = 1.0
        return mask

    def relative(self, v: np.ndarray) -> np.ndarray:
        """v without the affine function that it follows at the vertices."""
        return v - self.affine @ (self._to_coefficients @ v[self.vertices])


class BorderedSystem:
    """Both equations at an iterate, factorised.

    `works` tells whether it succeeded; `weights` is D, `slope` is e.
    """

    def __init__(self, ops: Operators, s: InteriorState, held: Held, squares: np.ndarray, ranges: tuple[float, ...]):
        self.ops = ops
        stretch = held.relative(s.v)
        self.vertex = int(np.argmax(np.abs(stretch if stretch.any() else held.relative(ops.c))))
        pa, qb = s.p / (s.lam - s.nu), s.q / (s.lam + s.nu)
        self.slope = pa - qb
        self.works = False
        mask, exact = held.mask(self.vertex), kernels.weights(s.p, s.q, s.nu, s.lam)
        softest = float((exact * squares).min())
        for i, most in enumerate(ranges):
            self.ranges = ranges[i:]
            delta = squares / (most * softest)
            self.weights = exact / (1.0 + delta * exact)
            spring = float(self.weights @ squares) / mask.sum()
            if ops.factorise(self.weights, spring * mask, shifts=(0.0,)):
                break
        else:
            return
        self.moving = self.weights * self.slope
        self.border = ops.FT @ self.moving
        self._of_lam = ops.K.solve(self.border)
        self._of_force = ops.K.solve(np.eye(1, s.v.size, self.vertex)[0])
        own = (pa + qb) * delta + 4.0 * pa * qb  # s, without the difference of large numbers
        stiffness = float((own / (pa + qb + delta)).sum() + self.border @ self._of_lam)
        give = self._of_lam[self.vertex]
        self._corner = np.array([[give, 1.0 / spring - self._of_force[self.vertex]], [stiffness, -give]])
        self.works = bool(np.all(np.isfinite(self._corner))) and give * give > 0.0

    def solve(self, r1: np.ndarray, r2: float) -> tuple[np.ndarray, float]:
        """Δv and Δλ for both right-hand sides."""
        v = self.ops.K.solve(r1)
        dlam, force = np.linalg.solve(self._corner, [v[self.vertex], r2 + float(self.border @ v)])
        return v - dlam * self._of_lam + force * self._of_force, float(dlam)

    def multipliers(self, r1: np.ndarray) -> np.ndarray:
        """Δν with FᵀΔν = r₁, moved least where ν is near its bound."""
        dv, dlam = self.solve(r1, 0.0)
        return self.weights * (self.ops.F @ dv + dlam * self.slope)


class BorderedDirection(Direction):
    """A direction in which λ moves too: Σ(p + q) = 1 closes the system. Without a loss both steps go their own way."""

    apart = True

    def __init__(self, system: BorderedSystem, s: InteriorState):
        super().__init__(system.ops, s, system.weights)
        self.system = system

    def plus(self, side: np.ndarray, rd: np.ndarray | None = None) -> Direction:
        s, system = self.state, self.system
        missing = 0.0 if rd is None else 1.0 - float(s.p.sum() + s.q.sum())
        gained = float((side[0] / (s.lam - s.nu) + side[1] / (s.lam + s.nu)).sum())
        right = self.ops.FT @ side[2]
        dv, dlam = system.solve(right if rd is None else rd + right, gained - float(system.slope @ side[2]) - missing)
        side[2] -= dlam * system.moving
        return self._moved(dv, dlam, side)
