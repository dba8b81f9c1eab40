"""The compiled simulation loop: a plant, up to three injected effects, many recordings in one call.

One stage of the plant is ``rhs(t, x, u, p, dx)``; an effect is one function called at five phases:

====== ===================================================================================
phase  what the effect may do
====== ===================================================================================
0      at the start of a substep: update memory kept in its own extra states (play, rate)
1      before the plant's right-hand side: change the state, input, parameters *it sees*
2      after it: add to the derivative, set the derivative of its own extra states
3      at a sample: change the outputs (``dx`` holds y)
4      after the substep, near rest: dry friction as a proximal step (``dx``: mobility column)
5      while sliding: dry friction as a force of known sign (``xs``: mobility column)
====== ===================================================================================

While a body slides, dry friction is a force of fixed sign inside the Runge-Kutta step. A substep in
which it would reverse, stop or be released is repeated in eight pieces; a piece that holds the event
is a *proximal* step: the velocity that the smooth forces would reach is pulled towards zero by at
most h·mobility·level, and the position corrected to second order. Sticking is exact, nothing is
stiff, and no smoothing width of sign(v) has to be chosen.
"""

from __future__ import annotations

import warnings

import numpy as np
from numba import float64 as f8
from numba import int64 as i8
from numba import njit, types
from numba.core.errors import NumbaExperimentalFeatureWarning

__all__ = ["EFFECT_TYPE", "OUT_TYPE", "RHS_TYPE", "idle", "simulate_segments"]

# everything here is compiled at import; passing functions on to inner functions is what numba warns about
warnings.filterwarnings("ignore", category=NumbaExperimentalFeatureWarning)

_V = f8[::1]
RHS_TYPE = types.FunctionType(types.void(f8, _V, _V, _V, _V))
OUT_TYPE = RHS_TYPE
EFFECT_SIGNATURE = types.void(i8, f8, f8, _V, _V, _V, _V, _V, i8[::1], _V)
EFFECT_TYPE = types.FunctionType(EFFECT_SIGNATURE)


@njit(EFFECT_SIGNATURE, cache=True, nogil=True, error_model="numpy")
def idle(phase, t, h, x, xs, u, p, dx, ii, q):
    """The effect that does nothing; it fills unused places of the engine."""


@njit(
    types.void(RHS_TYPE, EFFECT_TYPE, EFFECT_TYPE, EFFECT_TYPE, i8, i8, f8, f8, _V, _V, _V, _V, i8[:, ::1],
               f8[:, ::1],
               _V, _V, _V, f8[:, ::1], i8[::1], types.boolean),
    cache=True, nogil=True, error_model="numpy",
)
def _stage(rhs, e0, e1, e2, ne, nx, t, h, x, u, p, dx, II, Q, xs, us, ps, mobility, proximal, sliding):
    """One evaluation of the augmented right-hand side into dx."""
    xs[:] = x
    us[:] = u
    ps[:] = p
    dx[:] = 0.0
    if ne > 0:
        e0(1, t, h, x, xs, us, ps, dx, II[0], Q[0])
    if ne > 1:
        e1(1, t, h, x, xs, us, ps, dx, II[1], Q[1])
    if ne > 2:
        e2(1, t, h, x, xs, us, ps, dx, II[2], Q[2])
    rhs(t, xs[:nx], us, ps, dx[:nx])
    if ne > 0:
        e0(2, t, h, x, xs, us, ps, dx, II[0], Q[0])
    if ne > 1:
        e1(2, t, h, x, xs, us, ps, dx, II[1], Q[1])
    if ne > 2:
        e2(2, t, h, x, xs, us, ps, dx, II[2], Q[2])
    if sliding:
        if proximal[0] > 0:
            e0(5, t, h, x, mobility[0], us, ps, dx, II[0], Q[0])
        if proximal[1] > 0:
            e1(5, t, h, x, mobility[1], us, ps, dx, II[1], Q[1])
        if proximal[2] > 0:
            e2(5, t, h, x, mobility[2], us, ps, dx, II[2], Q[2])


@njit(
    types.void(RHS_TYPE, i8, f8, _V, _V, _V, _V, i8[::1], _V, _V, _V, _V),
    cache=True, nogil=True, error_model="numpy",
)
def _mobility(rhs, nx, t, x, u, p, col, ii, base, us, ps, xs):
    """Acceleration per unit force at the place ii describes, into col."""
    col[:] = 0.0
    if ii[1] == 0:
        us[:] = u
        xs[:] = x
        rhs(t, xs[:nx], us, p, base[:nx])
        us[ii[2]] += 1.0
        rhs(t, xs[:nx], us, p, col[:nx])
        for i in range(nx):
            col[i] -= base[i]
    elif ii[3] >= 0:
        col[ii[2]] = 1.0 / p[ii[3]]
    else:
        col[ii[2]] = 1.0


