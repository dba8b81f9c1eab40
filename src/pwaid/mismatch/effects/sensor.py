"""Effects between the plant's output and the recording."""

from __future__ import annotations

from math import erf, exp, floor

from pwaid.mismatch.effects.base import Effect, Quantity

__all__ = ["EFFECTS"]


def saturation(phase, t, h, x, xs, u, p, dx, ii, q):
    """y = clip(y, lower side, upper side); variant 0 both, 1 upper only, -1 lower only."""
    if phase == 3:
        k, side = ii[7], ii[10]
        if side == 0:
            dx[k] = min(max(dx[k], -q[0]), q[0])
        elif side == 1:
            dx[k] = min(dx[k], q[0])
        else:
            dx[k] = max(dx[k], q[0])


def rectification(phase, t, h, x, xs, u, p, dx, ii, q):
    """y = |y|."""
    if phase == 3:
        dx[ii[7]] = abs(dx[ii[7]])


def quantization(phase, t, h, x, xs, u, p, dx, ii, q):
    """y = mean of step * round((y + n) / step), n normal with standard deviation dither * step.

    The noise that a reading has before it is rounded decides between two marks: their mean is what can be predicted.
    """
    if phase == 3:
        marks = dx[ii[7]] / q[0]
        nearest = floor(marks + 0.5)
        away = marks - nearest
        wide = 1.4142135623730951 * q[1]
        above = 2.0 + erf((away - 0.5) / wide) + erf((away - 1.5) / wide)
        below = 2.0 - erf((away + 0.5) / wide) - erf((away + 1.5) / wide)
        dx[ii[7]] = q[0] * (nearest + 0.5 * (above - below))


def offset(phase, t, h, x, xs, u, p, dx, ii, q):
    """y = y + offset."""
    if phase == 3:
        dx[ii[7]] += q[0]


def lag(phase, t, h, x, xs, u, p, dx, ii, q):
    """time_constant * dy/dt = y_true - y; y_true taken linear between samples."""
    if phase == 3:
        e, k = ii[0], ii[7]
        y = dx[k]
        if x[e + 2] == 0.0:
            x[e] = y
        else:
            b = h / q[0]
            d = exp(-b)
            slope = (y - x[e + 1]) / b
            x[e] = y - slope + (x[e] - x[e + 1] + slope) * d
        x[e + 1] = y
        x[e + 2] = 1.0
        dx[k] = x[e]


def nonlinearity(phase, t, h, x, xs, u, p, dx, ii, q):
    """y = y + coefficient * y^2 (variant 0) or y^3 (variant 1)."""
    if phase == 3:
        y = dx[ii[7]]
        dx[ii[7]] = y + q[0] * (y * y if ii[10] == 0 else y * y * y)


EFFECTS = (
    Effect("sensor_saturation", "sensor", "y = clip(y, limit)",
           (Quantity("limit", "output_level", 0.02, 1.02, (0.4, 0.6, 0.8, 0.92), log=False),), saturation,
           lambda s: s.outputs(sides=True), ("end_stop", "actuator_saturation"),
           "look at the speed on leaving the flat top: behind a clipped sensor the motion goes on"),
    Effect("sensor_rectification", "sensor", "y = |y|", (), rectification, lambda s: s.outputs(unsigned=True),
           ("quadratic_stiffness",), "several amplitudes around zero"),
    Effect("sensor_quantization", "sensor", "y = mean of step * round((y + n)/step), n noise of dither * step",
           (Quantity("step", "output", 1e-3, 1.0, (0.03, 0.1, 0.3)), Quantity("dither", "1", 0.01, 0.5, (0.1,))),
           quantization, lambda s: s.outputs(),
           ("stribeck_friction",), "count the distinct values of a slow ramp"),
    Effect("sensor_offset", "sensor", "y = y + offset",
           (Quantity("offset", "output", -2.0, 2.0, (0.05, 0.2), log=False),), offset, lambda s: s.outputs(),
           ("constant_load",), "a known position at rest"),
    Effect("sensor_lag", "sensor", "time_constant * dy/dt = y_true - y",
           (Quantity("time_constant", "time", 0.002, 3.0, (0.02, 0.08, 0.3)),), lag, lambda s: s.outputs(),
           ("actuator_lag", "input_delay"), "the response to a disturbance or a second sensor",
           extra_states=3,
           memory=True),
    Effect("sensor_nonlinearity", "sensor", "y = y + coefficient * y^n",
           (Quantity("coefficient", "1/output", -0.9, 0.9, (0.05, 0.2), log=False),), nonlinearity,
           lambda s: s.outputs(), ("quadratic_stiffness",), "known static positions"),
    Effect("sensor_nonlinearity", "sensor", "y = y + coefficient * y^3",
           (Quantity("coefficient", "1/output^2", -0.9, 0.9, (0.05, 0.2), log=False),), nonlinearity,
           lambda s: s.outputs(variant=1), ("cubic_stiffness",), "known static positions", variant="cubic"),
)
