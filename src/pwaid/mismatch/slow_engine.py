"""The same loop as `engine.simulate_segments` for a right-hand side that does not compile.

Every segment of every perturbed simulation is one column; all columns advance side by side, so that one call of
the user's function serves them all when it takes arrays in place of scalars (`Plant.takes_arrays`, verified against
single calls), and one call per column does otherwise. The effects' kernels are compiled and run column by column.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numba import boolean, njit, types
from numba import float64 as f8
from numba import int64 as i8

from pwaid.mismatch.engine import INSTANT, _input_at

__all__ = ["Variant", "simulate_columns"]

_V, _M = f8[::1], f8[:, ::1]


@dataclass(frozen=True)
class Variant:
    """One simulation of all segments: parameters p, the effects' Q (3, width), delays (nu,), starts (segments, nt)."""

    p: np.ndarray
    Q: np.ndarray
    delay: np.ndarray
    start: np.ndarray


@cache
def _by_columns(effect):
    """A compiled kernel run on the chosen columns; once each, because handing functions over costs 0.1 ms a call."""

    @njit(types.void(i8, _V, f8, _M, _M, _M, _M, _M, i8[::1], _M, boolean[::1]), nogil=True, error_model="numpy")
    def run(phase, t, h, X, XS, U, P, DX, ii, Q, chosen):
        for c in range(len(X)):
            if chosen[c]:
                effect(phase, t[c], h, X[c], XS[c], U[c], P[c], DX[c], ii, Q[c])

    return run


@njit(types.void(_M, i8[:, ::1], i8, i8, i8, _M, f8, f8, _M), cache=True, nogil=True, error_model="numpy")
def _inputs(U, segments, j, s, S, delay, Ts, hold, out):
    """The inputs every column sees in substep s of its sample j."""
    for c in range(len(out)):
        _input_at(U, segments[c, 2], segments[c, 3], segments[c, 0] + j, s, S, delay[c], out[c], Ts, hold)


