"""Dry friction: what resists motion with a force that does not vanish with speed."""

from __future__ import annotations

from math import exp

from numba import njit

from pwaid.mismatch.effects.base import Effect, Quantity, push, slide

__all__ = ["EFFECTS", "dahl"]

_PROBES = (0.04, 0.15, 0.4)


def coulomb(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = level * sign(v), exact at rest."""
    if phase >= 4:
        slide(phase, q[0], ii, h, x, xs, dx)


def asymmetric(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = level_positive for v > 0, -level_negative for v < 0."""
    if phase >= 4:
        slide(phase, q[0] if x[ii[4]] > 0.0 else q[1], ii, h, x, xs, dx)


def stribeck(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = (level + (static_level - level) * exp(-(v/stribeck_speed)^2)) * sign(v); q[1] is the excess."""
    if phase >= 4:
        r = (xs[ii[4]] if phase == 4 else x[ii[4]]) / q[2]
        slide(phase, q[0] + q[1] * exp(-r * r), ii, h, x, xs, dx)


def stribeck_of_first_order(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = (level + excess * exp(-|v|/stribeck_speed)) * sign(v): steepest at rest, as in Bo and Pavelescu (1982)."""
    if phase >= 4:
        slide(phase, q[0] + q[1] * exp(-abs(xs[ii[4]] if phase == 4 else x[ii[4]]) / q[2]), ii, h, x, xs, dx)


@njit(cache=True, nogil=True, error_model="numpy")
def dahl(z, v, h, level, stiffness):
    """Dahl's strain after a time h at the speed v: dz/dt = v - stiffness*|v|*z/level."""
    b = stiffness * abs(v) * h / level
    if b < 1e-6:
        return z + v * h
    rest = level / stiffness * (1.0 if v > 0.0 else -1.0)
    return rest + (z - rest) * exp(-b)


def presliding(phase, t, h, x, xs, u, p, dx, ii, q):
    """Dahl: F = stiffness * z, dz/dt = v - stiffness*|v|*z/level, exact for the substep's first speed."""
    e = ii[0]
    if phase == 0:
        old = x[e]
        x[e] = dahl(old, x[ii[4]], h, q[0], q[1])
        x[e + 1] = 0.5 * (old + x[e])
    elif phase <= 2:
        push(phase, -q[1] * x[e + 1], ii, u, p, dx)


def load_dependent(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = (level + load_factor * |input|) * sign(v)."""
    if phase >= 4:
        slide(phase, q[0] + q[1] * abs(u[ii[8]]), ii, h, x, xs, dx)


EFFECTS = (
    Effect("coulomb_friction", "dry_friction", "F = level * sign(v)",
           (Quantity("level", "force", 1e-4, 5.0, _PROBES),), coulomb, lambda s: s.moving(),
           ("viscous_friction", "actuator_deadzone", "presliding_friction", "stribeck_friction"),
           "a slow triangle with reversals, at two speeds", proximal=True, dissipative=True),
    Effect("asymmetric_coulomb_friction", "dry_friction",
           "F = level_positive if v > 0 else -level_negative",
           (Quantity("level_positive", "force", 1e-4, 5.0, (0.04, 0.3)),
            Quantity("level_negative", "force", 1e-4, 5.0, (0.04, 0.3))), asymmetric, lambda s: s.moving(),
           ("constant_load", "asymmetric_viscous_friction"),
           "the same trajectory in both directions", proximal=True, dissipative=True,
           contains=("coulomb_friction",)),
    *(Effect("stribeck_friction", "dry_friction", law,
             (Quantity("level", "force", 1e-4, 5.0, (0.04, 0.25)),
              Quantity("excess", "force", 1e-3, 3.0, (0.1, 0.4)),
              Quantity("stribeck_speed", "speed", 0.003, 0.6, (0.03, 0.15))), kernel, lambda s: s.moving(),
             ("coulomb_friction", "presliding_friction"),
             "many slow crossings, sampled with at least 20 points below the Stribeck speed", proximal=True,
             dissipative=True, contains=("coulomb_friction",), variant=variant)
      for kernel, variant, law in (
          (stribeck, "", "F = (level + excess * exp(-(v/stribeck_speed)^2)) * sign(v)"),
          (stribeck_of_first_order, "first order", "F = (level + excess * exp(-|v|/stribeck_speed)) * sign(v)"))),
    Effect("presliding_friction", "dry_friction", "F = stiffness*z, dz/dt = v - stiffness*|v|*z/level",
           (Quantity("level", "force", 1e-3, 5.0, (0.04, 0.2)),
            Quantity("stiffness", "force/position", 0.1, 3e3, (3.0, 30.0))), presliding,
           lambda s: s.moving(with_position=True), ("coulomb_friction", "hysteretic_spring"),
           "small reversals, a few percent of the stroke, around several points", extra_states=2,
           contains=("coulomb_friction",), memory=True, dissipative=True),
    Effect("load_dependent_friction", "dry_friction", "F = (level + load_factor*|load|) * sign(v)",
           (Quantity("level", "force", 1e-5, 5.0, (0.002, 0.1)),
            Quantity("load_factor", "force/input", 1e-3, 2.0, (0.06, 0.25))),
           load_dependent, lambda s: s.loaded(), ("coulomb_friction", "actuator_deadzone"),
           "the same trajectory under several loads", proximal=True, dissipative=True,
           contains=("coulomb_friction",)),
)
