"""Coriolis and centrifugal torque: forces that a varying inertia makes of products of speeds."""

from __future__ import annotations

from math import cos, sin

import numpy as np

from pwaid.mismatch.effects.base import Effect, Quantity, push

__all__ = ["EFFECTS"]


def of_shown_inertia(phase, t, h, x, xs, u, p, dx, ii, q):
    """Accelerations -coefficient * M^-1 (dM/dt v - grad(v' M v) / 2), M(s) from a table; ii[5] is s.

    q: coefficient, number n of coordinates, the coordinate that moves s, turn, ds/dt per its speed, number of
    parameters that shape M, the n states that are speeds, five weights for every entry of M; then for each such
    parameter its position in p, its nominal value, and the weights' derivative by its relative change. ii[10]: 0
    weights of 1, cos, sin, cos 2, sin 2 of turn * s, 1 of its powers.
    """
    if phase == 2:
        n, moving, turn, ratio, shaping = int(q[1]), int(q[2]), q[3], q[4], int(q[5])
        z = turn * x[ii[5]]
        b1, b2, b3, b4 = cos(z), sin(z), cos(2.0 * z), sin(2.0 * z)
        g1, g2, g3, g4 = -b2, b1, -2.0 * b4, 2.0 * b3
        if ii[10] == 1:
            b1, b2, b3, b4 = z, z * z, z * z * z, z * z * z * z
            g1, g2, g3, g4 = 1.0, 2.0 * z, 3.0 * z * z, 4.0 * z * z * z
        slope, size, start = turn * ratio, 5 * n * n, 6 + n
        rate, energy = x[int(q[6 + moving])], 0.0
        A, w = np.empty((n, n + 1)), np.empty(5)
        for i in range(n):
            momentum = 0.0
            for j in range(n):
                k = start + 5 * (i * n + j)
                for m in range(5):
                    w[m] = q[k + m]
                for c in range(shaping):
                    o = start + size + c * (size + 2)
                    change = p[int(q[o])] / q[o + 1] - 1.0
                    for m in range(5):
                        w[m] += change * q[o + 2 + 5 * (i * n + j) + m]
                A[i, j] = w[0] + w[1] * b1 + w[2] * b2 + w[3] * b3 + w[4] * b4
                momentum += slope * (w[1] * g1 + w[2] * g2 + w[3] * g3 + w[4] * g4) * x[int(q[6 + j])]
            A[i, n] = momentum * rate
            energy += 0.5 * momentum * x[int(q[6 + i])]
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
            dx[int(q[6 + i])] -= q[0] * A[i, n]


def product_of_speeds(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = coefficient * v_a * v_b * (1, sin or cos of a position); q[1] turns the position into radians."""
    f = q[0] * x[ii[4]] * x[ii[6]]
    if ii[10] == 1:
        f *= sin(q[1] * x[ii[9]])
    elif ii[10] == 2:
        f *= cos(q[1] * x[ii[9]])
    push(phase, -f, ii, u, p, dx)


EFFECTS = (
    Effect("coriolis_torque", "inertial", "torque = coefficient * C(q, dq) dq of the simulator's own inertia M(q)",
           (Quantity("coefficient", "1", -5.0, 5.0, (0.3, 1.0), log=False),), of_shown_inertia,
           lambda s: s.varying_inertias(), ("quadratic_drag",), "sweep the same path slowly and fast"),
    Effect("coriolis_torque", "inertial", "F = coefficient * v_a * v_b * trig(position)",
           (Quantity("coefficient", "force/speed^2", -20.0, 20.0, (0.1, 0.5), log=False),), product_of_speeds,
           lambda s: s.velocity_products(), ("quadratic_drag",), "move one axis at a time, then both"),
)
