"""Effects bound to the clock; named only when every recording shows them alike."""

from __future__ import annotations

from math import cos, sin

from pwaid.mismatch.effects.base import Effect, Quantity, push

__all__ = ["EFFECTS"]


def periodic(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = amplitude_sin*sin(w*t) + amplitude_cos*cos(w*t)."""
    if phase == 1 or phase == 2:
        push(phase, q[1] * sin(q[0] * t) + q[2] * cos(q[0] * t), ii, u, p, dx)


def drift(phase, t, h, x, xs, u, p, dx, ii, q):
    """y = y + rate * t."""
    if phase == 3:
        dx[ii[7]] += q[0] * t


def parameter_drift(phase, t, h, x, xs, u, p, dx, ii, q):
    """parameter = nominal * (1 + rate * t)."""
    if phase == 1:
        p[ii[10]] *= 1.0 + q[0] * t


EFFECTS = (
    Effect("periodic_disturbance", "time", "F = amplitude_sin*sin(w*t) + amplitude_cos*cos(w*t)",
           (Quantity("angular_frequency", "rate", 0.01, 40.0, ()),
            Quantity("amplitude_sin", "force", -5.0, 5.0, (0.1, 0.0), log=False),
            Quantity("amplitude_cos", "force", -5.0, 5.0, (0.0, 0.1), log=False)), periodic,
            lambda s: s.loads(),
           ("position_ripple",), "run with zero input"),
    Effect("sensor_drift", "time", "y = y + rate * t",
           (Quantity("rate", "output/length", -5.0, 5.0, (0.1,), log=False),), drift, lambda s: s.outputs(),
           ("parameter_drift",), "a long rest at a known position"),
    Effect("parameter_drift", "time", "parameter = fitted * (1 + rate*t)",
           (Quantity("rate", "1/length", -0.9, 3.0, (0.2,), log=False),), parameter_drift,
           lambda s: s.drifting_parameters(), ("sensor_drift",), "the same trajectory cold and warm"),
)
