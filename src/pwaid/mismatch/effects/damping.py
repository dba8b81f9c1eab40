"""Smooth damping: forces that vanish with speed."""

from __future__ import annotations

from pwaid.mismatch.effects.base import Effect, Quantity, push

__all__ = ["EFFECTS"]


def viscous(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = coefficient * v."""
    push(phase, -q[0] * x[ii[4]], ii, u, p, dx)


def asymmetric_viscous(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = coefficient_positive*v for v > 0, coefficient_negative*v for v < 0."""
    v = x[ii[4]]
    push(phase, -(q[0] if v > 0.0 else q[1]) * v, ii, u, p, dx)


def drag(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = coefficient * v * |v|."""
    v = x[ii[4]]
    push(phase, -q[0] * v * abs(v), ii, u, p, dx)


EFFECTS = (
    Effect("viscous_friction", "smooth_damping", "F = coefficient * v",
           (Quantity("coefficient", "force/speed", 1e-4, 10.0, (0.04, 0.15, 0.5)),), viscous,
           lambda s: s.moving(),
           ("coulomb_friction", "quadratic_drag"), "two speeds, far apart", dissipative=True),
    Effect("asymmetric_viscous_friction", "smooth_damping",
           "F = coefficient_positive*v if v > 0 else coefficient_negative*v",
           (Quantity("coefficient_positive", "force/speed", 1e-4, 10.0, (0.02, 0.3)),
            Quantity("coefficient_negative", "force/speed", 1e-4, 10.0, (0.02, 0.3))), asymmetric_viscous,
           lambda s: s.moving(), ("constant_load", "asymmetric_coulomb_friction"),
           "the same trajectory in both directions, at two speeds", dissipative=True,
           contains=("viscous_friction",)),
    Effect("quadratic_drag", "smooth_damping", "F = coefficient * v * |v|",
           (Quantity("coefficient", "force/speed^2", 1e-4, 1e3, (0.05, 0.2, 0.6)),), drag,
           lambda s: s.moving(),
           ("viscous_friction",), "a coast-down from high speed", dissipative=True),
)
