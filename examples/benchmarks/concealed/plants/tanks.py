"""One tank, or two in cascade: A dh/dt = K u − c √h, with exact brims."""

from __future__ import annotations

import math

from concealed import vector as V
from concealed.jit import njit
from concealed.plants.base import Param, Plant, nonlinear_text

SINGLE, CASCADE = 3, 4


@njit
def outflow(h, c, head, e):
    """Flow out of a tank at level h: c√(h + head) or, with the switch off, c·h."""
    wet = max(h, 0.0)
    return c * math.sqrt(wet + head) if e[V.SQUARE_ROOT] > 0.0 else c * wet


@njit
def single(x, u, p, e, w, dx):
    """p = area, gain, outflow coefficient."""
    net = p[1] * u[0] + w - outflow(x[0], p[2], e[V.HEAD], e) - e[V.LEAK] * max(x[0], 0.0)
    if (e[V.BRIM] > 0.0 and x[0] >= e[V.BRIM] and net > 0.0) or (x[0] <= 0.0 and net < 0.0):
        net = 0.0
    dx[0] = net / p[0]


@njit
def cascade(x, u, p, e, w, dx):
    """p = area 1, area 2, gain, outflow coefficients 1 and 2. Water over the first brim goes partly below."""
    q1 = outflow(x[0], p[3], 0.0, e)
    net1 = p[2] * u[0] + w - q1 - e[V.LEAK] * max(x[0], 0.0)
    spill = 0.0
    if e[V.BRIM] > 0.0 and x[0] >= e[V.BRIM] and net1 > 0.0:
        spill = e[V.BRIM_SHARE] * net1
        net1 = 0.0
    if x[0] <= 0.0 and net1 < 0.0:
        q1 = max(q1 + net1, 0.0)
        net1 = 0.0
    net2 = q1 + spill - outflow(x[1], p[4], e[V.HEAD], e)
    if x[1] <= 0.0 and net2 < 0.0:
        net2 = 0.0
    dx[0] = net1 / p[0]
    dx[1] = net2 / p[1]


@njit
def project(x, n, e):
    """Bring levels back between floor and brim after a finite step."""
    for i in range(n):
        if x[i] < 0.0:
            x[i] = 0.0
    if e[V.BRIM] > 0.0 and x[0] > e[V.BRIM]:
        x[0] = e[V.BRIM]


def _law(level, coefficient, variant):
    if variant == "square_root_outflow":
        return f"{coefficient} * {level}"
    return f"{coefficient} * np.sqrt(np.maximum({level}, 0.0))"


def _text_single(plant, params, measured, variant):
    body = (f"    outflow = {_law('x[0]', 'c', variant)}\n"
            "    return np.array([(gain * u[0] - outflow) / area])")
    return nonlinear_text(plant, params, measured, body, "Levels in metres.")


def _text_cascade(plant, params, measured, variant):
    body = (f"    q1 = {_law('x[0]', 'c1', variant)}\n"
            f"    q2 = {_law('x[1]', 'c2', variant)}\n"
            "    return np.array([(gain * u[0] - q1) / area1, (q1 - q2) / area2])")
    return nonlinear_text(plant, params, measured, body, "Levels in metres.")


_COMMON = ("actuator_saturation", "actuator_rate_limit", "constant_load", "actuator_lag", "input_delay",
           "square_root_outflow", "leakage", "overflow", "sensor_saturation",
           "sensor_quantization", "sensor_offset", "sensor_nonlinearity", "head_offset",
           "periodic_disturbance",
           "sensor_drift", "parameter_drift")

SINGLE_TANK = Plant(
    name="single_tank", title="Tank with a free outlet: pump voltage to level", kind=SINGLE,
    states=(("h", "m"),), inputs=(("pump", "V"),),
    params=(Param("area", "m^2", 0.015, True, "cross section"), Param("gain", "m^3/s/V", 2.0e-5, False,
                                                                      "pump"),
            Param("c", "m^2.5/s", 2.0e-4, True, "outlet coefficient")),
    force_unit="m^3/s", ts=1.5, amplitude=(1.7,), bias=(4.6,), band=(0.0006, 0.02),
    measured={"level": (0,)}, position=-1, velocity=-1, effects=_COMMON, source=_text_single,
    x0=(0.2,), x0_spread=(0.05,), switches={"square_root": 1.0}, loop={"design": "store", "move": 0.12},
)

CASCADED_TANKS = Plant(
    name="cascaded_tanks", title="Two tanks in cascade: pump voltage to levels", kind=CASCADE,
    states=(("h1", "m"), ("h2", "m")), inputs=(("pump", "V"),),
    params=(Param("area1", "m^2", 0.012, True, "cross section, upper"),
            Param("area2", "m^2", 0.014, False, "cross section, lower"),
            Param("gain", "m^3/s/V", 2.0e-5, False, "pump"), Param("c1", "m^2.5/s", 2.2e-4, True,
                                                                   "upper outlet"),
            Param("c2", "m^2.5/s", 2.1e-4, True, "lower outlet")),
    force_unit="m^3/s", ts=1.5, amplitude=(1.7,), bias=(4.6,), band=(0.0006, 0.02),
    measured={"lower_level": (1,), "levels": (0, 1)}, position=-1, velocity=-1, effects=(*_COMMON,
                                                                                         "sensor_lag"),
    source=_text_cascade, x0=(0.18, 0.2), x0_spread=(0.05, 0.05), switches={"square_root": 1.0},
    loop={"design": "store", "move": 0.10},
)
