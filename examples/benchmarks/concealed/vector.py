"""The effect vector `e` that the truth integrator reads: one slot per number, zero means "not there".

Structural switches (`SQUARE_ROOT`, `CORIOLIS`) are on where the plant's usual simulator has the term, so that
leaving the term out is a choice of the *nominal* simulator.
"""

from __future__ import annotations

import numpy as np

NAMES = (
    "level_positive", "level_negative", "static_extra", "stribeck_velocity", "dahl_stiffness", "dahl_level",
    "load_factor", "friction_side", "viscous_positive", "viscous_negative", "drag",
    "stiffness_1", "stiffness_2", "stiffness_3", "gravity", "gravity_phase",
    "ripple", "ripple_count", "ripple_phase", "stop_position", "stop_stiffness", "stop_damping",
    "bouc_stiffness", "bouc_yield", "bouc_order", "half_gap",
    "mode_stiffness", "mode_damping", "mode_inertia", "extra_inertia", "coriolis",
    "limit", "rate", "half_width", "play", "gain_asymmetry", "load", "lag", "delay_substeps",
    "sensor_channel", "sensor_limit", "rectified", "quantum", "offset", "sensor_lag", "sensor_cubic", "drift",
    "square_root", "head", "leak", "brim", "brim_share", "radiation", "second_capacity", "second_conductance",
    "tone", "tone_frequency", "tone_phase", "speed_limit_stall", "speed_limit_slope",
)

(
    LEVEL_POSITIVE, LEVEL_NEGATIVE, STATIC_EXTRA, STRIBECK_VELOCITY, DAHL_STIFFNESS, DAHL_LEVEL,
    LOAD_FACTOR, FRICTION_SIDE, VISCOUS_POSITIVE, VISCOUS_NEGATIVE, DRAG,
    STIFFNESS_1, STIFFNESS_2, STIFFNESS_3, GRAVITY, GRAVITY_PHASE,
    RIPPLE, RIPPLE_COUNT, RIPPLE_PHASE, STOP_POSITION, STOP_STIFFNESS, STOP_DAMPING,
    BOUC_STIFFNESS, BOUC_YIELD, BOUC_ORDER, HALF_GAP,
    MODE_STIFFNESS, MODE_DAMPING, MODE_INERTIA, EXTRA_INERTIA, CORIOLIS,
    LIMIT, RATE, HALF_WIDTH, PLAY, GAIN_ASYMMETRY, LOAD, LAG, DELAY_SUBSTEPS,
    SENSOR_CHANNEL, SENSOR_LIMIT, RECTIFIED, QUANTUM, OFFSET, SENSOR_LAG, SENSOR_CUBIC, DRIFT,
    SQUARE_ROOT, HEAD, LEAK, BRIM, BRIM_SHARE, RADIATION, SECOND_CAPACITY, SECOND_CONDUCTANCE,
    TONE, TONE_FREQUENCY, TONE_PHASE, SPEED_LIMIT_STALL, SPEED_LIMIT_SLOPE,
) = range(60)

INDEX = {name: i for i, name in enumerate(NAMES)}

# Hidden states behind the plant's own: Dahl bristle, Bouc-Wen, second mass (position, velocity), second
# store.
N_HIDDEN = 5
BRISTLE, BOUC, MODE_POSITION, MODE_VELOCITY, SECOND_STORE = range(N_HIDDEN)


def neutral(**switches):
    """An effect vector with nothing in it but the named switches, shape (60,)."""
    e = np.zeros(len(NAMES))
    for name, value in switches.items():
        e[INDEX[name]] = value
    return e


def with_values(e, values):
    """A copy of `e` with the named slots of the dict `values` set."""
    out = e.copy()
    for name, value in values.items():
        out[INDEX[name]] = value
    return out
