"""Effects between the command and the plant's input."""

from __future__ import annotations

from math import exp

from pwaid.mismatch.effects.base import Effect, Quantity, push

__all__ = ["EFFECTS"]


def saturation(phase, t, h, x, xs, u, p, dx, ii, q):
    """u_applied = clip(u, -limit, limit)."""
    if phase == 1:
        j = ii[8]
        u[j] = min(max(u[j], -q[0]), q[0])


def deadzone(phase, t, h, x, xs, u, p, dx, ii, q):
    """u_applied = 0 within +-half_width, u -+ half_width outside."""
    if phase == 1:
        j = ii[8]
        a = u[j]
        u[j] = a - q[0] if a > q[0] else (a + q[0] if a < -q[0] else 0.0)


def rate_limit(phase, t, h, x, xs, u, p, dx, ii, q):
    """The applied input follows the command at most at the given rate."""
    e, j = ii[0], ii[8]
    if phase == 0:
        step = q[0] * h
        d = u[j] - x[e]
        x[e] += step if d > step else (-step if d < -step else d)
    elif phase == 1:
        u[j] = x[e]


def play(phase, t, h, x, xs, u, p, dx, ii, q):
    """The applied input is dragged by the command through a gap of +-half_gap."""
    e, j = ii[0], ii[8]
    if phase == 0:
        lo, hi = u[j] - q[0], u[j] + q[0]
        x[e] = min(max(x[e], lo), hi)
    elif phase == 1:
        u[j] = x[e]


def gain_asymmetry(phase, t, h, x, xs, u, p, dx, ii, q):
    """u_applied = u*(1 + asymmetry) for u > 0, u*(1 - asymmetry) for u < 0."""
    if phase == 1:
        j = ii[8]
        u[j] *= 1.0 + q[0] if u[j] > 0.0 else 1.0 - q[0]


def one_sided_gain(phase, t, h, x, xs, u, p, dx, ii, q):
    """u_applied = u*(1 + change) where u has the sign of ii[10], the command elsewhere."""
    if phase == 1:
        j = ii[8]
        if u[j] * ii[10] > 0.0:
            u[j] *= 1.0 + q[0]


def load(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = level, constant."""
    push(phase, q[0], ii, u, p, dx)


def lag(phase, t, h, x, xs, u, p, dx, ii, q):
    """time_constant * du_applied/dt = u - u_applied, exact while the command is held."""
    e, j = ii[0], ii[8]
    if phase == 0:
        x[e] += (1.0 - exp(-h / q[0])) * (u[j] - x[e])
        b = h / q[0]
        x[e + 1] = u[j] + (x[e] - u[j]) * ((exp(b) - 1.0) / b if b < 50.0 else 0.0)  # mean over the substep
    elif phase == 1 and h > 0.0:
        u[j] = x[e + 1]
    elif phase == 1:
        u[j] = x[e]


def delay(phase, t, h, x, xs, u, p, dx, ii, q):
    """u_applied(t) = u(t - delay): the engine shifts the input; nothing is left to do here."""


EFFECTS = (
    Effect("actuator_saturation", "actuator", "u_applied = clip(u, -limit, limit)",
           (Quantity("limit", "input", 0.02, 1.0, (0.35, 0.55, 0.75, 0.9)),), saturation,
           lambda s: s.inputs(),
           ("actuator_rate_limit", "cubic_stiffness", "quadratic_drag"),
           "an amplitude sweep at low frequency"),
    Effect("actuator_rate_limit", "actuator", "|du_applied/dt| <= rate",
           (Quantity("rate", "input*rate", 1e-3, 300.0, (0.05, 0.2, 0.7, 2.5)),), rate_limit,
           lambda s: s.inputs(),
           ("actuator_saturation", "actuator_lag"), "a frequency sweep at fixed amplitude", extra_states=1,
           memory=True, start="input"),
    Effect("actuator_deadzone", "actuator", "u_applied = 0 within +-half_width, u -+ half_width outside",
           (Quantity("half_width", "input", 1e-4, 0.9, (0.02, 0.08, 0.25)),), deadzone, lambda s: s.inputs(),
           ("coulomb_friction", "backlash"),
           "keep the load moving with a bias: friction stays, the dead zone does not"),
    Effect("input_play", "actuator", "u_applied is dragged through a gap of +-half_gap",
           (Quantity("half_gap", "input", 1e-4, 0.9, (0.02, 0.08, 0.25)),), play, lambda s: s.inputs(),
           ("input_delay", "actuator_deadzone"), "change the amplitude: the lag is in amplitude, not in time",
           extra_states=1, memory=True, start="input"),
    Effect("actuator_gain_asymmetry", "actuator", "u_applied = u*(1 + asymmetry*sign(u))",
           (Quantity("asymmetry", "1", -0.9, 0.9, (0.05, 0.2), log=False),), gain_asymmetry,
           lambda s: s.inputs(),
           ("constant_load", "quadratic_stiffness"), "both signs of the command, two amplitudes"),
    Effect("actuator_gain_asymmetry", "actuator", "u_applied = u*(1 + change) for one sign of u, u for the other",
           (Quantity("change", "1", -0.95, 3.0, (0.1, 0.4), log=False),), one_sided_gain,
           lambda s: s.inputs(signs=True),
           ("constant_load", "quadratic_stiffness"), "both signs of the command, two amplitudes"),
    Effect("constant_load", "actuator", "F = level",
           (Quantity("level", "force", -5.0, 5.0, (0.05, 0.2), log=False),), load, lambda s: s.loads(),
           ("actuator_gain_asymmetry", "sensor_offset"), "zero input, and the reversed mounting"),
    Effect("actuator_lag", "actuator", "time_constant * du_applied/dt = u - u_applied",
           (Quantity("time_constant", "time", 0.002, 3.0, (0.02, 0.08, 0.3)),), lag, lambda s: s.inputs(),
           ("input_delay", "sensor_lag", "compliance"), "excite beyond 1/time_constant", extra_states=2,
           memory=True, start="input"),
    Effect("input_delay", "actuator", "u_applied(t) = u(t - delay)",
           (Quantity("delay", "time", 0.002, 1.0, (0.02, 0.08, 0.25)),), delay,
           lambda s: s.inputs(delays=True),
           ("actuator_lag", "sensor_lag"), "broadband excitation with exact time stamps", delays=True,
           memory=True),
)
