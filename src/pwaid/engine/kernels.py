"""The vector arithmetic of the interior point method, compiled: one pass over the hinges each.

Letters as in `pwaid.engine.interior`: p, q ≥ 0 split Fv = p − q; a = λ − ν and b = λ + ν are their multipliers.
λ moves too (dlam) when `pwaid.lambda_max` looks for its smallest value.
"""

from __future__ import annotations

import numba
import numpy as np

__all__ = [
    "centrality_targets",
    "complementarity",
    "expand",
    "multiplier_step",
    "products",
    "reduce",
    "second_order",
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
def products(p, q, nu, lam, ra, rb):
    """The right-hand sides that aim at products of 0."""
    for i in range(p.size):
        ra[i] = -p[i] * (lam - nu[i])
        rb[i] = -q[i] * (lam + nu[i])


@_compiled
def reduce(D, rp, ra, rb, nu, lam):
    """D (rp + ra/a − rb/b), the hinges' part of the right-hand side; rp may be a number."""
    out = np.empty_like(D)
    rp = np.broadcast_to(np.asarray(rp), D.shape)
    for i in range(D.size):
        out[i] = D[i] * (rp[i] + ra[i] / (lam - nu[i]) - rb[i] / (lam + nu[i]))
    return out


@_compiled
def multiplier_step(indptr, indices, data, dv, D, g):
    """Δν = D F Δv − g, F in compressed rows."""
    out = np.empty_like(D)
    for i in range(D.size):
        total = 0.0
        for t in range(indptr[i], indptr[i + 1]):
            total += data[t] * dv[indices[t]]
        out[i] = D[i] * total - g[i]
    return out


@_compiled
def expand(step, dlam, ra, rb, p, q, nu, lam, before, dlam_before):
    """The direction `before` (rows Δp, Δq, Δν) plus a step in ν and λ and what follows for p and q.

    Returns it and the longest step along it that keeps p, q, a and b nonnegative.
    """
    out = np.empty_like(before)
    rate = 1e-300
    total = dlam_before + dlam
    for i in range(step.size):
        a, b = lam - nu[i], lam + nu[i]
        dp = before[0, i] + (ra[i] - p[i] * (dlam - step[i])) / a
        dq = before[1, i] + (rb[i] - q[i] * (dlam + step[i])) / b
        dnu = before[2, i] + step[i]
        out[0, i], out[1, i], out[2, i] = dp, dq, dnu
        if -dp > rate * p[i]:
            rate = -dp / p[i]
        if -dq > rate * q[i]:
            rate = -dq / q[i]
        if dnu - total > rate * a:
            rate = (dnu - total) / a
        if -dnu - total > rate * b:
            rate = (-dnu - total) / b
    return out, 1.0 / rate


@_compiled
def trial(p, q, nu, lam, dp, dq, dnu, dlam, step):
    """μ after a step."""
    total = 0.0
    for i in range(p.size):
        total += (p[i] + step * dp[i]) * (lam - nu[i] + step * (dlam - dnu[i]))
        total += (q[i] + step * dq[i]) * (lam + nu[i] + step * (dlam + dnu[i]))
    return total / (2 * p.size)


@_compiled
def second_order(dp, dq, dnu, dlam, target, ra, rb):
    """Mehrotra's right-hand sides: the target μ less the predictor's second-order terms."""
    for i in range(dp.size):
        ra[i] = target - dp[i] * (dlam - dnu[i])
        rb[i] = target - dq[i] * (dlam + dnu[i])


@_compiled
def centrality_targets(p, q, nu, lam, dp, dq, dnu, dlam, step, target, low, high, ra, rb):
    """Gondzio's right-hand sides: move products outside [low, high] · target back to that interval's ends."""
    for i in range(p.size):
        product = (p[i] + step * dp[i]) * (lam - nu[i] + step * (dlam - dnu[i]))
        ra[i] = max(min(max(product, low * target), high * target) - product, -high * target)
        product = (q[i] + step * dq[i]) * (lam + nu[i] + step * (dlam + dnu[i]))
        rb[i] = max(min(max(product, low * target), high * target) - product, -high * target)
