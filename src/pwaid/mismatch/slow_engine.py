"""The same loop as `engine.simulate_segments` for a right-hand side that does not compile.

All segments run side by side; the plant is called once per stage with one column per segment when it
accepts arrays (checked by the caller), else once per segment.
"""

from __future__ import annotations

import numpy as np

__all__ = ["simulate_segments_slowly"]


def _held(U, begin, end, k, s, S, delay, Ts, hold):
    u = U[k].copy()
    for j in range(u.size):
        if delay[j] == 0.0 and hold == 0.0:
            continue
        m = k + (s + 0.5) / S - delay[j] / Ts
        i = int(np.floor(m))
        lo, hi = np.clip([i, i + 1], begin, end - 1)
        u[j] = U[lo, j] if hold == 0.0 else (1 - (m - i)) * U[lo, j] + (m - i) * U[hi, j]
    return u


class _Stage:
    """The augmented right-hand side around a plain Python plant."""

    def __init__(self, plant, kernels, ne, nx, II, Q):
        self.plant, self.kernels, self.ne, self.nx, self.II, self.Q = plant, kernels, ne, nx, II, Q
        self.sliding: dict = {}

    def effects(self, phase, t, h, x, xs, u, p, dx):
        for e in range(self.ne):
            self.kernels[e](phase, t, h, x, xs, u, p, dx, self.II[e], self.Q[e])

    def __call__(self, t, h, x, u, p):
        xs, us, ps, dx = x.copy(), u.copy(), p.copy(), np.zeros(x.size)
        self.effects(1, t, h, x, xs, us, ps, dx)
        dx[:self.nx] = self.plant.derivative(xs[:self.nx], us, ps, t)
        self.effects(2, t, h, x, xs, us, ps, dx)
        for e, column in self.sliding.items():
            self.kernels[e](5, t, h, x, column, us, ps, dx, self.II[e], self.Q[e])
        return dx

    def mobility(self, t, x, u, p, ii):
        col = np.zeros(x.size)
        if ii[1] == 0:
            push = u.copy()
            push[ii[2]] += 1.0
            col[:self.nx] = (self.plant.derivative(x[:self.nx], push, p, t)
                             - self.plant.derivative(x[:self.nx], u, p, t))
        else:
            col[ii[2]] = 1.0 / p[ii[3]] if ii[3] >= 0 else 1.0
        return col


def simulate_segments_slowly(plant, out, e0, e1, e2, ne, nx, X0, segments, U, delay, Ts, S, hold, discrete,
                             p, II, Q,
                             proximal, partner, ratio, X, Y, limit):
    """Same arguments and results as the compiled loop, with the plant in place of its compiled functions."""
    stage = _Stage(plant, (e0, e1, e2), ne, nx, II, Q)
    h, failed = Ts / S, 0
    for g, (first, last, begin, end) in enumerate(segments):
        x, alive = X0[g].copy(), True
        for k in range(first, last):
            t = (k - begin) * Ts
            X[k] = x
            xs, us, ps = x.copy(), _held(U, begin, end, k, 0, S, delay, Ts, 0.0), p.copy()
            stage.effects(1, t, 0.0, x, xs, us, ps, np.zeros(x.size))
            y = plant.outputs(x[:nx], us, ps, t)
            stage.effects(3, t, Ts, x, xs, us, ps, y)
            Y[k] = y if alive else limit
            if not alive:
                continue
            for s in range(S):
                u = _held(U, begin, end, k, s, S, delay, Ts, hold)
                x = _advance(stage, t + s * h, h, x, u, p, discrete, Ts, proximal, partner, ratio)
                if not np.all(np.abs(x) <= limit):
                    alive, x, failed = False, np.zeros_like(x), failed + 1
                    break
    return failed


def _advance(stage, t, h, x, u, p, discrete, Ts, proximal, partner, ratio):
    """One substep; with dry friction an event inside it is found and stepped over in eight pieces."""
    dry = [stage.II[e, 4] for e in range(stage.ne) if proximal[e]]
    rest = (p, discrete, Ts, proximal, partner, ratio)
    if not dry or discrete:
        return _substep(stage, t, h, x.copy(), u, *rest, False)

    def event(a, b):
        return any(a[i] * b[i] <= 0.0 and (a[i] != 0.0 or b[i] != 0.0) for i in dry)

    end = _substep(stage, t, h, x.copy(), u, *rest, all(x[i] != 0.0 for i in dry))
    if not event(x, end):
        return end
    for piece in range(8):
        sliding = all(x[i] != 0.0 for i in dry)
        end = _substep(stage, t + piece * h / 8, h / 8, x.copy(), u, *rest, sliding)
        if sliding and event(x, end):
            end = _substep(stage, t + piece * h / 8, h / 8, x.copy(), u, *rest, False)
        x = end
    return x


def _substep(stage, t, h, x, u, p, discrete, Ts, proximal, partner, ratio, sliding):
    nx = stage.nx
    dry = [e for e in range(stage.ne) if proximal[e]]
    columns = {e: stage.mobility(t, x, u, p, stage.II[e]) for e in dry}
    stage.effects(0, t, h, x, x.copy(), u, p, np.zeros(x.size))
    before = x.copy()
    stage.sliding = columns if sliding else {}
    k1 = stage(t, h, x, u, p)
    if discrete:
        x = np.concatenate([k1[:nx], x[nx:] + Ts * k1[nx:]])
    else:
        k2 = stage(t + h / 2, h, x + h / 2 * k1, u, p)
        k3 = stage(t + h / 2, h, x + h / 2 * k2, u, p)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + stage(t + h, h, x + h * k3, u, p))
    if dry and not sliding:
        free = x.copy()
        for e in dry:
            stage.kernels[e](4, t, h, x, before, u, p, columns[e].copy(), stage.II[e], stage.Q[e])
        for i in range(nx):
            if partner[i] >= 0 and not discrete:
                j = partner[i]
                x[i] = before[i] if before[j] == 0.0 and x[j] == 0.0 else x[i] + 0.5 * h * ratio[i] * (x[j] - free[j])
    return x