class _Columns:
    """The live columns: states X (M, nt), parameters P (M, np), effects' parameters Q (ne, M, width)."""

    def __init__(self, model, P, Q):
        self.model, self.plant, self.nx, self.P, self.Q = model, model.settings.plant, model.nx, P, Q
        self.kernels = [_by_columns(model.kernels[e]) for e in range(len(model.located))]
        self.dry = [e for e in range(len(model.located)) if model.proximal[e]]
        self.shown, self.carried = model.settings.rates_shown, model.settings.carried

    def part(self, chosen) -> _Columns:
        return self if np.all(chosen) else _Columns(self.model, self.P[chosen], self.Q[:, chosen].copy())

    def effects(self, phase, t, h, X, XS, U, P, DX, chosen=None, only=None):
        chosen = np.ones(len(X), dtype=bool) if chosen is None else chosen
        for e in range(len(self.model.located)) if only is None else only:
            self.kernels[e](phase, t, h, X, XS, U, P, DX, self.model.II[e], self.Q[e], chosen)

    def remember(self, t, h, X, U):
        """Advance the laws' memories by h; a law behind another one at an input follows what that one lets through."""
        XS, DX = X.copy(), np.zeros_like(X)
        if not self.model.chained:
            self.effects(0, t, h, X, XS, U, self.P, DX)
            return
        US, PS = U.copy(), self.P.copy()
        for e in range(len(self.model.located)):
            self.effects(0, t, h, X, XS, US, self.P, DX, only=(e,))
            self.effects(1, t, h, X, XS, US, PS, DX, only=(e,))

    def rates(self, t, h, X, U, along, sliding, moved=0.0):
        """Derivatives, and the inputs and parameters that the laws let the plant see; the plant itself is `moved` less
        than the laws."""
        XS, US, PS, DX = X.copy(), U.copy(), self.P.copy(), np.zeros_like(X)
        self.effects(1, t, h, X, XS, US, PS, DX)
        DX[:, :self.nx] = self.plant.derivatives(t, (XS - moved)[:, :self.nx], US, PS)
        own = DX.copy() if self.carried else DX
        self.effects(2, t, h, X, XS, US, PS, DX)
        for i, j, share in self.carried:  # positions move with what the laws change of their speeds
            DX[:, i] += share * (DX[:, j] - own[:, j])
        for e in self.dry:
            self.effects(5, t, h, X, along[e], US, PS, DX, sliding, (e,))
        return DX, US, PS

    def outputs(self, t, h, Ts, X, U):
        XS, US, PS = X.copy(), U.copy(), self.P.copy()
        self.effects(1, t, 0.0, X, XS, US, PS, np.zeros_like(X))
        Y = self.plant.many_outputs(t, XS[:, :self.nx], US, PS)
        if self.shown and self.kernels:
            self._accelerate(t, h, X, XS, U, US, PS, Y)
        self.effects(3, t, Ts, X, XS, US, PS, Y)
        return Y

    def _accelerate(self, t, h, X, XS, U, US, PS, Y):
        """Add to outputs that show the rate of a state what the effects add to that rate (`engine._accelerations`)."""
        plain, rates, brief = self.plant.derivatives(t, X[:, :self.nx], US, PS), np.zeros_like(X), INSTANT * h
        rates[:, :self.nx] = self.plant.derivatives(t, XS[:, :self.nx], US, PS)
        self.effects(2, t, h, X, XS, US, PS, rates)
        W = X + brief * rates
        for e in self.dry:
            self.effects(4, t, brief, W, X, US, PS, self.mobility(t, X, U, self.model.II[e]), only=(e,))
        for k, v, gain in self.shown:
            Y[:, k] += gain * ((W[:, v] - X[:, v]) / brief - plain[:, v])

    def mobility(self, t, X, U, ii):
        """Acceleration per unit force at the place ii describes, (M, nt)."""
        found = np.zeros_like(X)
        if ii[1] != 1:
            push = U.copy()
            push[:, ii[2]] += 1.0 if ii[1] == 0 else -1.0
            x = X[:, :self.nx]
            found[:, :self.nx] = (self.plant.derivatives(t, x, push, self.P) - self.plant.derivatives(t, x, U, self.P))
        else:
            found[:, ii[2]] = 1.0 / self.P[:, ii[3]] if ii[3] >= 0 else 1.0
            for i, j, share in self.carried:
                found[:, i] += share * found[:, j] * (j == ii[2])
        others = [e for e in range(len(self.model.located)) if e not in self.dry]
        self.effects(6, t, 0.0, X, X, U, self.P, found, only=others)
        return found

    def substep(self, t, h, X, U, Ts, sliding):
        """Advance copies of X by h: memory, one Runge-Kutta step, dry friction inside it (sliding) or after it."""
        model, X = self.model, X.copy()
        mobility = {e: self.mobility(t, X, U, model.II[e]) for e in self.dry}
        along = {e: np.where(((M[:, model.II[e, 4]] > 0) != (X[:, model.II[e, 4]] > 0))[:, None], -M, M)
                 for e, M in mobility.items()}  # the motion that the substep begins with
        self.remember(t, h, X, U)
        before = X.copy()
        k1, US, PS = self.rates(t, h, X, U, along, sliding)
        if self.plant.dt:
            if self.model.settings.averaged and self.kernels:
                k2, US, PS = self.rates(t, h, X + Ts * k1, U, along, sliding, Ts * k1)
                k1 = 0.5 * (k1 + k2)
            X = X + Ts * k1
        else:
            k2, _, _ = self.rates(t + h / 2, h, X + h / 2 * k1, U, along, sliding)
            k3, _, _ = self.rates(t + h / 2, h, X + h / 2 * k2, U, along, sliding)
            k4, US, PS = self.rates(t + h, h, X + h * k3, U, along, sliding)
            X = X + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        if self.dry and not np.all(sliding):
            free = X.copy()
            for e in self.dry:
                self.effects(4, t, h, X, before, US, PS, mobility[e].copy(), ~sliding, (e,))
            for i in range(self.nx if not self.plant.dt else 0):  # the friction force acted during the whole substep
                j = model.settings.partner[i]
                if j >= 0:
                    rest = (before[:, j] == 0.0) & (X[:, j] == 0.0)
                    moved = np.where(rest, before[:, i],
                                     X[:, i] + 0.5 * h * model.settings.ratio[i] * (X[:, j] - free[:, j]))
                    X[:, i] = np.where(sliding, X[:, i], moved)
        return X

    def advance(self, t, h, X, U, Ts):
        """One substep; columns in which dry friction meets an event take it in eight pieces."""
        never = np.zeros(len(X), dtype=bool)
        if not self.dry or self.plant.dt:
            return self.substep(t, h, X, U, Ts, never)
        end = self.substep(t, h, X, U, Ts, self._sliding(X))
        met = self._event(X, end)
        if not met.any():
            return end
        some, x, u, clock = self.part(met), X[met].copy(), U[met].copy(), t[met].copy()
        for piece in range(8):
            sliding = some._sliding(x)
            new = some.substep(clock + piece * h / 8, h / 8, x, u, Ts, sliding)
            again = sliding & some._event(x, new)
            if again.any():
                few = some.part(again)
                new[again] = few.substep(clock[again] + piece * h / 8, h / 8, x[again].copy(), u[again].copy(), Ts,
                                         np.zeros(int(again.sum()), dtype=bool))
            x = new
        end[met] = x
        return end

    def _speeds(self, X):
        return X[:, [self.model.II[e, 4] for e in self.dry]]

    def _sliding(self, X):
        return np.all(self._speeds(X) != 0.0, axis=1)

    def _event(self, A, B):
        """A reversal, a stop or a release of something with dry friction."""
        a, b = self._speeds(A), self._speeds(B)
        return np.any((a * b <= 0.0) & ((a != 0.0) | (b != 0.0)), axis=1)


