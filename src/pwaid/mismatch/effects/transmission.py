"""Lost motion and elasticity between motor and load, and inertial effects."""

from __future__ import annotations

from pwaid.mismatch.effects.base import Effect, Quantity

__all__ = ["EFFECTS"]


def gap_in_shaft(phase, t, h, x, xs, u, p, dx, ii, q):
    """The shaft between positions ii[5] and ii[9] carries nothing while their difference is inside the gap.

    The plant sees the second position moved so that the twist is what lies beyond the gap; the twist
    speed is zero inside it. q[1] is the ratio of the first position to the second.
    """
    if phase == 1:
        twist = x[ii[5]] / q[1] - x[ii[9]]
        if abs(twist) <= q[0]:
            xs[ii[9]] = x[ii[5]] / q[1]
            xs[ii[6]] = x[ii[4]] / q[1]
        elif twist > 0:
            xs[ii[9]] = x[ii[9]] + q[0]
        else:
            xs[ii[9]] = x[ii[9]] - q[0]
    elif phase == 2:
        # kinematic rows keep the true speeds
        dx[ii[9]] = x[ii[6]] * q[2]


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
    elif phase == 3 and ii[10] == 1:
        dx[ii[7]] -= q[3] * (rate if ii[11] == 1 else twist)


def inertia(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = added_inertia * acceleration; q[1] is 1/nominal inertia when no parameter holds it."""
    if phase == 2:
        g = 1.0 / p[ii[3]] if ii[3] >= 0 else q[1]
        dx[ii[4]] /= 1.0 + q[0] * g


EFFECTS = (
    Effect("backlash", "transmission", "shaft torque = k * (twist beyond +-half_gap)",
           (Quantity("half_gap", "position", 1e-4, 0.9, (0.01, 0.05, 0.2)),), gap_in_shaft,
           lambda s: s.shafts(), ("actuator_deadzone", "input_play", "coulomb_friction"),
           "reverse the load at rest with both encoders; a constant preload makes it vanish", memory=True),
    Effect("backlash", "transmission", "the load hangs on the motor through a gap of +-half_gap",
           (Quantity("half_gap", "position", 1e-4, 3.0, (0.02, 0.1)),
            Quantity("load_share", "1", 0.05, 0.95, (0.5,)),
            Quantity("contact_frequency", "rate", 0.5, 40.0, (8.0,)),
            Quantity("damping_ratio", "1", 0.01, 2.0, (0.3,))),
           gap_to_hidden_load, lambda s: s.single_masses(), ("compliance", "input_play"),
           "reverse slowly at rest; a constant preload makes it vanish", extra_states=2, memory=True,
           contains=("compliance",)),
    Effect("compliance", "transmission", "the load hangs on a spring of the given natural frequency",
           (Quantity("load_share", "1", 0.02, 0.95, (0.3,)),
            Quantity("frequency", "rate", 0.3, 30.0, (1.0, 2.5, 6.0)),
            Quantity("damping_ratio", "1", 1e-3, 1.0, (0.05,))), hidden_mode, lambda s: s.single_masses(),
           ("input_delay", "actuator_lag", "sensor_lag"), "broadband excitation above the mode",
           extra_states=2),
    Effect("missing_inertia", "inertial", "F = inertia * dv/dt",
           (Quantity("inertia", "inertia", -0.8, 10.0, (0.1, 0.4, 1.0), log=False),), inertia,
           lambda s: s.inertias(), ("linear_stiffness", "actuator_gain_asymmetry"),
           "change the load by a known amount"),
)
