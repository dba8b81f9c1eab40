"""The compiled simulation loop: a plant, up to three injected effects, many recordings in one call.

One stage of the plant is ``rhs(t, x, u, p, dx)``, derivatives or the next states of a discrete plant, which are turned
into changes per second; an effect is one function called at seven phases:

====== ===================================================================================
phase  what the effect may do
====== ===================================================================================
0      at the start of a substep: update memory kept in its own extra states (play, rate)
1      before the plant's right-hand side: change the state, input, parameters *it sees*
2      after it: add to the derivative, set the derivative of its own extra states
3      at a sample: change the outputs (``dx`` holds y)
4      after the substep, near rest: dry friction as a proximal step (``dx``: mobility column)
5      while sliding: dry friction as a force of known sign (``xs``: mobility column along the motion)
6      what it makes of a mobility column ``dx`` of the plant's: a mass that it adds or uncouples
====== ===================================================================================

While a body slides, dry friction is a force of fixed sign inside the Runge-Kutta step: that of the
speed with which the substep began, since a stage that turned it early could keep the step from ever
reaching rest. A substep in which it would reverse, stop or be released is repeated in eight pieces; a
piece that holds the event is a *proximal* step: the velocity that the smooth forces would reach is
pulled towards zero by at most h·mobility·level, and the position corrected to second order. Sticking
is exact, nothing is stiff, and no smoothing width of sign(v) has to be chosen.
"""

from __future__ import annotations

import warnings

import numpy as np
from numba import float64 as f8
from numba import int64 as i8
from numba import njit, types
from numba.core import cgutils
from numba.core.errors import NumbaExperimentalFeatureWarning
from numba.extending import intrinsic

__all__ = ["EFFECT_TYPE", "INSTANT", "OUT_TYPE", "RHS_TYPE", "idle", "simulate_segments", "simulate_variants", "still"]

# everything here is compiled at import; passing functions on to inner functions is what numba warns about
warnings.filterwarnings("ignore", category=NumbaExperimentalFeatureWarning)

INSTANT = 1e-3  # of a substep: the time over which an acceleration is read off, dry friction at rest included
_V = f8[::1]
RHS_TYPE = types.FunctionType(types.void(f8, _V, _V, _V, _V))
OUT_TYPE = RHS_TYPE
EFFECT_SIGNATURE = types.void(i8, f8, f8, _V, _V, _V, _V, _V, i8[::1], _V)
EFFECT_TYPE = types.FunctionType(EFFECT_SIGNATURE)


@intrinsic
def _borrowed(typingctx, array):
    """The same array without a reference of its own.

    A compiled function counts references of the arrays it is handed by atomic operations, which for kernels of a
    few flops cost four times the kernel. The owner must outlive the borrower.
    """
    def codegen(context, builder, signature, args):
        view = context.make_array(signature.return_type)(context, builder, value=args[0])
        view.meminfo = cgutils.get_null_value(view.meminfo.type)
        view.parent = cgutils.get_null_value(view.parent.type)
        return view._getvalue()

    return array(array), codegen


@njit(EFFECT_SIGNATURE, cache=True, nogil=True, error_model="numpy")
def idle(phase, t, h, x, xs, u, p, dx, ii, q):
    """The effect that does nothing; it fills unused places of the engine."""


@njit(types.void(f8, _V, _V, _V, _V), cache=True, nogil=True, error_model="numpy")
def still(t, x, u, p, out):
    """A right-hand side whose states rest, and outputs that are zero: only what inputs remember moves."""
    out[:] = 0.0


@njit(
    types.void(RHS_TYPE, f8, f8, _V, _V, _V, _V, i8[::1], _V, _V, _V, _V, i8[::1], _V),
    cache=True, nogil=True, error_model="numpy",
)
def _mobility(rhs, t, step, x, u, p, col, ii, head, base, us, xs, partner, carry):
    """Acceleration per unit force at the place ii describes, into col; head is its first nx numbers, xs the plant's.

    `step`: seconds over which the plant's rhs is a change, 0 for derivatives.
    """
    for i in range(col.size):
        col[i] = 0.0
    if ii[1] != 1:
        for i in range(xs.size):
            xs[i] = x[i]
        for j in range(u.size):
            us[j] = u[j]
        rhs(t, xs, us, p, base)
        us[ii[2]] += 1.0 if ii[1] == 0 else -1.0
        rhs(t, xs, us, p, head)
        for i in range(xs.size):
            head[i] = (head[i] - base[i]) / (step if step > 0.0 else 1.0)
        return
    col[ii[2]] = 1.0 / p[ii[3]] if ii[3] >= 0 else 1.0
    for i in range(xs.size):  # a discrete simulator's positions move with their speeds' changes within a step
        if partner[i] == ii[2]:
            col[i] += 0.5 * step * carry[i] * col[ii[2]]