def simulate_columns(model, variants, segments, U, Ts: float, limit: float):
    """Every variant over every segment, side by side.

    Returns
    -------
    X (V, N, nt), Y (V, N, ny) : states and outputs at the samples; `limit` fills outputs of what ran away.
    """
    plant, G = model.settings.plant, len(segments)
    S, hold = 1 if plant.dt else model.substeps, float(model.settings.first_order_hold)
    X = np.zeros((len(variants), len(U), model.nx + model.extra))
    Y = np.zeros((len(variants), len(U), len(plant.output_names)))
    which, rows = np.repeat(np.arange(len(variants)), G), np.tile(segments, (len(variants), 1))
    ran = rows[:, 4] if rows.shape[1] > 4 else np.zeros(len(rows), dtype=np.int64)
    state = np.vstack([v.start for v in variants])
    P = np.repeat([v.p for v in variants], G, axis=0)
    Q = np.repeat(np.stack([v.Q for v in variants], axis=1), G, axis=1)
    delay = np.repeat([v.delay for v in variants], G, axis=0)
    alive = np.ones(len(state), dtype=bool)
    with np.errstate(all="ignore"):
        for j in range(int(np.max(rows[:, 1] - rows[:, 0]))):
            going = rows[:, 0] + j < rows[:, 1]
            lost = going & ~alive
            Y[which[lost], rows[lost, 0] + j] = limit
            live = np.flatnonzero(going & alive)
            if not live.size:
                continue
            columns = _Columns(model, P[live], np.ascontiguousarray(Q[:, live]))
            x, seg, d = state[live], rows[live], delay[live]
            t, u = (seg[:, 0] + j - seg[:, 2] + ran[live]) * Ts, np.empty((len(live), U.shape[1]))
            at = which[live], seg[:, 0] + j
            X[at] = x
            _inputs(U, seg, j, 0, S, d, Ts, 0.0, u)
            Y[at] = columns.outputs(t, Ts / S, Ts, x, u)
            for s in range(S):
                _inputs(U, seg, j, s, S, d, Ts, hold, u)
                x = columns.advance(t + s * Ts / S, Ts / S, x, u, Ts)
            alive[live] = np.all(np.abs(x) <= limit, axis=1)
            state[live] = np.where(alive[live][:, None], x, 0.0)
    return X, Y
