"""Armature and rotor of a DC motor (states current, speed), and a bare coil."""

from __future__ import annotations

from concealed import laws
from concealed import vector as V
from concealed.jit import njit
from concealed.plants.axis import SENSOR, TIME
from concealed.plants.base import Param, Plant, nonlinear_text

MOTOR, COIL = 6, 7


@njit
def motor(x, u, p, e, w, mode, dx):
    """p = resistance, inductance, torque constant, inertia, viscous friction. w is a torque."""
    dx[0] = (u[0] - p[0] * x[0] - p[2] * x[1]) / p[1]
    f = p[2] * x[0] + w - p[4] * x[1] + laws.smooth_force(0.0, x[1], x, 2, e)
    laws.memory_rates(x[1], x, 2, e, dx)
    if mode == 0:
        dx[1] = 0.0
    else:
        dx[1] = (f - laws.slip_friction(mode, x[1], e, p[2] * x[0])) / (p[3] + e[V.EXTRA_INERTIA])
    return f


@njit
def coil(x, u, p, e, w, dx):
    """p = resistance, inductance. w is a voltage."""
    dx[0] = (u[0] + w - p[0] * x[0]) / p[1]


def _text_motor(plant, params, measured, variant):
    omit = ("b",) if variant == "viscous_friction" else ()
    drag = "" if omit else " - b * x[1]"
    body = ("    current, speed = x[0], x[1]\n"
            "    return np.array([(u[0] - R * current - kt * speed) / L, "
            f"(kt * current{drag.replace('x[1]', 'speed')}) / J])")
    return nonlinear_text(plant, params, measured, body, "Torque constant equals voltage constant.", omit)


def _text_coil(plant, params, measured, variant):
    body = "    return np.array([(u[0] - R * x[0]) / L])"
    return nonlinear_text(plant, params, measured, body, "Resistance and inductance constant.")


DC_MOTOR = Plant(
    name="dc_motor", title="DC motor: armature voltage to current and speed", kind=MOTOR,
    states=(("i", "A"), ("omega", "rad/s")), inputs=(("voltage", "V"),),
    params=(Param("R", "ohm", 1.2, True, "armature resistance"), Param("L", "H", 0.006, True, "inductance"),
            Param("kt", "N m/A", 0.05, False, "torque constant"), Param("J", "kg m^2", 2.0e-4, True,
                                                                        "inertia"),
            Param("b", "N m s/rad", 2.0e-4, True, "viscous friction")),
    force_unit="N m", ts=0.001, amplitude=(6.0,), bias=(0.0,), band=(0.8, 40.0),
    measured={"current": (0,), "velocity_current": (0, 1), "velocity": (1,)}, position=-1, velocity=1,
    effects=("coulomb_friction", "asymmetric_coulomb_friction", "stribeck_friction", "viscous_friction",
             "quadratic_drag", "actuator_saturation", "actuator_rate_limit", "actuator_deadzone",
             "input_play",
             "actuator_gain_asymmetry", "constant_load", "actuator_lag", "input_delay", *SENSOR, *TIME),
    source=_text_motor, x0=(0.0, 0.0), x0_spread=(0.3, 10.0),
    loop={"design": "speed", "bandwidth": 5.0, "move": 60.0},
)

RL_CIRCUIT = Plant(
    name="rl_circuit", title="Coil with resistance: voltage to current", kind=COIL,
    states=(("i", "A"),), inputs=(("voltage", "V"),),
    params=(Param("R", "ohm", 4.0, True, "resistance"), Param("L", "H", 0.04, True, "inductance")),
    force_unit="V", ts=0.0006, amplitude=(8.0,), bias=(0.0,), band=(1.0, 60.0),
    measured={"current": (0,)}, position=-1, velocity=-1,
    effects=("actuator_saturation", "actuator_rate_limit", "actuator_deadzone", "input_play",
             "actuator_gain_asymmetry", "input_delay", "sensor_saturation",
             "sensor_quantization", "sensor_nonlinearity", *TIME),
    source=_text_coil, x0=(0.0,), x0_spread=(0.2,), loop={"design": "store", "move": 1.5},
)
