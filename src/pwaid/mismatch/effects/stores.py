"""Fluid and thermal stores: outflow laws, losses, limits, a second mass."""

from __future__ import annotations

from math import sqrt

from pwaid.mismatch.effects.base import Effect, Quantity
from pwaid.mismatch.vessels import cascades, heated, neighbours, outlets, own_outlets, spills, stores

__all__ = ["EFFECTS"]

BRIMLESS = 1e9  # a level that no store reaches: simulations end there


def root_outflow(phase, t, h, x, xs, u, p, dx, ii, q):
    """The plant's linear outflow k*x becomes k*sqrt(reference*x)."""
    if phase == 1:
        xs[ii[4]] = sqrt(q[0] * max(x[ii[4]], 0.0))


def two_root_outflows(phase, t, h, x, xs, u, p, dx, ii, q):
    """The linear outflows k*x of two stores become k*sqrt(reference*x), each with its own reference."""
    if phase == 1:
        xs[ii[4]] = sqrt(q[0] * max(x[ii[4]], 0.0))
        xs[ii[6]] = sqrt(q[1] * max(x[ii[6]], 0.0))


def outlet(phase, t, h, x, xs, u, p, dx, ii, q):
    """The flow k*d through one outlet, d a level or the difference of two, becomes k*sqrt(reference*|d|)*sign(d)."""
    if phase == 1:
        d = x[ii[4]] - (x[ii[6]] if ii[6] >= 0 else 0.0)
        p[ii[3]] *= sqrt(q[0] / max(abs(d), 1e-6 * q[0])) if d > 0.0 or ii[6] >= 0 else 0.0


def orifice(phase, t, h, x, xs, u, p, dx, ii, q):
    """dx/dt = ... - coefficient*sqrt(x)."""
    if phase == 2:
        dx[ii[2]] -= q[0] * sqrt(max(x[ii[4]], 0.0))


def head_offset(phase, t, h, x, xs, u, p, dx, ii, q):
    """The outflow sees the level plus an offset; an empty store gives nothing more."""
    if phase == 1:
        xs[ii[4]] = max(x[ii[4]] + q[0], 0.0)
    elif phase == 2 and q[0] > 0.0 and x[ii[4]] <= 0.0 and dx[ii[4]] < 0.0:
        dx[ii[4]] = 0.0


def two_head_offsets(phase, t, h, x, xs, u, p, dx, ii, q):
    """The outflows of two stores see their levels plus an offset each; an empty store gives nothing more."""
    if phase == 1:
        xs[ii[4]] = max(x[ii[4]] + q[0], 0.0)
        xs[ii[6]] = max(x[ii[6]] + q[1], 0.0)
    elif phase == 2:
        for k in range(2):
            i = ii[4] if k == 0 else ii[6]
            if q[k] > 0.0 and x[i] <= 0.0 and dx[i] < 0.0:
                dx[i] = 0.0


def head_offset_of_outlet(phase, t, h, x, xs, u, p, dx, ii, q):
    """The flow k*h^power through one outlet sees the level plus an offset; an empty store gives nothing."""
    if phase == 1:
        level = max(x[ii[4]], 0.0)
        p[ii[3]] *= (max(level + q[0], 0.0) / level) ** q[1] if level > 0.0 else 0.0


def leak(phase, t, h, x, xs, u, p, dx, ii, q):
    """dx/dt = ... - coefficient*x."""
    if phase == 2:
        dx[ii[2]] -= q[0] * x[ii[4]]


def leak_between(phase, t, h, x, xs, u, p, dx, ii, q):
    """dx1/dt = ... - coefficient*(x1 - x2), dx2/dt = ... + second_coefficient*(x1 - x2)."""
    if phase == 2:
        d = x[ii[4]] - x[ii[6]]
        dx[ii[4]] -= q[0] * d
        dx[ii[6]] += q[1] * d


def overflow(phase, t, h, x, xs, u, p, dx, ii, q):
    """The store stops rising at level."""
    if phase == 2 and x[ii[4]] >= q[0] and dx[ii[4]] > 0.0:
        dx[ii[4]] = 0.0


