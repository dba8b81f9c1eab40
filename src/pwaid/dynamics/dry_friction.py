"""Drives with contacts and dry friction, with a true standstill: J ω̇ = torque − F(ω), and ω = 0 while
|torque| ≤ F_s.

The drive is affine in each contact, ẋ = A_c x + a_c + B u while G_c x + g_c ≥ 0, apart from the dry
friction on some of its velocities, F(ω) = sign(ω) [F_c + (F_s − F_c) exp(−|ω/v_s|^δ)] with δ = 1 or 2. A
velocity slips one way, slips the other way, or stands still; standing still ends when the torque on it
exceeds F_s, and every change is located. Within one such mode the motion is a Taylor series of degree 16
whose coefficients, those of the exponential included, come from recurrences. The step is halved until the
series has converged to rounding; contacts, standstills and releases are polynomials of time whose first
crossing `pwaid.dynamics.events` finds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from pwaid.dynamics.events import DEGREE, NO_CROSSING, TOLERANCE, clear_start, entry_sign, first_crossing
from pwaid.dynamics.flow import natural_step
from pwaid.errors import InputError, SolverError

__all__ = ["Drive", "DryFriction", "advance", "check_events", "drive_tables"]

CONVERGED = 1e-16  # last terms of the series, relative to all
MOST_EVENTS = 1000  # within one call of `advance`


@dataclass(frozen=True)
class DryFriction:
    """Dry friction torque sign(ω) [coulomb + (static − coulomb) exp(−|ω/velocity|^exponent)], independent
    of position.

    Attributes
    ----------
    coulomb : float
        Level at speed, N m (or the unit of the drive's torque).
    static : float, optional
        Level at standstill, not below `coulomb`; equal to it when not given (no Stribeck effect).
    velocity : float
        Stribeck velocity, rad/s.
    exponent : int
        1 or 2.
    """

    coulomb: float = 0.0
    static: float | None = None
    velocity: float = 1.0
    exponent: int = 2

    def __post_init__(self):
        static = self.coulomb if self.static is None else self.static
        if not (np.isfinite(self.coulomb) and np.isfinite(static) and 0 <= self.coulomb <= static):
            raise InputError(f"friction levels coulomb = {self.coulomb}, static = {static}; expected 0 <= "
                             "coulomb <= static")
        if not (np.isfinite(self.velocity) and self.velocity > 0) or self.exponent not in (1, 2):
            raise InputError(
                f"Stribeck velocity {self.velocity} and exponent {self.exponent}; "
                "expected a positive velocity and 1 or 2"
            )
        object.__setattr__(self, "static", float(static))

    def torque(self, omega) -> np.ndarray:
        """Friction torque at speed `omega` (zero at rest, where it takes what is needed up to `static`)."""
        omega = np.asarray(omega, dtype=float)
        rise = (self.static - self.coulomb) * np.exp(-(np.abs(omega / self.velocity) ** self.exponent))
        return np.sign(omega) * (self.coulomb + rise)


class Drive(NamedTuple):
    """A drive as the compiled loop wants it: c contacts, n states, p inputs, f velocities with dry
    friction.
    """

    A: np.ndarray  # (c, n, n)
    a: np.ndarray  # (c, n)
    B: np.ndarray  # (n, p)
    G: np.ndarray  # (c, R, n)
    g: np.ndarray  # (c, R)
    following: np.ndarray  # (c, R) contact after a guard has ended
    rows: np.ndarray  # (c,)
    step: np.ndarray  # (c,) seconds
    velocity_state: np.ndarray  # (f,) index of the state
    inertia: np.ndarray  # (f,)
    friction: np.ndarray  # (f, 4) coulomb, static, velocity, exponent


def drive_tables(A, a, B, guards, velocity_states=(), inertias=(), frictions=(), step_scale=1.0) -> Drive:
    """Tables of a drive.

    Parameters
    ----------
    A, a : sequences of array_like (n, n), (n,)
        One per contact.
    B : array_like (n, p)
    guards : sequence of sequences of (row, constant, following)
        For each contact: row·x + constant ≥ 0 holds in it; when it ends, contact number `following` comes.
    velocity_states, inertias, frictions : sequences
        Which states are velocities with dry friction, their inertias, and a `DryFriction` each; a friction
        with static level zero is left out.
    step_scale : float
        Multiplies the internal step, for refinement studies.
    """
    A, a, B = (np.ascontiguousarray(v, dtype=float) for v in (A, a, B))
    c, n = a.shape
    most = max(1, max(len(rows) for rows in guards))
    G, g, following = np.zeros((c, most, n)), np.zeros((c, most)), np.zeros((c, most), dtype=np.int64)
    for i, rows in enumerate(guards):
        for r, (row, constant, after) in enumerate(rows):
            G[i, r], g[i, r], following[i, r] = row, constant, after
    used = [k for k, f in enumerate(frictions) if f.static > 0]
    step = np.minimum([natural_step(Ai, step_scale) for Ai in A], step_scale)
    levels = [[f.coulomb, f.static, f.velocity, f.exponent] for f in (frictions[k] for k in used)]
    return Drive(
        A, a, B, G, g, following, np.array([len(rows) for rows in guards]), step,
        np.array([velocity_states[k] for k in used], dtype=np.int64),
        np.array([inertias[k] for k in used], dtype=float), np.array(levels, dtype=float).reshape(-1, 4),
    )  # fmt: skip


def check_events(lowest: int) -> None:
    """Raise when a run saw `advance` give up: `lowest` is the smallest number that it returned."""
    if lowest < 0:
        raise SolverError(
            f"more than {MOST_EVENTS} changes of contact or standstill in one sampling interval: they "
            "accumulate; check stiffness, inertia and friction for values that make no physical sense, or "
            "sample faster"
        )


@njit(cache=True)
def _series(drive, mode, x, u, h, X):
    """Fill X (DEGREE + 1, n): x(t + s h') = Σ X_k s^k in `mode` = (contact, slip directions…); return h' ≤
    h.
    """
    n, contact, number = x.size, mode[0], drive.inertia.size
    E, w = np.zeros((number, DEGREE + 1)), np.zeros((number, DEGREE + 1))
    X[0] = x
    for f in range(number):
        if mode[1 + f] == 0:
            X[0, drive.velocity_state[f]] = 0.0
    for k in range(DEGREE):
        for i in range(n):
            rate = 0.0
            for j in range(n):
                rate += drive.A[contact, i, j] * X[k, j]
            if k == 0:
                rate += drive.a[contact, i]
                for j in range(u.size):
                    rate += drive.B[i, j] * u[j]
            X[k + 1, i] = rate * (h / (k + 1))
        for f in range(number):
            i, sign = drive.velocity_state[f], mode[1 + f]
            if sign == 0:
                X[k + 1, i] = 0.0
                continue
            coulomb, static, scale = drive.friction[f, 0], drive.friction[f, 1], sign * drive.friction[f, 2]
            torque = coulomb if k == 0 else 0.0
            if static > coulomb:
                if drive.friction[f, 3] == 1.0:
                    w[f, k] = X[k, i] / scale
                else:
                    for j in range(k + 1):
                        w[f, k] += X[j, i] * X[k - j, i] / (scale * scale)
                if k == 0:
                    E[f, 0] = np.exp(-w[f, 0])
                else:
                    for j in range(1, k + 1):
                        E[f, k] -= j * w[f, j] * E[f, k - j] / k
                torque += (static - coulomb) * E[f, k]
            X[k + 1, i] -= sign * torque / drive.inertia[f] * (h / (k + 1))
    return _shorten(X, h)


@njit(cache=True)
def _shorten(X, h):
    """Halve the step, rescaling the series, until its last terms are below rounding."""
    n = X.shape[1]
    for _ in range(60):
        good = True
        for i in range(n):
            size = 0.0
            for k in range(DEGREE + 1):
                size += abs(X[k, i])
            if abs(X[DEGREE, i]) + abs(X[DEGREE - 1, i]) > CONVERGED * size:
                good = False
        if good:
            break
        power = 1.0
        for k in range(DEGREE + 1):
            for i in range(n):
                X[k, i] *= power
            power *= 0.5
        h *= 0.5
    return h


@njit(cache=True)
def _contact_guard(drive, contact, row, X, c):
    size = abs(drive.g[contact, row])
    for k in range(DEGREE + 1):
        c[k] = 0.0
        for j in range(X.shape[1]):
            term = drive.G[contact, row, j] * X[k, j]
            c[k] += term
            size += abs(term)
    c[0] += drive.g[contact, row]
    return TOLERANCE * size


@njit(cache=True)
def _slip_guard(drive, contact, f, sign, X, h, c):
    """Polynomial of the slip speed; its zero allows for the rounding of the torque that starts the slip."""
    i = drive.velocity_state[f]
    size = 10 * h * drive.friction[f, 1] / drive.inertia[f]
    for j in range(X.shape[1]):
        size += 10 * h * abs(drive.A[contact, i, j] * X[0, j])
    for k in range(DEGREE + 1):
        c[k] = sign * X[k, i]
        size += abs(c[k])
    return TOLERANCE * size


@njit(cache=True)
def _torque(drive, contact, f, X, u, c):
    """Polynomial of the torque on velocity f without its dry friction, and the size of the terms in it."""
    i = drive.velocity_state[f]
    size = 0.0
    for k in range(DEGREE + 1):
        c[k] = 0.0
        for j in range(X.shape[1]):
            term = drive.inertia[f] * drive.A[contact, i, j] * X[k, j]
            c[k] += term
            size += abs(term)
    c[0] += drive.inertia[f] * drive.a[contact, i]
    for j in range(u.size):
        c[0] += drive.inertia[f] * drive.B[i, j] * u[j]
    return size + abs(drive.inertia[f] * drive.a[contact, i])


@njit(cache=True)
def _settle_friction(drive, mode, x, u, f, h, X, c) -> bool:
    """Decide what velocity f, now zero, does next; whether that is a change."""
    before, static = mode[1 + f], drive.friction[f, 1]
    _series(drive, mode, x, u, h, X)
    size = _torque(drive, mode[0], f, X, u, c)
    torque = c[0]
    doubt = 10 * TOLERANCE * (size + static)
    if abs(torque) < static - doubt:
        mode[1 + f] = 0
    else:
        mode[1 + f] = 1 if torque > 0 else -1
        if abs(torque) <= static + doubt:  # on the limit: rests unless it is about to be exceeded
            used = _series(drive, mode, x, u, h, X)
            tol = _slip_guard(drive, mode[0], f, mode[1 + f], X, used, c)
            if entry_sign(c, tol) <= 0:
                mode[1 + f] = 0
    return mode[1 + f] != before


@njit(cache=True)
def settle(drive, mode, x, u):
    """Make `mode` the one in which the motion goes on from x under u: by the flow just after."""
    X, c = np.empty((DEGREE + 1, x.size)), np.empty(DEGREE + 1)
    for _ in range(20):
        changed = False
        contact = mode[0]
        h = drive.step[contact]
        for f in range(drive.inertia.size):
            if mode[1 + f] == 0 or x[drive.velocity_state[f]] * mode[1 + f] <= 0.0:
                if mode[1 + f] != 0:
                    x[drive.velocity_state[f]] = 0.0  # has just come to rest, to rounding
                v = x[drive.velocity_state[f]]
                if v != 0.0:  # the caller's initial state
                    wanted = 1 if v > 0 else -1
                    changed = changed or wanted != mode[1 + f]
                    mode[1 + f] = wanted
                else:
                    changed = _settle_friction(drive, mode, x, u, f, h, X, c) or changed
        if drive.rows[contact] > 0:
            _series(drive, mode, x, u, h, X)
        for row in range(drive.rows[contact]):
            tol = _contact_guard(drive, contact, row, X, c)
            if entry_sign(c, tol) < 0:
                mode[0] = drive.following[contact, row]
                changed = True
                break
        if not changed:
            return


@njit(cache=True)
def _next_event(drive, mode, X, u, h):
    """Share of h at which `mode` ends (or NO_CROSSING) and the velocity that comes to rest there (or -1)."""
    c = np.empty(DEGREE + 1)
    first, rest = NO_CROSSING, -1
    for f in range(drive.inertia.size):
        if mode[1 + f] != 0:
            tol = _slip_guard(drive, mode[0], f, mode[1 + f], X, h, c)
            clear_start(c, tol)
            s = first_crossing(c, tol)
            if s < first:
                first, rest = s, f
            continue
        size = _torque(drive, mode[0], f, X, u, c)
        tol = 10 * TOLERANCE * (size + drive.friction[f, 1])
        for side in (1.0, -1.0):
            left = -side * c
            left[0] += drive.friction[f, 1]
            clear_start(left, tol)
            s = first_crossing(left, tol)
            if s < first:
                first, rest = s, -1
    for row in range(drive.rows[mode[0]]):
        tol = _contact_guard(drive, mode[0], row, X, c)
        clear_start(c, tol)
        s = first_crossing(c, tol)
        if s < first:
            first, rest = s, -1
    return first, rest


@njit(cache=True)
def advance(drive, mode, x, u, dt):
    """Move x and mode (contact, slip direction of each velocity) on by dt with u held; the number of events
    on the way.

    A negative number means that events accumulated (more than `MOST_EVENTS` in dt): x is then short of dt.
    """
    X = np.empty((DEGREE + 1, x.size))
    now, events = 0.0, 0
    settle(drive, mode, x, u)
    while now < dt:
        h = min(drive.step[mode[0]], dt - now)
        used = _series(drive, mode, x, u, h, X)
        s, rest = _next_event(drive, mode, X, u, used)
        share = min(s, 1.0)
        x[:] = X[DEGREE]
        for k in range(DEGREE - 1, -1, -1):
            for i in range(x.size):
                x[i] = x[i] * share + X[k, i]
        for f in range(drive.inertia.size):
            if mode[1 + f] == 0:
                x[drive.velocity_state[f]] = 0.0
        if s <= 1.0:
            if rest >= 0:
                x[drive.velocity_state[rest]] = 0.0
            settle(drive, mode, x, u)
            events += 1
            if events > MOST_EVENTS:
                return -events
        now = dt if (s > 1.0 and used == dt - now) else now + share * used
    return events
