"""The flow of a piecewise-affine system between and across guards: ẋ = A_i x + a_i + B_i u while G_i x +
H_i u + g_i ≥ 0.

In one cell, with u held, the flow is the matrix exponential of [[A, a + B u], [0, 0]]. Here it is a Taylor
polynomial of degree 16 on steps h with ‖A‖ h ≤ 0.7 in a balanced norm, so that the remainder (0.7^17 / 17!
= 7e-18) is below rounding: the matrix exponential without squaring. The same polynomial gives every guard
as a polynomial of time, whose first crossing `pwaid.dynamics.events` certifies. Nothing here depends on the
times at which a caller wants samples.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.linalg import matrix_balance

from pwaid.dynamics.events import DEGREE, NO_CROSSING, TOLERANCE, clear_start, entry_sign, first_crossing

__all__ = ["DONE", "NO_CELL", "FlowTables", "natural_step", "run"]

DONE, NO_CELL, ZENO, DIVERGED, FULL = 0, 1, 2, 3, 4
STEP = 0.7


class FlowTables(NamedTuple):
    """Every cell's matrices, padded to one shape, as the compiled loop wants them (m cells, R rows at
    most).
    """

    A: np.ndarray  # (m, n, n)
    a: np.ndarray  # (m, n)
    B: np.ndarray  # (m, n, p)
    G: np.ndarray  # (m, R, n)
    H: np.ndarray  # (m, R, p)
    g: np.ndarray  # (m, R)
    rows: np.ndarray  # (m,) guards in use
    step: np.ndarray  # (m,) longest step, seconds
    n_cells: int  # ordinary cells; the rest are sliding motions


class Events(NamedTuple):
    """Buffers that `run` fills: one row per crossing; `state[0]` counts them."""

    time: np.ndarray
    x: np.ndarray
    before: np.ndarray
    after: np.ndarray
    row: np.ndarray
    ambiguous: np.ndarray


def natural_step(A: np.ndarray, scale: float = 1.0) -> float:
    """Longest step (seconds) on which the Taylor polynomial of exp(A t) is exact to rounding."""
    if A.size == 0 or not A.any():
        return np.inf
    balanced = matrix_balance(A, permute=False)[0]
    norm = min(np.linalg.norm(balanced, 1), np.linalg.norm(balanced, np.inf))
    return scale * STEP / norm


@njit(cache=True)
def taylor(tab, cell, x, u, h, X):
    """Fill X (DEGREE + 1, n) so that x(t + s h) = Σ X_k s^k in `cell`."""
    n = x.size
    X[0] = x
    for k in range(DEGREE):
        for i in range(n):
            rate = 0.0
            for j in range(n):
                rate += tab.A[cell, i, j] * X[k, j]
            if k == 0:
                rate += tab.a[cell, i]
                for j in range(u.size):
                    rate += tab.B[cell, i, j] * u[j]
            X[k + 1, i] = rate * (h / (k + 1))


@njit(cache=True)
def guard(tab, cell, row, X, u, c):
    """Fill c with the polynomial of one guard and return what counts as zero for it."""
    n = X.shape[1]
    constant, size = tab.g[cell, row], abs(tab.g[cell, row])
    for j in range(u.size):
        term = tab.H[cell, row, j] * u[j]
        constant += term
        size += abs(term)
    for k in range(DEGREE + 1):
        c[k] = 0.0
        for j in range(n):
            term = tab.G[cell, row, j] * X[k, j]
            c[k] += term
            size += abs(term)
    c[0] += constant
    return TOLERANCE * size


@njit(cache=True)
def holds(tab, cell, x, u, span, X, c):
    """Whether the flow of `cell` from x stays in `cell` for a moment."""
    taylor(tab, cell, x, u, min(tab.step[cell], span), X)
    for row in range(tab.rows[cell]):
        tol = guard(tab, cell, row, X, u, c)
        if entry_sign(c, tol) < 0:
            return False
    return True


@njit(cache=True)
def choose(tab, x, u, current, span):
    """The cell in which the motion goes on from x, and whether another cell would do as well with another
    velocity.

    Returns -1 when no cell agrees with its own flow: the motion slides, or leaves the partition.
    """
    X = np.empty((DEGREE + 1, x.size))
    c = np.empty(DEGREE + 1)
    found, ambiguous = -1, False
    velocity = np.empty(x.size)
    if 0 <= current < tab.n_cells and holds(tab, current, x, u, span, X, c):
        found = current
        velocity[:] = X[1] / min(tab.step[current], span)
    for cell in range(tab.n_cells):
        if cell == current or not holds(tab, cell, x, u, span, X, c):
            continue
        rate = X[1] / min(tab.step[cell], span)
        if found < 0:
            found = cell
            velocity[:] = rate
        elif np.abs(rate - velocity).max() > 1e-9 * (np.abs(rate).max() + np.abs(velocity).max()):
            ambiguous = True
    if found < 0 and current >= tab.n_cells and holds(tab, current, x, u, span, X, c):
        found = current
    return found, ambiguous


@njit(cache=True)
def _first_event(tab, cell, X, u, h, h_full):
    """First guard of `cell` that ends within h, as a share of h, and its row; X is scaled to h_full ≥ h on
    entry.
    """
    c = np.empty(DEGREE + 1)
    first, which = NO_CROSSING, -1
    ratio = h / h_full
    for row in range(tab.rows[cell]):
        tol = guard(tab, cell, row, X, u, c)
        clear_start(c, tol)
        power = 1.0
        for k in range(DEGREE + 1):
            c[k] *= power
            power *= ratio
        s = first_crossing(c, tol)
        if s < first:
            first, which = s, row
    return first, which


@njit(cache=True)
def _at(X, s, x):
    x[:] = X[DEGREE]
    for k in range(DEGREE - 1, -1, -1):
        x *= s
        x += X[k]


@njit(cache=True)
def _accumulates(times, count, number, within):
    """Whether the last `number` crossings lie closer than `within`, the later half closer than the
    earlier.
    """
    if count < number:
        return False
    last, middle, first = times[count - 1], times[count - 1 - number // 2], times[count - number]
    return last - first < within and last - middle <= 0.9 * (middle - first)


@njit(cache=True)
def _change_cell(tab, x, u, state, now, events, row, span):
    """Choose the cell after guard `row` has ended (-1: after a jump of the input), and record a change."""
    e, cell = state[0], state[1]
    following, ambiguous = choose(tab, x, u, cell, span)
    if following == cell:
        return DONE
    if e >= events.time.size:
        return FULL
    events.time[e], events.x[e] = now[0], x
    events.before[e], events.after[e], events.row[e] = cell, following, row
    events.ambiguous[e] = ambiguous
    if following < 0:
        return NO_CELL  # the caller decides, and completes the record
    state[0] += 1
    state[1] = following
    return DONE


@njit(cache=True)
def run(tab, time, inputs, x, state, now, states, cells, events, limit, zeno_events, zeno_time):
    """Move (x, state, now) on until the last sample, or until a reason to stop; fill samples and events on
    the way.

    Parameters
    ----------
    tab : FlowTables
    time, inputs : ndarray (N,), (N, p)
        inputs[k] is held from time[k] to time[k + 1].
    x : ndarray (n,), changed in place
    state : ndarray of int (4,), changed in place
        Events so far, cell, samples filled, index of the input now held.
    now : ndarray (1,), changed in place
    states, cells : ndarray (N, n), (N,), filled
    events : Events, filled
    limit : float
        |x| beyond which the motion has diverged.
    zeno_events, zeno_time : int, float
        That many events within that time, ever closer, are an accumulation of events.
    """
    N = time.size
    X = np.empty((DEGREE + 1, x.size))
    span = time[N - 1] - time[0]
    while True:
        if state[3] == N - 1:
            if state[2] < N:
                states[N - 1] = x
                cells[N - 1] = state[1]
                state[2] = N
            return DONE
        u = inputs[state[3]]
        hold_end = state[3] + 1  # next sample at which the input changes
        while hold_end < N - 1 and np.all(inputs[hold_end] == u):
            hold_end += 1
        while now[0] < time[hold_end]:
            cell = state[1]
            h_full = min(tab.step[cell], span)
            h = min(h_full, time[hold_end] - now[0])
            taylor(tab, cell, x, u, h_full, X)
            s, row = _first_event(tab, cell, X, u, h, h_full)
            reach = time[hold_end] if h < h_full else now[0] + h
            if s <= 1.0:
                reach = now[0] + h * s
            while time[state[2]] < reach:  # a sample at the time of a crossing belongs to the cell after it
                _at(X, (time[state[2]] - now[0]) / h_full, states[state[2]])
                cells[state[2]] = cell
                state[2] += 1
            _at(X, (h * s if s <= 1.0 else reach - now[0]) / h_full, x)
            now[0] = reach
            if not np.all(np.abs(x) <= limit):
                return DIVERGED
            if s <= 1.0:
                stop = _change_cell(tab, x, u, state, now, events, row, span)
                if stop != DONE:
                    return stop
                if _accumulates(events.time, state[0], zeno_events, zeno_time):
                    return ZENO
        state[3] = hold_end
        if np.any(inputs[hold_end] != u):
            stop = _change_cell(tab, x, inputs[hold_end], state, now, events, -1, span)
            if stop != DONE:
                return stop