@njit(types.void(_V, i8, f8), cache=True, nogil=True, error_model="numpy")
def _turn(col, i, speed):
    """Turn a mobility column along the motion: its entry i gets the sign of that speed."""
    if (col[i] > 0.0) != (speed > 0.0):
        for k in range(col.size):
            col[k] = -col[k]


@njit(types.void(f8[:, ::1], i8, i8, i8, i8, i8, _V, _V, f8, f8), cache=True, nogil=True, error_model="numpy")
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


@njit(
    types.void(RHS_TYPE, EFFECT_TYPE, EFFECT_TYPE, EFFECT_TYPE, i8, i8, f8, f8, _V, _V, _V, _V, _V, _V,
               i8[:, ::1], f8[:, ::1], i8[::1], i8[::1], _V, i8[::1], _V, _V),
    cache=True, nogil=True, error_model="numpy",
)
def _accelerations(rhs, e0, e1, e2, ne, nx, t, h, x, xs, u, us, p, ps, II, Q, proximal, partner, carry, shown, gain,
                   y):
    """Add to outputs that show the rate of a state what the effects add to that rate, dry friction included: the
    plant's own output function knows nothing of it. xs, us, ps are what the effects let the plant see."""
    nt = x.size
    plain, k, w = np.zeros(nx), np.zeros(nt), np.zeros(nt)
    rhs(t, x[:nx], us, ps, plain)  # what the output function took
    rhs(t, xs[:nx], us, ps, k[:nx])
    if ne > 0:
        e0(2, t, h, x, xs, us, ps, k, II[0], Q[0])
    if ne > 1:
        e1(2, t, h, x, xs, us, ps, k, II[1], Q[1])
    if ne > 2:
        e2(2, t, h, x, xs, us, ps, k, II[2], Q[2])
    brief = INSTANT * h
    for i in range(nt):
        w[i] = x[i] + brief * k[i]
    for e in range(ne):
        if proximal[e] > 0:
            column = np.zeros(nt)
            _mobility(rhs, t, 0.0, x, u, p, column, II[e], column[:nx], np.zeros(nx), np.zeros(u.size), np.zeros(nx),
                      partner, carry)
            if proximal[0] == 0:
                e0(6, t, brief, x, xs, us, ps, column, II[0], Q[0])
            if ne > 1 and proximal[1] == 0:
                e1(6, t, brief, x, xs, us, ps, column, II[1], Q[1])
            if ne > 2 and proximal[2] == 0:
                e2(6, t, brief, x, xs, us, ps, column, II[2], Q[2])
            if e == 0:
                e0(4, t, brief, w, x, us, ps, column, II[e], Q[e])
            elif e == 1:
                e1(4, t, brief, w, x, us, ps, column, II[e], Q[e])
            else:
                e2(4, t, brief, w, x, us, ps, column, II[e], Q[e])
    for i in range(y.size):
        if shown[i] >= 0:
            y[i] += gain[i] * ((w[shown[i]] - x[shown[i]]) / brief - plain[shown[i]])


def simulate_segments(rhs, out, e0, e1, e2, ne, nx, X0, segments, U, delay, Ts, S, hold, discrete, p, II, Q,
                      proximal, partner, carry, shown, gain, X, Y, limit) -> int:
    """Simulate every segment from its own start; fill the states X and the outputs Y at the samples.

    discrete: 0 for derivatives, 1 for next states with what the effects do held over the step, 2 with the mean of what
    they do at both ends. carry (nx,): half a step times it is what a position moves when its speed changes in the step.

    Returns the number of segments that left the range |x| <= limit or became NaN; from there on
    their outputs are filled with `limit`.
    """
    return _loop(rhs, out, e0, e1, e2, ne, nx, X0, segments, U, delay, Ts, S, hold, discrete, p, II, Q, proximal,
                 partner, carry, shown, gain, X, Y, limit, _work(X0, U, Y, p))


