"""Lost motion and elasticity between motor and load, and inertial effects."""

from __future__ import annotations

from pwaid.mismatch.effects.base import Effect, Quantity
from pwaid.mismatch.shafts import shafts, single_masses, twists

__all__ = ["EFFECTS"]


def gap_in_shaft(phase, t, h, x, xs, u, p, dx, ii, q):
    """The shaft between positions ii[5] and ii[9] carries nothing while their difference is inside the gap.

    The plant sees the second position moved so that the twist is what lies beyond the gap. q: half gap, ratio of the
    first position to the second, rate of the second per its speed ii[6], rate of the first per its speed ii[4]; then
    the accelerations of the first and of the second speed per twist speed, which damping in the shaft gives them.
    """
    twist = x[ii[5]] / q[1] - x[ii[9]]
    if phase == 1:
        if abs(twist) <= q[0]:
            xs[ii[9]] = x[ii[5]] / q[1]
        elif twist > 0:
            xs[ii[9]] = x[ii[9]] + q[0]
        else:
            xs[ii[9]] = x[ii[9]] - q[0]
    elif phase == 2 and abs(twist) <= q[0]:
        rate = q[3] * x[ii[4]] / q[1] - q[2] * x[ii[6]]
        dx[ii[4]] -= q[4] * rate
        dx[ii[6]] -= q[5] * rate


def gap_in_twist(phase, t, h, x, xs, u, p, dx, ii, q):
    """A shaft whose twist is a state, ii[5], carries nothing while that is inside the gap.

    The plant sees the twist beyond the gap. q: half gap, weights of the speeds ii[4] and ii[6] in the rate of the
    twist; then the accelerations of the two speeds per twist speed, which damping in the shaft gives them.
    """
    z = ii[5]
    if phase == 1:
        twist = x[z]
        if abs(twist) <= q[0]:
            xs[z] = 0.0
        elif twist > 0:
            xs[z] = twist - q[0]
        else:
            xs[z] = twist + q[0]
    elif phase == 2 and abs(x[z]) <= q[0]:
        rate = q[1] * x[ii[4]] + q[2] * x[ii[6]]
        dx[ii[4]] -= q[3] * rate
        dx[ii[6]] -= q[4] * rate


def gap_to_hidden_load(phase, t, h, x, xs, u, p, dx, ii, q):
    """A share of the inertia hangs on the shaft through a gap and a contact spring.

    Extra states: twist (load behind motor) and its rate. q: half_gap, load_share, contact frequency
    (rad/s of the contact spring on the load), damping ratio, the output per unit of its state; variant 1: the load
    side is measured.
    """
    e = ii[0]
    twist, rate = x[e], x[e + 1]
    share, w, zeta = q[1], q[2], q[3]
    depth = 0.0
    if twist > q[0]:
        depth = twist - q[0]
    elif twist < -q[0]:
        depth = twist + q[0]
    pull = 0.0
    if depth != 0.0:
        pull = w * w * depth + 2.0 * zeta * w * rate
        if pull * depth < 0.0:
            pull = 0.0
    if phase == 2:
        i = ii[4]
        a = (dx[i] - share * pull) / (1.0 - share)
        dx[i] = a
        dx[e] = rate
        dx[e + 1] = a - pull
    elif phase == 6:
        dx[ii[4]] /= 1.0 - share
        dx[e + 1] += dx[ii[4]]
    elif phase == 3 and ii[10] == 1:
        dx[ii[7]] -= q[4] * (rate if ii[11] == 1 else twist)


def hidden_mode(phase, t, h, x, xs, u, p, dx, ii, q):
    """A share of the inertia hangs on a spring: q = load_share, frequency (rad/s), damping ratio, the output per unit
    of its state; variant 1: the load side is measured."""
    e = ii[0]
    twist, rate = x[e], x[e + 1]
    pull = q[1] * q[1] * twist + 2.0 * q[2] * q[1] * rate
    if phase == 2:
        i = ii[4]
        a = (dx[i] - q[0] * pull) / (1.0 - q[0])
        dx[i] = a
        dx[e] = rate
        dx[e + 1] = a - pull
    elif phase == 6:
        dx[ii[4]] /= 1.0 - q[0]
        dx[e + 1] += dx[ii[4]]
    elif phase == 3 and ii[10] == 1:
        dx[ii[7]] -= q[3] * (rate if ii[11] == 1 else twist)


def inertia(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = added_inertia * acceleration; q[1] is 1/nominal inertia when no parameter holds it."""
    if phase == 2 or phase == 6:
        g = 1.0 / p[ii[3]] if ii[3] >= 0 else q[1]
        dx[ii[4]] /= 1.0 + q[0] * g


EFFECTS = (
    Effect("backlash", "transmission", "shaft torque = k * (twist beyond +-half_gap)",
           (Quantity("half_gap", "position", 1e-4, 0.9, (0.01, 0.05, 0.2)),), gap_in_shaft,
           shafts, ("actuator_deadzone", "input_play", "coulomb_friction"),
           "reverse the load at rest with both encoders; a constant preload makes it vanish", memory=True),
    Effect("backlash", "transmission", "shaft torque = k * (twist, a state, beyond +-half_gap)",
           (Quantity("half_gap", "position", 1e-3, 10.0, (0.05, 0.2, 1.0)),), gap_in_twist,
           twists, ("actuator_deadzone", "input_play", "coulomb_friction"),
           "reverse the load at rest with both encoders; a constant preload makes it vanish", memory=True),
    Effect("backlash", "transmission", "the load hangs on the motor through a gap of +-half_gap",
           (Quantity("half_gap", "position", 1e-4, 3.0, (0.02, 0.1)),
            Quantity("load_share", "1", 0.05, 0.95, (0.5,)),
            Quantity("contact_frequency", "rate", 0.5, 40.0, (8.0,)),
            Quantity("damping_ratio", "1", 0.01, 2.0, (0.3,))),
           gap_to_hidden_load, single_masses, ("compliance", "input_play"),
           "reverse slowly at rest; a constant preload makes it vanish", extra_states=2, memory=True,
           contains=("compliance",), reshapes=True),
    Effect("compliance", "transmission", "the load hangs on a spring of the given natural frequency",
           (Quantity("load_share", "1", 0.02, 0.95, (0.3,)),
            Quantity("frequency", "rate", 0.3, 30.0, (1.0, 2.5, 6.0)),
            Quantity("damping_ratio", "1", 1e-3, 1.0, (0.05,))), hidden_mode, single_masses,
           ("input_delay", "actuator_lag", "sensor_lag"), "broadband excitation above the mode",
           extra_states=2, reshapes=True),
    Effect("missing_inertia", "inertial", "F = inertia * dv/dt",
           (Quantity("inertia", "inertia", -0.8, 10.0, (0.1, 0.4, 1.0), log=False),), inertia,
           lambda s: s.inertias(), ("linear_stiffness", "actuator_gain_asymmetry"),
           "change the load by a known amount", reshapes=True),
)
