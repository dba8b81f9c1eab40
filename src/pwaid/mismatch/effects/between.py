"""Friction, damping, springs and stops between two bodies: laws of how one moves against the other.

The constants after a law's parameters are the weights of `pwaid.mismatch.struts`: of two positions in the relative
one, of two speeds in its rate, and of the relative force in the forces on both bodies. Dry friction there is Dahl's,
whatever its slip: rest of one body against another is no zero of a state.
"""

from __future__ import annotations

from pwaid.mismatch.effects.base import Effect, Quantity, push, react
from pwaid.mismatch.effects.friction import dahl
from pwaid.mismatch.effects.position import BOUC_WEN, BOUC_WEN_AS_DAHL, penetration
from pwaid.mismatch.struts import struts

__all__ = ["EFFECTS"]


def viscous(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = coefficient * v, v the relative speed."""
    force = q[0] * (q[3] * x[ii[4]] + q[4] * x[ii[6]])
    push(phase, -q[5] * force, ii, u, p, dx)
    react(phase, -q[6] * force, ii, u, p, dx)


def asymmetric_viscous(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = coefficient_positive*v for v > 0, coefficient_negative*v for v < 0, v the relative speed."""
    v = q[4] * x[ii[4]] + q[5] * x[ii[6]]
    force = (q[0] if v > 0.0 else q[1]) * v
    push(phase, -q[6] * force, ii, u, p, dx)
    react(phase, -q[7] * force, ii, u, p, dx)


def drag(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = coefficient * v * |v|, v the relative speed."""
    v = q[3] * x[ii[4]] + q[4] * x[ii[6]]
    force = q[0] * v * abs(v)
    push(phase, -q[5] * force, ii, u, p, dx)
    react(phase, -q[6] * force, ii, u, p, dx)


def presliding(phase, t, h, x, xs, u, p, dx, ii, q):
    """Dahl: F = stiffness * z, dz/dt = v - stiffness*|v|*z/level, exact for the substep's first relative speed."""
    e = ii[0]
    if phase == 0:
        old = x[e]
        x[e] = dahl(old, q[4] * x[ii[4]] + q[5] * x[ii[6]], h, q[0], q[1])
        x[e + 1] = 0.5 * (old + x[e])
    elif phase <= 2:
        force = q[1] * x[e + 1]
        push(phase, -q[6] * force, ii, u, p, dx)
        react(phase, -q[7] * force, ii, u, p, dx)


def cubic_spring(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = coefficient * x^3, x the relative position."""
    s = q[1] * x[ii[5]] + q[2] * x[ii[9]]
    force = q[0] * s * s * s
    push(phase, -q[5] * force, ii, u, p, dx)
    react(phase, -q[6] * force, ii, u, p, dx)


def end_stop(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = stiffness * penetration (+ damping while pressed) of the relative position; variant 0 both sides, 1 upper,
    -1 lower."""
    depth = penetration(q[3] * x[ii[5]] + q[4] * x[ii[9]], q[1], ii[10])
    if depth != 0.0:
        force = q[0] * depth + q[2] * (q[5] * x[ii[4]] + q[6] * x[ii[6]])
        if force * depth > 0.0:  # a stop pushes and never pulls
            push(phase, -q[7] * force, ii, u, p, dx)
            react(phase, -q[8] * force, ii, u, p, dx)


def bouc_wen(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = force*z, dz/dt = (v - ((1 - shape)*|v|*sign(z) + shape*v)*|z|^order) / yield_displacement, v the relative
    speed."""
    z = x[ii[0]]
    push(phase, -q[8] * q[0] * z, ii, u, p, dx)
    react(phase, -q[9] * q[0] * z, ii, u, p, dx)
    if phase == 2:
        v = q[6] * x[ii[4]] + q[7] * x[ii[6]]
        against = abs(v) if z > 0.0 else -abs(v)
        dx[ii[0]] = (v - ((1.0 - q[3]) * against + q[3] * v) * abs(z) ** q[2]) / q[1]


_LINE = (-30.0, 30.0)
EFFECTS = (
    Effect("presliding_friction", "dry_friction",
           "F = stiffness*z between two bodies, dz/dt = v - stiffness*|v|*z/level",
           (Quantity("level", "force", 1e-3, 5.0, (0.04, 0.2)),
            Quantity("stiffness", "force/position", 0.1, 3e3, (3.0, 30.0))), presliding, struts,
           ("coulomb_friction", "hysteretic_spring"),
           "small reversals, a few percent of the stroke, around several points", extra_states=2,
           memory=True, dissipative=True, between=True),
    Effect("viscous_friction", "smooth_damping", "F = coefficient * v between two bodies",
           (Quantity("coefficient", "force/speed", 1e-4, 10.0, (0.04, 0.15, 0.5)),), viscous, struts,
           ("coulomb_friction", "quadratic_drag"), "two speeds, far apart", dissipative=True, between=True),
    Effect("asymmetric_viscous_friction", "smooth_damping",
           "F = coefficient_positive*v if v > 0 else coefficient_negative*v, between two bodies",
           (Quantity("coefficient_positive", "force/speed", 1e-4, 10.0, (0.02, 0.3)),
            Quantity("coefficient_negative", "force/speed", 1e-4, 10.0, (0.02, 0.3))), asymmetric_viscous, struts,
           ("constant_load", "asymmetric_coulomb_friction"),
           "the same trajectory in both directions, at two speeds", dissipative=True, between=True,
           contains=("viscous_friction",)),
    Effect("quadratic_drag", "smooth_damping", "F = coefficient * v * |v| between two bodies",
           (Quantity("coefficient", "force/speed^2", 1e-4, 1e3, (0.05, 0.2, 0.6)),), drag, struts,
           ("viscous_friction",), "a coast-down from high speed", dissipative=True, between=True),
    Effect("cubic_stiffness", "position", "F = coefficient * x^3 between two bodies",
           (Quantity("coefficient", "force/position^3", *_LINE, (0.1, 0.4, 1.0), log=False),), cubic_spring, struts,
           ("end_stop", "linear_stiffness"), "a larger amplitude", between=True),
    Effect("end_stop", "position", "F = stiffness*(|x| - position) beyond it, between two bodies",
           (Quantity("stiffness", "force/position", 0.3, 3e4, (30.0, 400.0)),
            Quantity("position", "position_level", 0.05, 1.1, (0.5, 0.7, 0.85, 0.95), log=False),
            Quantity("damping", "force/speed", 1e-4, 300.0, (0.3,))), end_stop,
           lambda s: struts(s, sides=True), ("cubic_stiffness", "sensor_saturation"), "reach and hold the stop",
           between=True),
    Effect("hysteretic_spring", "hysteresis",
           "F = force*z between two bodies, dz/dt = (v - ((1 - shape)*|v|*sign(z) + shape*v)*|z|^order)"
           "/yield_displacement",
           BOUC_WEN, bouc_wen, struts, ("presliding_friction", "viscous_friction"),
           "the same amplitude at two rates: the loop's area stays",
           extra_states=1, memory=True, dissipative=True, between=True, start="free",
           contains=("presliding_friction",), inherit=BOUC_WEN_AS_DAHL),
)
