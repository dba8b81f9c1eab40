"""Hydraulic cylinder with a linear valve: states position, speed, load pressure."""

from __future__ import annotations

from concealed import laws
from concealed import vector as V
from concealed.jit import njit
from concealed.plants.axis import TIME
from concealed.plants.base import Param, Plant, nonlinear_text

KIND = 8


@njit
def rhs(x, u, p, e, w, mode, dx):
    """p = mass, viscous friction, piston area, stiffness of the oil (bulk modulus / volume), valve gain,
    leak."""
    q, v, pressure = x[0], x[1], x[2]
    flow = p[4] * u[0] - p[2] * v - (p[5] + e[V.LEAK]) * pressure
    dx[2] = p[3] * flow
    f = p[2] * pressure + w - p[1] * v + laws.smooth_force(q, v, x, 3, e)
    laws.memory_rates(v, x, 3, e, dx)
    if mode == 0:
        dx[0] = 0.0
        dx[1] = 0.0
    else:
        dx[0] = v
        dx[1] = (f - laws.slip_friction(mode, v, e, p[2] * pressure)) / (p[0] + e[V.EXTRA_INERTIA])
    return f


def _text(plant, params, measured, variant):
    omit = {"leakage": ("leak",), "viscous_friction": ("b",)}.get(variant, ())
    leak = "" if "leak" in omit else " - leak * p"
    drag = "" if "b" in omit else " - b * v"
    body = ("    v, p = x[1], x[2]\n"
            f"    flow = valve * u[0] - area * v{leak}\n"
            f"    force = area * p{drag}\n"
            "    return np.array([v, force / m, stiffness * flow])")
    return nonlinear_text(plant, params, measured, body, "Linear valve, constant oil stiffness.", omit)


HYDRAULIC_CYLINDER = Plant(
    name="hydraulic_cylinder", title="Hydraulic cylinder: valve voltage to piston motion and pressure",
    kind=KIND,
    states=(("x", "m"), ("v", "m/s"), ("p", "Pa")), inputs=(("valve_voltage", "V"),),
    params=(Param("m", "kg", 60.0, True, "moving mass"), Param("b", "N s/m", 900.0, True, "viscous friction"),
            Param("area", "m^2", 1.0e-3, False, "piston area"),
            Param("stiffness", "Pa/m^3", 2.5e11, True, "bulk modulus over volume"),
            Param("valve", "m^3/s/V", 4.0e-5, False, "valve gain"),
            Param("leak", "m^3/s/Pa", 2.5e-11, False, "flow past the piston")),
    force_unit="N", ts=0.002, amplitude=(4.0,), bias=(0.0,), band=(0.4, 16.0),
    measured={"position_pressure": (0, 2), "velocity": (1,), "velocity_pressure": (1, 2)}, position=0,
    velocity=1,
    effects=("coulomb_friction", "asymmetric_coulomb_friction", "stribeck_friction", "presliding_friction",
             "viscous_friction", "quadratic_drag", "linear_stiffness", "end_stop", "leakage",
             "actuator_saturation",
             "actuator_rate_limit", "actuator_deadzone", "actuator_gain_asymmetry", "constant_load",
             "actuator_lag",
             "input_delay", "sensor_saturation", "sensor_quantization", "sensor_offset", "sensor_lag", *TIME),
    source=_text, x0=(0.0, 0.0, 0.0), x0_spread=(0.005, 0.02, 3.0e4),
    loop={"design": "flow", "bandwidth": 1.5, "move": 0.06},
)