def simulate_variants(rhs, out, e0, e1, e2, ne, nx, X0, segments, U, delay, Ts, S, hold, discrete, p, II, Q,
                      proximal, partner, carry, shown, gain, Y, limit) -> int:
    """The same for several X0, delay, p and Q, the first axis of each and of Y: one call, since handing compiled
    functions over costs 0.6 ms."""
    X = np.empty((len(U), X0.shape[2]))
    return _variants(rhs, out, e0, e1, e2, ne, nx, X0, segments, U, delay, Ts, S, hold, discrete, p, II, Q, proximal,
                     partner, carry, shown, gain, X, Y, limit, _work(X0[0], U, Y[0], p[0]))


def _work(X0, U, Y, p) -> np.ndarray:
    return np.zeros((14, max(X0.shape[1], U.shape[1], Y.shape[1], p.size)))


@njit(
    i8(RHS_TYPE, OUT_TYPE, EFFECT_TYPE, EFFECT_TYPE, EFFECT_TYPE, i8, i8, f8[:, ::1], i8[:, ::1], f8[:, ::1],
       _V, f8, i8, f8, i8, _V, i8[:, ::1], f8[:, ::1], i8[::1], i8[::1], _V, i8[::1], _V, f8[:, ::1], f8[:, ::1], f8,
       f8[:, ::1]),
    cache=True, nogil=True, error_model="numpy",
)
def _loop(rhs, out, e0, e1, e2, ne, nx, X0, segments, U, delay, Ts, S, hold, discrete, p, II, Q,
          proximal, partner, carry, shown, gain, X, Y, limit, work):
    """The loop of `simulate_segments`; work (14, longest) holds what would otherwise be allocated.

    One body on purpose: passing its two dozen arrays to inner functions, or slicing them inside the loops, costs
    more than the arithmetic.
    """
    nt, nu, ny, n_p = X0.shape[1], U.shape[1], Y.shape[1], p.size
    x, xs, w = _borrowed(work[0, :nt]), _borrowed(work[1, :nt]), _borrowed(work[2, :nt])
    before, start = _borrowed(work[3, :nt]), _borrowed(work[4, :nt])
    k, total = _borrowed(work[5, :nt]), _borrowed(work[6, :nt])
    u, us, ps, y = (_borrowed(work[7, :nu]), _borrowed(work[8, :nu]), _borrowed(work[9, :n_p]),
                    _borrowed(work[10, :ny]))
    m0, m1, m2 = _borrowed(work[11, :nt]), _borrowed(work[12, :nt]), _borrowed(work[13, :nt])
    p = _borrowed(p)
    i0, i1, i2 = _borrowed(II[0]), _borrowed(II[1]), _borrowed(II[2])
    q0, q1, q2 = _borrowed(Q[0]), _borrowed(Q[1]), _borrowed(Q[2])
    h0, h1, h2 = m0[:nx], m1[:nx], m2[:nx]
    xh, xsh, kh, toth, starth = x[:nx], xs[:nx], k[:nx], total[:nx], start[:nx]
    h, failed = Ts / S, 0
    stages, per = 4, 0.0
    if discrete > 0:
        stages, per = (2 if discrete > 1 and ne > 0 else 1), Ts
    any_prox = False
    for e in range(ne):
        if proximal[e] > 0:
            any_prox = True
    p0, p1, p2 = proximal[0] > 0, proximal[1] > 0, proximal[2] > 0
    chained = ne > 1 and II[0, 8] >= 0 and II[1, 8] >= 0
    accelerated = False
    for i in range(ny):
        if shown[i] >= 0 and ne > 0 and discrete == 0:
            accelerated = True
    for g in range(segments.shape[0]):
        first, last = segments[g, 0], segments[g, 1]
        begin, end = segments[g, 2], segments[g, 3]  # the recording's samples: history of delayed inputs
        ran = segments[g, 4] if segments.shape[1] > 4 else 0
        for i in range(nt):
            if not np.isnan(X0[g, i]):  # a memory that goes on from the segment before
                x[i] = X0[g, i]
        alive = True
        for sample in range(first, last):
            t = (sample - begin + ran) * Ts
            _input_at(U, begin, end, sample, 0, S, delay, u, Ts, 0.0)
            for i in range(nt):
                X[sample, i] = x[i]
                xs[i] = x[i]
            for j in range(nu):
                us[j] = u[j]
            for j in range(n_p):
                ps[j] = p[j]
            if ne > 0:
                e0(1, t, 0.0, x, xs, us, ps, k, i0, q0)
            if ne > 1:
                e1(1, t, 0.0, x, xs, us, ps, k, i1, q1)
            if ne > 2:
                e2(1, t, 0.0, x, xs, us, ps, k, i2, q2)
            out(t, xh, us, ps, y)
            if accelerated:
                _accelerations(rhs, e0, e1, e2, ne, nx, t, h, x, xs, u, us, p, ps, II, Q, proximal, partner, carry,
                               shown, gain, y)
            if ne > 0:
                e0(3, t, Ts, x, xs, us, ps, y, i0, q0)
            if ne > 1:
                e1(3, t, Ts, x, xs, us, ps, y, i1, q1)
            if ne > 2:
                e2(3, t, Ts, x, xs, us, ps, y, i2, q2)
            for i in range(ny):
                Y[sample, i] = y[i] if alive else limit
            if not alive:
                continue
            for s in range(S):
                pieces, piece = 1, 0
                if s > 0 or hold > 0.0:
                    _input_at(U, begin, end, sample, s, S, delay, u, Ts, hold)
                while piece < pieces:
                    hh = h / pieces
                    ts = t + s * h + piece * hh
                    for i in range(nt):
                        start[i] = x[i]
                    sliding = any_prox and discrete == 0
                    for e in range(ne):
                        if proximal[e] > 0 and x[II[e, 4]] == 0.0:
                            sliding = False
                    while True:  # a second time, not sliding, where a piece holds an event
                        if p0:
                            _mobility(rhs, ts, per, x, u, p, m0, i0, h0, toth, us, xsh, partner, carry)
                            if ne > 1 and not p1:
                                e1(6, ts, hh, x, xs, u, p, m0, i1, q1)
                            if ne > 2 and not p2:
                                e2(6, ts, hh, x, xs, u, p, m0, i2, q2)
                        if p1:
                            _mobility(rhs, ts, per, x, u, p, m1, i1, h1, toth, us, xsh, partner, carry)
                            if not p0:
                                e0(6, ts, hh, x, xs, u, p, m1, i0, q0)
                            if ne > 2 and not p2:
                                e2(6, ts, hh, x, xs, u, p, m1, i2, q2)
                        if p2:
                            _mobility(rhs, ts, per, x, u, p, m2, i2, h2, toth, us, xsh, partner, carry)
                            if not p0:
                                e0(6, ts, hh, x, xs, u, p, m2, i0, q0)
                            if not p1:
                                e1(6, ts, hh, x, xs, u, p, m2, i1, q1)
                        if sliding:
                            if p0:
                                _turn(m0, i0[4], start[i0[4]])
                            if p1:
                                _turn(m1, i1[4], start[i1[4]])
                            if p2:
                                _turn(m2, i2[4], start[i2[4]])
                        if ne > 0:
                            e0(0, ts, hh, x, xs, u, p, k, i0, q0)
                        if chained:  # a law behind another one at an input follows what that one lets through
                            for i in range(nt):
                                xs[i] = x[i]
                            for j in range(nu):
                                us[j] = u[j]
                            for j in range(n_p):
                                ps[j] = p[j]
                            e0(1, ts, hh, x, xs, us, ps, k, i0, q0)
                            e1(0, ts, hh, x, xs, us, p, k, i1, q1)
                            if ne > 2:
                                e1(1, ts, hh, x, xs, us, ps, k, i1, q1)
                                e2(0, ts, hh, x, xs, us, p, k, i2, q2)
                        else:
                            if ne > 1:
                                e1(0, ts, hh, x, xs, u, p, k, i1, q1)
                            if ne > 2:
                                e2(0, ts, hh, x, xs, u, p, k, i2, q2)
                        for i in range(nt):
                            before[i] = x[i]
                            total[i] = 0.0
                        for stage in range(stages):
                            ahead = 0.0 if stage == 0 else (hh if stage == stages - 1 else 0.5 * hh)
                            weight = 2.0 if 0 < stage < stages - 1 else 1.0
                            now = ts if discrete > 0 else ts + ahead
                            for i in range(nt):
                                w[i] = x[i] + ahead * k[i] if stage > 0 else x[i]
                                xs[i] = w[i]
                                k[i] = 0.0
                            for j in range(nu):
                                us[j] = u[j]
                            for j in range(n_p):
                                ps[j] = p[j]
                            if ne > 0:
                                e0(1, now, hh, w, xs, us, ps, k, i0, q0)
                            if ne > 1:
                                e1(1, now, hh, w, xs, us, ps, k, i1, q1)
                            if ne > 2:
                                e2(1, now, hh, w, xs, us, ps, k, i2, q2)
                            if discrete > 0:  # the simulator's own step, with what the laws do at its end
                                for i in range(nx):
                                    starth[i] = xs[i] - w[i] + x[i]
                                rhs(now, starth, us, ps, kh)
                                for i in range(nx):
                                    k[i] = (k[i] - starth[i]) / Ts
                                    start[i] = k[i]
                            else:
                                rhs(now, xsh, us, ps, kh)
                            if ne > 0:
                                e0(2, now, hh, w, xs, us, ps, k, i0, q0)
                            if ne > 1:
                                e1(2, now, hh, w, xs, us, ps, k, i1, q1)
                            if ne > 2:
                                e2(2, now, hh, w, xs, us, ps, k, i2, q2)
                            if discrete > 0:
                                for i in range(nx):  # its positions move with what the laws change of their speeds
                                    j = partner[i]
                                    if j >= 0:
                                        k[i] += 0.5 * Ts * carry[i] * (k[j] - start[j])
                            if sliding:
                                if p0:
                                    e0(5, now, hh, w, m0, us, ps, k, i0, q0)
                                if p1:
                                    e1(5, now, hh, w, m1, us, ps, k, i1, q1)
                                if p2:
                                    e2(5, now, hh, w, m2, us, ps, k, i2, q2)
                            for i in range(nt):
                                total[i] += weight * k[i]
                        if discrete > 0:
                            for i in range(nt):
                                x[i] += Ts / stages * total[i]
                        else:
                            for i in range(nt):
                                x[i] += hh / 6.0 * total[i]
                        if any_prox and not sliding:
                            for i in range(nt):
                                w[i] = x[i]
                            for e in range(ne):
                                if proximal[e] == 0:
                                    continue
                                for i in range(nt):
                                    k[i] = work[11 + e, i]
                                if e == 0:
                                    e0(4, ts, hh, x, before, us, ps, k, i0, q0)
                                elif e == 1:
                                    e1(4, ts, hh, x, before, us, ps, k, i1, q1)
                                else:
                                    e2(4, ts, hh, x, before, us, ps, k, i2, q2)
                            if discrete == 0:
                                for i in range(nx):  # the friction force acted during the whole substep
                                    j = partner[i]
                                    if j >= 0:
                                        at_rest = before[j] == 0.0 and x[j] == 0.0
                                        x[i] = before[i] if at_rest else x[i] + 0.5 * hh * carry[i] * (x[j] - w[j])
                        event = False
                        if any_prox and discrete == 0:
                            for e in range(ne):  # a reversal, a stop or a release inside this piece
                                if proximal[e] > 0:
                                    v0, v1 = start[II[e, 4]], x[II[e, 4]]
                                    event |= v0 * v1 <= 0.0 and (v0 != 0.0 or v1 != 0.0)
                        if not (event and pieces > 1 and sliding):
                            break
                        for i in range(nt):
                            x[i] = start[i]
                        sliding = False
                    piece += 1
                    if event and pieces == 1:
                        for i in range(nt):
                            x[i] = start[i]
                        pieces, piece = 8, 0
                for i in range(nt):
                    if not (abs(x[i]) <= limit):
                        alive = False
                if not alive:
                    failed += 1
                    for i in range(nt):
                        x[i] = 0.0
                    break
    return failed


@njit(
    i8(RHS_TYPE, OUT_TYPE, EFFECT_TYPE, EFFECT_TYPE, EFFECT_TYPE, i8, i8, f8[:, :, ::1], i8[:, ::1], f8[:, ::1],
       f8[:, ::1], f8, i8, f8, i8, f8[:, ::1], i8[:, ::1], f8[:, :, ::1], i8[::1], i8[::1], _V, i8[::1], _V,
       f8[:, ::1], f8[:, :, ::1], f8, f8[:, ::1]),
    cache=True, nogil=True, error_model="numpy",
)
def _variants(rhs, out, e0, e1, e2, ne, nx, X0, segments, U, delay, Ts, S, hold, discrete, p, II, Q,
              proximal, partner, carry, shown, gain, X, Y, limit, work):
    """`_loop` for every variant."""
    failed = 0
    for k in range(p.shape[0]):
        failed += _loop(rhs, out, e0, e1, e2, ne, nx, X0[k], segments, U, delay[k], Ts, S, hold, discrete, p[k], II,
                        Q[k], proximal, partner, carry, shown, gain, X, Y[k], limit, work)
    return failed