@njit(_V(f8[:, ::1], i8, i8, i8, i8, i8, _V, _V, f8, f8), cache=True, nogil=True, error_model="numpy")
def _input_at(U, first, last, k, s, S, delay, u, Ts, hold):
    """Mean of each delayed input over substep s of sample k; samples before the first repeat it."""
    for j in range(u.size):
        if delay[j] == 0.0 and hold == 0.0:
            u[j] = U[k, j]
            continue
        a = k + s / S - delay[j] / Ts  # in samples
        b = a + 1.0 / S
        if hold > 0.0:  # first-order hold, value at the middle of the substep
            m = 0.5 * (a + b)
            i = int(np.floor(m))
            f = m - i
            lo = min(max(i, first), last - 1)
            hi = min(max(i + 1, first), last - 1)
            u[j] = (1.0 - f) * U[lo, j] + f * U[hi, j]
        else:
            ia = int(np.floor(a + 1e-9))
            ib = int(np.floor(b - 1e-9))
            va = U[min(max(ia, first), last - 1), j]
            vb = U[min(max(ib, first), last - 1), j]
            if ia == ib:
                u[j] = va
            else:
                w = (ib - a) / (b - a)
                u[j] = w * va + (1.0 - w) * vb
    return u


@njit(
    types.void(RHS_TYPE, EFFECT_TYPE, EFFECT_TYPE, EFFECT_TYPE, i8, i8, i8, f8, f8, _V, _V, _V, i8[:, ::1],
               f8[:, ::1],
               _V, _V, _V, _V, _V, _V, _V, _V, _V, i8, f8, i8[::1], types.boolean, i8[::1], _V, f8[:, ::1],
               types.boolean),
    cache=True, nogil=True, error_model="numpy",
)
def _substep(rhs, e0, e1, e2, ne, nx, nt, ts, h, x, u, p, II, Q, xs, us, ps, before, w, k1, k2, k3, k4,
             discrete, Ts,
             proximal, any_prox, partner, ratio, mobility, sliding):
    """Advance x by h: memory, one Runge-Kutta step, dry friction inside it (sliding) or after it."""
    if any_prox:
        for e in range(ne):
            if proximal[e] > 0:
                _mobility(rhs, nx, ts, x, u, p, mobility[e], II[e], k2, us, ps, xs)
    if ne > 0:
        e0(0, ts, h, x, xs, u, p, k1, II[0], Q[0])
    if ne > 1:
        e1(0, ts, h, x, xs, u, p, k1, II[1], Q[1])
    if ne > 2:
        e2(0, ts, h, x, xs, u, p, k1, II[2], Q[2])
    before[:] = x
    _stage(rhs, e0, e1, e2, ne, nx, ts, h, x, u, p, k1, II, Q, xs, us, ps, mobility, proximal, sliding)
    if discrete > 0:
        for i in range(nx):
            x[i] = k1[i]
        for i in range(nx, nt):
            x[i] += Ts * k1[i]
    else:
        for i in range(nt):
            w[i] = x[i] + 0.5 * h * k1[i]
        _stage(rhs, e0, e1, e2, ne, nx, ts + 0.5 * h, h, w, u, p, k2, II, Q, xs, us, ps, mobility, proximal,
               sliding)
        for i in range(nt):
            w[i] = x[i] + 0.5 * h * k2[i]
        _stage(rhs, e0, e1, e2, ne, nx, ts + 0.5 * h, h, w, u, p, k3, II, Q, xs, us, ps, mobility, proximal,
               sliding)
        for i in range(nt):
            w[i] = x[i] + h * k3[i]
        _stage(rhs, e0, e1, e2, ne, nx, ts + h, h, w, u, p, k4, II, Q, xs, us, ps, mobility, proximal,
               sliding)
        for i in range(nt):
            x[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    if any_prox and not sliding:
        w[:] = x
        for e in range(ne):
            if proximal[e] > 0:
                k1[:] = mobility[e]
                if e == 0:
                    e0(4, ts, h, x, before, u, p, k1, II[e], Q[e])
                elif e == 1:
                    e1(4, ts, h, x, before, u, p, k1, II[e], Q[e])
                else:
                    e2(4, ts, h, x, before, u, p, k1, II[e], Q[e])
        if discrete == 0:
            for i in range(nx):  # the friction force acted during the whole substep
                j = partner[i]
                if j >= 0:
                    x[i] = before[i] if before[j] == 0.0 and x[j] == 0.0 else x[i] + 0.5 * h * ratio[i] * (x[j] - w[j])


@njit(
    i8(RHS_TYPE, OUT_TYPE, EFFECT_TYPE, EFFECT_TYPE, EFFECT_TYPE, i8, i8, f8[:, ::1], i8[:, ::1], f8[:, ::1],
       _V,
       f8, i8, f8, i8, _V, i8[:, ::1], f8[:, ::1], i8[::1], i8[::1], _V, f8[:, ::1], f8[:, ::1], f8),
    cache=True, nogil=True, error_model="numpy",
)
def simulate_segments(rhs, out, e0, e1, e2, ne, nx, X0, segments, U, delay, Ts, S, hold, discrete, p, II, Q,
                      proximal, partner, ratio, X, Y, limit):
    """Simulate every segment from its own start; fill the states X and the outputs Y at the samples.

    Returns the number of segments that left the range |x| <= limit or became NaN; from there on
    their outputs are filled with `limit`.
    """
    nt = X0.shape[1]
    nu = U.shape[1]
    ny = Y.shape[1]
    x = np.zeros(nt)
    w = np.zeros(nt)
    xs = np.zeros(nt)
    before = np.zeros(nt)
    start = np.zeros(nt)
    mobility = np.zeros((3, nt))
    k1 = np.zeros(nt)
    k2 = np.zeros(nt)
    k3 = np.zeros(nt)
    k4 = np.zeros(nt)
    u = np.zeros(nu)
    us = np.zeros(nu)
    ps = np.zeros(p.size)
    y = np.zeros(ny)
    h = Ts / S
    failed = 0
    any_prox = False
    for e in range(ne):
        if proximal[e] > 0:
            any_prox = True
    for g in range(segments.shape[0]):
        first, last = segments[g, 0], segments[g, 1]
        begin, end = segments[g, 2], segments[g, 3]  # the recording's samples: history of delayed inputs
        x[:] = X0[g]
        alive = True
        for k in range(first, last):
            t = (k - begin) * Ts
            _input_at(U, begin, end, k, 0, S, delay, u, Ts, 0.0)
            X[k] = x
            # outputs
            xs[:] = x
            us[:] = u
            ps[:] = p
            if ne > 0:
                e0(1, t, 0.0, x, xs, us, ps, k1, II[0], Q[0])
            if ne > 1:
                e1(1, t, 0.0, x, xs, us, ps, k1, II[1], Q[1])
            if ne > 2:
                e2(1, t, 0.0, x, xs, us, ps, k1, II[2], Q[2])
            out(t, x[:nx], us, ps, y)
            if ne > 0:
                e0(3, t, Ts, x, xs, us, ps, y, II[0], Q[0])
            if ne > 1:
                e1(3, t, Ts, x, xs, us, ps, y, II[1], Q[1])
            if ne > 2:
                e2(3, t, Ts, x, xs, us, ps, y, II[2], Q[2])
            Y[k] = y
            if not alive:
                Y[k] = limit
                continue
            for s in range(S):
                pieces, piece = 1, 0
                _input_at(U, begin, end, k, s, S, delay, u, Ts, hold)
                while piece < pieces:
                    hh = h / pieces
                    ts = t + s * h + piece * hh
                    start[:] = x
                    sliding = any_prox and discrete == 0
                    for e in range(ne):
                        if proximal[e] > 0 and x[II[e, 4]] == 0.0:
                            sliding = False
                    _substep(rhs, e0, e1, e2, ne, nx, nt, ts, hh, x, u, p, II, Q, xs, us, ps, before, w, k1,
                             k2, k3, k4,
                             discrete, Ts, proximal, any_prox, partner, ratio, mobility, sliding)
                    piece += 1
                    if not any_prox or discrete > 0:
                        continue
                    event = False
                    for e in range(ne):  # a reversal, a stop or a release inside this piece
                        if proximal[e] > 0:
                            v0, v1 = start[II[e, 4]], x[II[e, 4]]
                            event |= v0 * v1 <= 0.0 and (v0 != 0.0 or v1 != 0.0)
                    if event and pieces == 1:
                        x[:] = start
                        pieces, piece = 8, 0
                    elif event and sliding:
                        x[:] = start
                        _substep(rhs, e0, e1, e2, ne, nx, nt, ts, hh, x, u, p, II, Q, xs, us, ps, before, w,
                                 k1, k2, k3,
                                 k4, discrete, Ts, proximal, any_prox, partner, ratio, mobility, False)
                for i in range(nt):
                    if not (abs(x[i]) <= limit):
                        alive = False
                if not alive:
                    failed += 1
                    x[:] = 0.0
                    break
    return failed
