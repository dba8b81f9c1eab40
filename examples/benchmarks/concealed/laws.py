"""Force laws shared by the mechanical plants, exact at their discontinuities (numba)."""

from __future__ import annotations

import math

from concealed import vector as V
from concealed.jit import njit


@njit
def slip_friction(mode, v, e, transmitted):
    """Dry friction while sliding in direction `mode` (±1); none when `mode` is 2 (no dry friction)."""
    if mode == 2:
        return 0.0
    level = e[V.LEVEL_POSITIVE] if mode > 0 else e[V.LEVEL_NEGATIVE]
    if e[V.STRIBECK_VELOCITY] > 0.0:
        ratio = v / e[V.STRIBECK_VELOCITY]
        level += e[V.STATIC_EXTRA] * math.exp(-ratio * ratio)
    return mode * (level + e[V.LOAD_FACTOR] * abs(transmitted))


@njit
def static_level(direction, e, transmitted):
    """Largest force that standstill can carry against motion in `direction`."""
    level = e[V.LEVEL_POSITIVE] if direction > 0 else e[V.LEVEL_NEGATIVE]
    return level + e[V.STATIC_EXTRA] + e[V.LOAD_FACTOR] * abs(transmitted)


@njit
def smooth_force(q, v, hidden, n, e):
    """Sum of the memoryless and bristle forces of one axis, to be *added* to the force balance."""
    f = -e[V.DRAG] * v * abs(v)
    f -= (e[V.VISCOUS_POSITIVE] if v > 0.0 else e[V.VISCOUS_NEGATIVE]) * v
    f -= e[V.STIFFNESS_1] * q + e[V.STIFFNESS_2] * q * q + e[V.STIFFNESS_3] * q * q * q
    f -= e[V.GRAVITY] * math.sin(q + e[V.GRAVITY_PHASE])
    f -= e[V.RIPPLE] * math.sin(e[V.RIPPLE_COUNT] * q + e[V.RIPPLE_PHASE])
    if e[V.STOP_POSITION] > 0.0:
        depth = abs(q) - e[V.STOP_POSITION]
        if depth > 0.0:
            side = 1.0 if q > 0.0 else -1.0
            push = e[V.STOP_STIFFNESS] * depth + e[V.STOP_DAMPING] * v * side
            f -= side * max(push, 0.0)
    f -= e[V.DAHL_STIFFNESS] * hidden[n + V.BRISTLE]
    f -= e[V.BOUC_STIFFNESS] * hidden[n + V.BOUC]
    return f


@njit
def memory_rates(v, x, n, e, dx):
    """Rates of the Dahl bristle and of the Bouc-Wen variable."""
    if e[V.DAHL_STIFFNESS] > 0.0:
        z = x[n + V.BRISTLE]
        dx[n + V.BRISTLE] = v - abs(v) * z * e[V.DAHL_STIFFNESS] / e[V.DAHL_LEVEL]
    if e[V.BOUC_STIFFNESS] > 0.0:
        z = x[n + V.BOUC]
        r = abs(z / e[V.BOUC_YIELD]) ** e[V.BOUC_ORDER]
        turn = 1.0 if v * z > 0.0 else 0.0
        dx[n + V.BOUC] = v * (1.0 - r * turn)


@njit
def gap_force(stretch, rate, stiffness, damping, half_gap):
    """Torque through a shaft with play: zero in the gap, never pulling while in contact."""
    if half_gap <= 0.0:
        return stiffness * stretch + damping * rate
    if stretch > half_gap:
        return max(stiffness * (stretch - half_gap) + damping * rate, 0.0)
    if stretch < -half_gap:
        return min(stiffness * (stretch + half_gap) + damping * rate, 0.0)
    return 0.0
