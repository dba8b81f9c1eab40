"""The vector arithmetic of the interior point method, compiled: one pass over the hinges each.

Letters as in `pwaid.engine.interior`: p, q ≥ 0 split Fv = p − q; a = λ − ν and b = λ + ν are their multipliers.
λ moves too (dlam) when `pwaid.lambda_max` looks for its smallest value.

A right-hand side has three rows: what the products p a and q b shall gain, r_a and r_b, and
g = D (r_p + r_a/a − r_b/b), which Fᵀ takes to the reduced system. Then Δν = D F Δv − g.
"""

from __future__ import annotations

import numba
import numpy as np

__all__ = [
    "centrality_side",
    "complementarity",
    "corrector_side",
    "expand",
    "predictor_side",
    "taken",
    "trial",
    "weights",
]

_compiled = numba.njit(cache=True, error_model="numpy")


@_compiled
def weights(p, q, nu, lam):
    """The diagonal D = 1/(p/a + q/b)."""
    out = np.empty_like(p)
    for i in range(p.size):
        a, b = lam - nu[i], lam + nu[i]
        out[i] = a * b / (p[i] * b + q[i] * a)
    return out


@_compiled
def complementarity(p, q, nu, lam):
    """μ, the mean of all products p a and q b."""
    total = 0.0
    for i in range(p.size):
        total += p[i] * (lam - nu[i]) + q[i] * (lam + nu[i])
    return total / (2 * p.size)


@_compiled
def predictor_side(p, q, nu, lam, D, hinges, out):
    """Aim at products of 0, and at Fv = p − q; `hinges` is Fv."""
    for i in range(p.size):
        out[0, i] = -p[i] * (lam - nu[i])
        out[1, i] = -q[i] * (lam + nu[i])
        out[2, i] = -D[i] * hinges[i]


@_compiled
def expand(image, D, side, dlam, p, q, nu, lam, before, dlam_before):
    """The direction `before` (rows Δp, Δq, Δν) plus what follows from F Δv = `image` and Δλ for a right-hand side.

    Returns it and the longest steps along it that keep p and q, and a and b, nonnegative.
    """
    out = np.empty_like(before)
    rate = dual_rate = 1e-300
    total = dlam_before + dlam
    for i in range(D.size):
        a, b = lam - nu[i], lam + nu[i]
        step = D[i] * image[i] - side[2, i]
        dp = before[0, i] + (side[0, i] - p[i] * (dlam - step)) / a
        dq = before[1, i] + (side[1, i] - q[i] * (dlam + step)) / b
        dnu = before[2, i] + step
        out[0, i], out[1, i], out[2, i] = dp, dq, dnu
        if -dp > rate * p[i]:
            rate = -dp / p[i]
        if -dq > rate * q[i]:
            rate = -dq / q[i]
        if dnu - total > dual_rate * a:
            dual_rate = (dnu - total) / a
        if -dnu - total > dual_rate * b:
            dual_rate = (-dnu - total) / b
    return out, 1.0 / rate, 1.0 / dual_rate


@_compiled
def trial(p, q, nu, lam, rows, dlam, primal, dual):
    """μ after steps of p and q, and of ν and λ."""
    total = 0.0
    for i in range(p.size):
        total += (p[i] + primal * rows[0, i]) * (lam - nu[i] + dual * (dlam - rows[2, i]))
        total += (q[i] + primal * rows[1, i]) * (lam + nu[i] + dual * (dlam + rows[2, i]))
    return total / (2 * p.size)


@_compiled
def corrector_side(nu, lam, rows, dlam, D, target, out):
    """Aim at the target μ, less the second-order terms of the predictor `rows` (Mehrotra)."""
    for i in range(nu.size):
        ra = target - rows[0, i] * (dlam - rows[2, i])
        rb = target - rows[1, i] * (dlam + rows[2, i])
        out[0, i], out[1, i] = ra, rb
        out[2, i] = D[i] * (ra / (lam - nu[i]) - rb / (lam + nu[i]))


@_compiled
def centrality_side(p, q, nu, lam, rows, dlam, D, primal, dual, least, most, out):
    """Move products outside [least, most] after both steps back to that interval's ends (Gondzio)."""
    for i in range(p.size):
        a, b = lam - nu[i], lam + nu[i]
        product = (p[i] + primal * rows[0, i]) * (a + dual * (dlam - rows[2, i]))
        ra = max(min(max(product, least), most) - product, -most)
        product = (q[i] + primal * rows[1, i]) * (b + dual * (dlam + rows[2, i]))
        rb = max(min(max(product, least), most) - product, -most)
        out[0, i], out[1, i] = ra, rb
        out[2, i] = D[i] * (ra / a - rb / b)


@_compiled
def taken(p, q, nu, rows, primal, dual, inside):
    """p, q and ν after both steps, with |ν| ≤ inside."""
    out = np.empty_like(rows)
    for i in range(p.size):
        out[0, i] = p[i] + primal * rows[0, i]
        out[1, i] = q[i] + primal * rows[1, i]
        out[2, i] = min(max(nu[i] + dual * rows[2, i], -inside), inside)
    return out[0], out[1], out[2]
