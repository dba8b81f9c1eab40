"""The vector arithmetic of the interior point method, compiled: one pass over the hinges each.

Letters as in `pwaid.engine.interior`: p, q ≥ 0 split Fv = p − q; a = λ − ν and b = λ + ν are their multipliers.
"""

from __future__ import annotations

import numba
import numpy as np

__all__ = [
    "centrality_targets", "complementarity", "expand", "longest_step", "reduce", "second_order", "trial", "weights",
]


@numba.njit(cache=True, error_model="numpy")
def weights(p, q, nu, lam):
    """The diagonal D = 1/(p/a + q/b)."""
    out = np.empty_like(p)
    for i in range(p.size):
        a, b = lam - nu[i], lam + nu[i]
        out[i] = a * b / (p[i] * b + q[i] * a)
    return out


@numba.njit(cache=True, error_model="numpy")
def complementarity(p, q, nu, lam):
    """μ, the mean of all products p a and q b."""
    total = 0.0
    for i in range(p.size):
        total += p[i] * (lam - nu[i]) + q[i] * (lam + nu[i])
    return total / (2 * p.size)


@numba.njit(cache=True, error_model="numpy")
def reduce(D, rp, ra, rb, nu, lam):
    """D (rp + ra/a − rb/b), the hinges' part of the right-hand side."""
    out = np.empty_like(D)
    for i in range(D.size):
        out[i] = D[i] * (rp[i] + ra[i] / (lam - nu[i]) - rb[i] / (lam + nu[i]))
    return out


@numba.njit(cache=True, error_model="numpy")
def expand(D, g, Fdv, ra, rb, p, q, nu, lam, dnu, dp, dq):
    """Add the direction of the eliminated variables to dnu, dp, dq."""
    for i in range(D.size):
        step = D[i] * Fdv[i] - g[i]
        dnu[i] += step
        dp[i] += (ra[i] + p[i] * step) / (lam - nu[i])
        dq[i] += (rb[i] - q[i] * step) / (lam + nu[i])


@numba.njit(cache=True, error_model="numpy")
def longest_step(p, q, nu, lam, dp, dq, dnu):
    """The largest step that keeps p, q, a and b nonnegative."""
    rate = 1e-300
    for i in range(p.size):
        rate = max(
            rate, -dp[i] / p[i], -dq[i] / q[i], dnu[i] / (lam - nu[i]), -dnu[i] / (lam + nu[i])
        )
    return 1.0 / rate


@numba.njit(cache=True, error_model="numpy")
def trial(p, q, nu, lam, dp, dq, dnu, step):
    """μ after a step."""
    total = 0.0
    for i in range(p.size):
        total += (p[i] + step * dp[i]) * (lam - nu[i] - step * dnu[i])
        total += (q[i] + step * dq[i]) * (lam + nu[i] + step * dnu[i])
    return total / (2 * p.size)


@numba.njit(cache=True, error_model="numpy")
def second_order(dp, dq, dnu, target, ra, rb):
    """Mehrotra's right-hand sides: the target μ and the predictor's second-order terms."""
    for i in range(dp.size):
        ra[i] = target + dp[i] * dnu[i]
        rb[i] = target - dq[i] * dnu[i]


@numba.njit(cache=True, error_model="numpy")
def centrality_targets(p, q, nu, lam, dp, dq, dnu, step, target, low, high, ra, rb):
    """Gondzio's right-hand sides: move products outside [low, high] · target back to that interval's ends."""
    for i in range(p.size):
        product = (p[i] + step * dp[i]) * (lam - nu[i] - step * dnu[i])
        ra[i] = max(min(max(product, low * target), high * target) - product, -high * target)
        product = (q[i] + step * dq[i]) * (lam + nu[i] + step * dnu[i])
        rb[i] = max(min(max(product, low * target), high * target) - product, -high * target)