def overflow_into(phase, t, h, x, xs, u, p, dx, ii, q):
    """The store stops rising at level, and the next one, ii[6], at q[2]. A share of the spill enters that one, which
    rises q[3] times as fast by it, in proportion to parameters ii[9] and ii[11] (then q[4] and q[6]) or inversely
    (powers q[5] and q[7])."""
    if phase == 2:
        if x[ii[4]] >= q[0] and dx[ii[4]] > 0.0:
            spill = q[1] * q[3] * dx[ii[4]]
            if ii[9] >= 0:
                spill *= (p[ii[9]] / q[4]) ** q[5]
            if ii[11] >= 0:
                spill *= (p[ii[11]] / q[6]) ** q[7]
            dx[ii[6]] += spill
            dx[ii[4]] = 0.0
        if x[ii[6]] >= q[2] and dx[ii[6]] > 0.0:
            dx[ii[6]] = 0.0


def radiation(phase, t, h, x, xs, u, p, dx, ii, q):
    """dT/dt = ... - coefficient*(T^4 - T_ambient^4)/T_ref^3, temperatures absolute; q[2] makes them so."""
    if phase == 2:
        a = (x[ii[4]] + q[2]) / 300.0
        b = (q[1] + q[2]) / 300.0
        dx[ii[2]] -= q[0] * 75.0 * (a * a * a * a - b * b * b * b)


def second_mass(phase, t, h, x, xs, u, p, dx, ii, q):
    """dT/dt = ... - coupling_rate*(T - T_2), dT_2/dt = (T - T_2)/time_constant."""
    if phase == 2:
        d = x[ii[4]] - x[ii[0]]
        dx[ii[4]] -= q[0] * d
        dx[ii[0]] = d / q[1]


def heated_mass(phase, t, h, x, xs, u, p, dx, ii, q):
    """u_seen = conductance*(T_2 - T), dT_2/dt = (u/conductance - (T_2 - T))/time_constant: the input heats T_2."""
    e, i, j = ii[0], ii[4], ii[8]
    if phase == 0:
        x[e + 1] = u[j]
    elif phase == 1:
        u[j] += q[0] * (x[e] - x[i]) - x[e + 1]
    elif phase == 2:
        dx[e] = (x[e + 1] / q[0] - (x[e] - x[i])) / q[1]


