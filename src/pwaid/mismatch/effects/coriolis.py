"""Coriolis and centrifugal torque: forces that a varying inertia makes of products of speeds."""

from __future__ import annotations

from math import cos, sin

import numpy as np

from pwaid.mismatch.effects.base import Effect, Quantity, push

__all__ = ["EFFECTS"]


def of_shown_inertia(phase, t, h, x, xs, u, p, dx, ii, q):
    """Accelerations -coefficient * M^-1 (dM/dt v - grad(v' M v) / 2), M(s) from a table; ii[5] is s.

    q: coefficient, number n of coordinates, the coordinate that moves s, turn, ds/dt per its speed, nominal values of
    the up to three parameters ii[6], ii[7], ii[8] that shape M, the n states that are speeds; then five weights for
    every entry of M, and their derivatives by the relative change of each such parameter. ii[10]: 0 weights of 1,
    cos, sin, cos 2, sin 2 of turn * s, 1 of its powers.
    """
    if phase == 2:
        n, moving = int(q[1]), int(q[2])
        z = q[3] * x[ii[5]]
        b1, b2, b3, b4 = cos(z), sin(z), cos(2.0 * z), sin(2.0 * z)
        g1, g2, g3, g4 = -b2, b1, -2.0 * b4, 2.0 * b3
        if ii[10] == 1:
            b1, b2, b3, b4 = z, z * z, z * z * z, z * z * z * z
            g1, g2, g3, g4 = 1.0, 2.0 * z, 3.0 * z * z, 4.0 * z * z * z
        W = q[8 + n:8 + n + 5 * n * n].copy()
        if ii[6] >= 0:
            W += (p[ii[6]] / q[5] - 1.0) * q[8 + n + 5 * n * n:8 + n + 10 * n * n]
        if ii[7] >= 0:
            W += (p[ii[7]] / q[6] - 1.0) * q[8 + n + 10 * n * n:8 + n + 15 * n * n]
        if ii[8] >= 0:
            W += (p[ii[8]] / q[7] - 1.0) * q[8 + n + 15 * n * n:8 + n + 20 * n * n]
        rate = x[int(q[8 + moving])] * q[3] * q[4]
        energy = 0.0
        A = np.empty((n, n + 1))
        for i in range(n):
            momentum = 0.0
            for j in range(n):
                k = 5 * (i * n + j)
                A[i, j] = W[k] + W[k + 1] * b1 + W[k + 2] * b2 + W[k + 3] * b3 + W[k + 4] * b4
                momentum += (W[k + 1] * g1 + W[k + 2] * g2 + W[k + 3] * g3 + W[k + 4] * g4) * x[int(q[8 + j])]
            A[i, n] = momentum * rate
            energy += 0.5 * q[3] * q[4] * momentum * x[int(q[8 + i])]
        A[moving, n] -= energy
        for i in range(n):  # elimination: M is positive definite
            for r in range(i + 1, n):
                f = A[r, i] / A[i, i]
                for j in range(i, n + 1):
                    A[r, j] -= f * A[i, j]
        for i in range(n - 1, -1, -1):
            for j in range(i + 1, n):
                A[i, n] -= A[i, j] * A[j, n]
            A[i, n] /= A[i, i]
            dx[int(q[8 + i])] -= q[0] * A[i, n]


def product_of_speeds(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = coefficient * v_a * v_b * (1, sin or cos of a position, or the position, as ii[10] says); q[1] turns an angle
    into radians."""
    f = q[0] * x[ii[4]] * x[ii[6]]
    if ii[10] == 1:
        f *= sin(q[1] * x[ii[9]])
    elif ii[10] == 2:
        f *= cos(q[1] * x[ii[9]])
    elif ii[10] == 3:
        f *= x[ii[9]]
    push(phase, -f, ii, u, p, dx)


EFFECTS = (
    Effect("coriolis_torque", "inertial", "torque = coefficient * C(q, dq) dq of the simulator's own inertia M(q)",
           (Quantity("coefficient", "1", -5.0, 5.0, (0.3, 1.0), log=False),), of_shown_inertia,
           lambda s: s.varying_inertias(), ("quadratic_drag",), "sweep the same path slowly and fast"),
    Effect("coriolis_torque", "inertial", "F = coefficient * v_a * v_b * trig(position)",
           (Quantity("coefficient", "force/speeds", -20.0, 20.0, (0.1, 0.5), log=False),), product_of_speeds,
           lambda s: s.velocity_products(), ("quadratic_drag",), "move one axis at a time, then both"),
    Effect("coriolis_torque", "inertial", "F = coefficient * v_a * v_b * position",
           (Quantity("coefficient", "force/speeds*position", -20.0, 20.0, (0.1, 0.5), log=False),), product_of_speeds,
           lambda s: s.velocity_products(stretching=True), ("quadratic_drag",), "move one axis at a time, then both"),
)
