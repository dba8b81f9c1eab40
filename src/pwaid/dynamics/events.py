"""The first crossing of a guard along a flow, certified: p(s) = Σ c_k s^k on 0 ≤ s ≤ 1, p(0) ≥ 0.

A flow is known to this file only through its Taylor polynomials, whose step is chosen by the caller so
short that the truncation is below rounding. A polynomial on [0, 1] lies in the convex hull of its Bernstein
coefficients. If they are all positive there is no crossing; if their signs change once there is exactly
one; otherwise the interval is halved (de Casteljau), left half first. So two crossings within one step, or
a short dip through a guard, are never missed, down to a depth of `TOLERANCE` times the size of the terms
that make up the guard.
"""

from __future__ import annotations

from math import comb

import numpy as np
from numba import njit

__all__ = ["DEGREE", "NO_CROSSING", "TOLERANCE", "clear_start", "entry_sign", "first_crossing"]

DEGREE = 16  # of the Taylor polynomials
TOLERANCE = 1e-13  # what counts as zero, relative to the terms that were added up
NO_CROSSING = 2.0  # returned by `first_crossing` when the guard holds on the whole of [0, 1]

_TO_BERNSTEIN = np.array(
    [[comb(i, k) / comb(DEGREE, k) if k <= i else 0.0 for k in range(DEGREE + 1)] for i in range(DEGREE + 1)]
)
_DEPTH = 48


@njit(cache=True)
def entry_sign(c, tol):
    """Sign of p just after s = 0: that of the first coefficient which is not zero to `tol`; 0 if there is
    none.
    """
    for k in range(DEGREE + 1):
        if c[k] > tol:
            return 1
        if c[k] < -tol:
            return -1
    return 0


@njit(cache=True)
def _value(c, s):
    p = c[DEGREE]
    for k in range(DEGREE - 1, -1, -1):
        p = p * s + c[k]
    return p


@njit(cache=True)
def _bisect(c, low, high):
    """The crossing in (low, high] where exactly one is known to be; the end at which p ≤ 0."""
    for _ in range(60):
        middle = 0.5 * (low + high)
        if middle <= low or middle >= high:
            break
        if _value(c, middle) > 0.0:
            low = middle
        else:
            high = middle
    return high


@njit(cache=True)
def _halve(b, left, right):
    """De Casteljau at the middle: `b` on an interval becomes `left` and `right` on its halves."""
    work = b.copy()
    left[0] = work[0]
    right[DEGREE] = work[DEGREE]
    for level in range(1, DEGREE + 1):
        for i in range(DEGREE + 1 - level):
            work[i] = 0.5 * (work[i] + work[i + 1])
        left[level] = work[0]
        right[DEGREE - level] = work[DEGREE - level]


@njit(cache=True)
def _first_in_bernstein(c, b, tol):
    """First crossing of a polynomial with Bernstein coefficients `b` on [0, 1] that failed the quick test."""
    stack = np.empty((_DEPTH + 2, DEGREE + 1))
    low = np.empty(_DEPTH + 2)
    width = np.empty(_DEPTH + 2)
    stack[0], low[0], width[0] = b, 0.0, 1.0
    top = 0
    while top >= 0:
        row, lo, w = stack[top].copy(), low[top], width[top]
        top -= 1
        smallest, largest, changes = row[0], abs(row[0]), 0
        for i in range(1, DEGREE + 1):
            smallest = min(smallest, row[i])
            largest = max(largest, abs(row[i]))
            if (row[i] > 0.0) != (row[i - 1] > 0.0):
                changes += 1
        if smallest > 0.0:
            continue
        if row[0] <= 0.0:
            return lo
        if changes == 1:
            return _bisect(c, lo, lo + w)
        if largest <= tol or w < 2.0**-_DEPTH:
            return lo  # touches the guard; the caller decides by the flow just after
        _halve(row, stack[top + 2], stack[top + 1])
        low[top + 2], low[top + 1] = lo, lo + 0.5 * w
        width[top + 2] = width[top + 1] = 0.5 * w
        top += 2
    return NO_CROSSING


@njit(cache=True)
def clear_start(c, tol):
    """Set the leading coefficients that are zero to `tol` to zero, in place: the motion starts on the guard.

    It then leaves by the sign of the first coefficient that is not zero, which is how `first_crossing`
    decides.
    """
    for k in range(DEGREE + 1):
        if abs(c[k]) > tol:
            return
        c[k] = 0.0


@njit(cache=True)
def first_crossing(c, tol):
    """First s in [0, 1] at which the guard p(s) ≥ 0 ends, or `NO_CROSSING`.

    Parameters
    ----------
    c : ndarray (DEGREE + 1,)
        Coefficients of p; leading zeros (see `clear_start`) mean that the motion starts on the guard.
    tol : float
        Depth of a touch that is not told from a crossing, in the unit of p.
    """
    first = 0
    while first <= DEGREE and c[first] == 0.0:
        first += 1
    if first > DEGREE:
        return NO_CROSSING  # runs along the guard
    if c[first] < 0.0:
        return 0.0
    shifted = np.zeros(DEGREE + 1)
    shifted[: DEGREE + 1 - first] = c[first:]
    b = np.zeros(DEGREE + 1)
    smallest = shifted[0]
    for i in range(DEGREE + 1):
        for k in range(i + 1):
            b[i] += _TO_BERNSTEIN[i, k] * shifted[k]
        smallest = min(smallest, b[i])
    if smallest > 0.0:
        return NO_CROSSING
    return _first_in_bernstein(shifted, b, tol)