_LEVEL = Quantity("level", "position_level", 0.2, 1.02, (0.6, 0.8, 0.92), log=False)
EFFECTS = (
    Effect("square_root_outflow", "fluid", "outflow = k*sqrt(reference*h) instead of k*h",
           (Quantity("reference", "position", 0.05, 5.0, (0.3, 1.0)),), root_outflow,
           lambda s: stores(s, "fluid"),
           ("head_offset", "leakage"), "drain over the full range of levels"),
    Effect("square_root_outflow", "fluid", "both outflows = k*sqrt(reference*h) instead of k*h",
           (Quantity("reference", "position", 0.05, 5.0, (0.3, 1.0)),
            Quantity("second_reference", "position", 0.05, 5.0, (0.3, 1.0))), two_root_outflows,
           lambda s: cascades(s, "fluid"), ("head_offset", "leakage"), "drain over the full range of levels"),
    Effect("square_root_outflow", "fluid", "flow through one outlet = k*sqrt(reference*d)*sign(d) instead of k*d",
           (Quantity("reference", "position", 0.05, 5.0, (0.3, 1.0)),), outlet, outlets,
           ("head_offset", "leakage"), "drain over the full range of levels"),
    Effect("square_root_outflow", "fluid", "dh/dt = ... - coefficient*sqrt(h)",
           (Quantity("coefficient", "position^0.5/time", 1e-4, 10.0, (0.03, 0.15, 0.5)),), orifice,
           lambda s: stores(s, "fluid"), ("head_offset", "leakage"), "drain over the full range of levels",
           dissipative=True, variant="another outlet"),
    Effect("head_offset", "fluid", "outflow sees h + offset",
           (Quantity("offset", "position", -0.5, 2.0, (0.05, 0.25), log=False),), head_offset,
           lambda s: stores(s, "fluid"), ("square_root_outflow", "leakage", "sensor_offset"),
           "drain to empty"),
    Effect("head_offset", "fluid", "both outflows see h + offset",
           (Quantity("offset", "position", -0.5, 2.0, (0.05, 0.25), log=False),
            Quantity("second_offset", "position", -0.5, 2.0, (0.05, 0.25), log=False)), two_head_offsets,
           lambda s: cascades(s, "fluid"), ("square_root_outflow", "leakage", "sensor_offset"),
           "drain to empty"),
    Effect("head_offset", "fluid", "flow through one outlet sees h + offset",
           (Quantity("offset", "position", -0.5, 2.0, (0.05, 0.25), log=False),), head_offset_of_outlet,
           own_outlets, ("square_root_outflow", "leakage", "sensor_offset"), "drain to empty"),
    Effect("leakage", "fluid", "dx/dt = ... - coefficient*x",
           (Quantity("coefficient", "1/time", 1e-4, 10.0, (0.03, 0.15, 0.5)),), leak,
           lambda s: stores(s, "fluid"),
           ("head_offset", "square_root_outflow"), "close everything and wait", dissipative=True),
    Effect("leakage", "fluid", "dx1/dt = ... - coefficient*(x1 - x2), dx2/dt = ... + second_coefficient*(x1 - x2)",
           (Quantity("coefficient", "1/time", 1e-4, 10.0, (0.03, 0.2)),
            Quantity("second_coefficient", "1/time", 1e-4, 10.0, (0.03, 0.2))), leak_between, neighbours,
           ("head_offset", "square_root_outflow"), "close everything and wait", dissipative=True),
    Effect("overflow", "fluid", "dh/dt <= 0 at the brim; a share of what spills enters the next store",
           (_LEVEL, Quantity("share", "1", 0.0, 1.0, (0.05, 0.4), log=False)), overflow_into,
           lambda s: spills(s, BRIMLESS), ("actuator_saturation", "sensor_saturation"), "a long high plateau"),
    Effect("overflow", "fluid", "dh/dt <= 0 at the brim", (_LEVEL,), overflow, lambda s: stores(s, "fluid"),
           ("actuator_saturation", "sensor_saturation"), "a long high plateau"),
    Effect("overflow", "fluid",
           "dh/dt <= 0 at both brims; a share of what spills from the first enters the second store",
           (_LEVEL, Quantity("share", "1", 0.0, 1.0, (0.05, 0.4), log=False),
            Quantity("second_level", "second_level", 0.2, 1.02, (0.92,), log=False)), overflow_into, spills,
           ("actuator_saturation", "sensor_saturation"), "a long high plateau"),
    Effect("radiation", "thermal", "dT/dt = ... - coefficient*75 K*((T/300 K)^4 - (T_ambient/300 K)^4)",
           (Quantity("coefficient", "1/time", 1e-4, 30.0, (0.03, 0.2, 1.0)),
            Quantity("ambient", "ambient_level", -5.0, 5.0, (0.0, 0.5), log=False)), radiation,
            lambda s: stores(s, "thermal"),
           ("leakage", "second_thermal_mass"), "two temperatures, long rests", dissipative=True),
    Effect("second_thermal_mass", "thermal",
           "dT/dt = ... - coupling_rate*(T - T2), dT2/dt = (T - T2)/time_constant",
           (Quantity("coupling_rate", "1/time", 1e-3, 30.0, (0.1, 0.5)),
            Quantity("time_constant", "time", 0.01, 30.0, (0.2, 1.0, 3.0))), second_mass,
            lambda s: stores(s, "thermal"),
           ("input_delay", "radiation"), "a step and a long wait", extra_states=1, memory=True,
           start="stored"),
    Effect("second_thermal_mass", "thermal",
           "heat goes into T2: u seen = conductance*(T2 - T), dT2/dt = (u/conductance - (T2 - T))/time_constant",
           (Quantity("conductance", "input/position", 0.01, 100.0, (0.5, 3.0)),
            Quantity("time_constant", "time", 0.01, 30.0, (0.1, 0.5, 2.0))), heated_mass, heated,
           ("actuator_lag", "input_delay", "sensor_lag"), "measure the heater too, or warm the mass from outside",
           extra_states=2, memory=True, start="stored", contains=("actuator_lag",)),
)
