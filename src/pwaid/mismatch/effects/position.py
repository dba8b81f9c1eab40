"""Forces that depend on position, and the hysteretic spring."""

from __future__ import annotations

from math import cos, sin

from numba import njit

from pwaid.mismatch.effects.base import Effect, Quantity, push

__all__ = ["BOUC_WEN", "EFFECTS", "penetration"]


def linear_spring(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = stiffness * x."""
    push(phase, -q[0] * x[ii[5]], ii, u, p, dx)


def cubic_spring(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = coefficient * x^3."""
    s = x[ii[5]]
    push(phase, -q[0] * s * s * s, ii, u, p, dx)


def quadratic_spring(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = coefficient * x^2."""
    s = x[ii[5]]
    push(phase, -q[0] * s * s, ii, u, p, dx)


def gravity(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = torque * sin(x + phase), with x in radians times the constant q[2]."""
    push(phase, -q[0] * sin(q[2] * x[ii[5]] + q[1]), ii, u, p, dx)


def ripple(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = level * sin(wavenumber * x + phase)."""
    push(phase, -q[0] * sin(q[1] * x[ii[5]] + q[2]), ii, u, p, dx)


@njit(cache=True, nogil=True, error_model="numpy")
def penetration(s, edge, side):
    """How far s is beyond a stop, with its sign; side 0 both, at edge and -edge, 1 upper, -1 lower."""
    if side >= 0 and s > edge:
        return s - edge
    if side == 0 and s < -edge:
        return s + edge
    if side < 0 and s < edge:
        return s - edge
    return 0.0


def end_stop(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = stiffness * penetration (+ damping while pressed); variant 0 both sides, 1 upper, -1 lower."""
    depth = penetration(x[ii[5]], q[1], ii[10])
    if depth != 0.0:
        force = q[0] * depth + q[2] * x[ii[4]]
        if force * depth > 0.0:  # a stop pushes and never pulls
            push(phase, -force, ii, u, p, dx)


def bouc_wen(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = force*z, dz/dt = (v - ((1 - shape)*|v|*sign(z) + shape*v)*|z|^order) / yield_displacement."""
    z = x[ii[0]]
    push(phase, -q[0] * z, ii, u, p, dx)
    if phase == 2:
        v = x[ii[4]]
        against = abs(v) if z > 0.0 else -abs(v)
        dx[ii[0]] = (v - ((1.0 - q[3]) * against + q[3] * v) * abs(z) ** q[2]) / q[1]


_LINE = (-30.0, 30.0)
BOUC_WEN = (Quantity("force", "force", 1e-3, 30.0, (0.1, 0.4)),
            Quantity("yield_displacement", "position", 0.01, 10.0, (0.1, 0.5)),
            Quantity("order", "1", 0.7, 3.0, (1.0, 2.0)),
            Quantity("shape", "1", -4.0, 1.0, (0.5,), log=False))  # gamma/(beta + gamma), down to gamma = -0.8 beta
BOUC_WEN_AS_DAHL = {"presliding_friction": lambda force, displacement, order, shape: (force, force / displacement)}
EFFECTS = (
    Effect("linear_stiffness", "position", "F = stiffness * x",
           (Quantity("stiffness", "force/position", *_LINE, (0.05, 0.2, 0.6), log=False),), linear_spring,
           lambda s: s.positions(), ("missing_inertia", "cubic_stiffness"), "hold two positions at rest"),
    Effect("cubic_stiffness", "position", "F = coefficient * x^3",
           (Quantity("coefficient", "force/position^3", *_LINE, (0.1, 0.4, 1.0, 4.0), log=False),), cubic_spring,
           lambda s: s.positions(), ("end_stop", "linear_stiffness"), "a larger amplitude"),
    Effect("quadratic_stiffness", "position", "F = coefficient * x^2",
           (Quantity("coefficient", "force/position^2", *_LINE, (0.1, 0.4, -0.3), log=False),),
           quadratic_spring,
           lambda s: s.positions(), ("constant_load", "actuator_gain_asymmetry"),
           "two amplitudes around zero"),
    Effect("gravity_torque", "position", "F = torque * sin(x + phase)",
           (Quantity("torque", "force", 1e-3, 30.0, (0.15,)),
            Quantity("phase", "1", -4.0, 4.0, (0.0, 1.571, 3.1416, -1.571), log=False)), gravity,
           lambda s: s.angles(), ("linear_stiffness", "position_ripple", "constant_load"),
           "one slow turn, stopping at several angles", becomes=("linear_stiffness", "constant_load"),
           inherit={"linear_stiffness": lambda torque, phase: (torque * cos(phase),)}),
    Effect("position_ripple", "position", "F = level * sin(wavenumber*x + phase)",
           (Quantity("level", "force", 1e-3, 10.0, (0.15,)),
            Quantity("wavenumber", "1/position", 3.0, 4e4, ()),  # a period within the stroke, else it is a spring
            Quantity("phase", "1", -7.0, 7.0, (0.0, 1.571), log=False)), ripple, lambda s: s.positions(),
           ("periodic_disturbance", "gravity_torque"),
           "two constant speeds: the frequency follows the speed", contains=("gravity_torque",)),
    Effect("end_stop", "position", "F = stiffness*(|x| - position) beyond it, with damping while pressed",
           (Quantity("stiffness", "force/position", 0.3, 3e4, (30.0, 400.0)),
            Quantity("position", "position_level", 0.05, 1.1, (0.5, 0.7, 0.85, 0.95), log=False),
            Quantity("damping", "force/speed", 1e-4, 300.0, (0.3,))), end_stop,
           lambda s: s.positions(sides=True), ("cubic_stiffness", "sensor_saturation"),
           "reach and hold the stop"),
    Effect("hysteretic_spring", "hysteresis",
           "F = force*z, dz/dt = (v - ((1 - shape)*|v|*sign(z) + shape*v)*|z|^order)/yield_displacement",
           BOUC_WEN, bouc_wen, lambda s: s.positions(), ("presliding_friction", "viscous_friction"),
           "the same amplitude at two rates: the loop's area stays", extra_states=1, memory=True,
           dissipative=True, start="free", contains=("presliding_friction",),
           becomes=("linear_stiffness", "constant_load", "coulomb_friction"),
           inherit={**BOUC_WEN_AS_DAHL,
                    "linear_stiffness": lambda force, displacement, order, shape: (force / displacement,),
                    "coulomb_friction": lambda force, displacement, order, shape: (force,)}),
)
