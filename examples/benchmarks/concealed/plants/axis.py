"""One axis: M dv/dt = K u − b v − k x − G sin x. Rotary drive, linear drive, mass–spring–damper, pendulum."""

from __future__ import annotations

import math

from concealed import laws
from concealed import vector as V
from concealed.jit import njit
from concealed.plants.base import Param, Plant, nonlinear_text

KIND = 0


@njit
def rhs(x, u, p, e, w, mode, dx):
    """Rates of one axis; returns the force that standstill would have to carry."""
    q, v = x[0], x[1]
    f = p[2] * u[0] + w - p[1] * v - p[3] * q - p[4] * math.sin(q) + laws.smooth_force(q, v, x, 2, e)
    if e[V.MODE_INERTIA] > 0.0:
        link = e[V.MODE_STIFFNESS] * (q - x[2 + V.MODE_POSITION])
        link += e[V.MODE_DAMPING] * (v - x[2 + V.MODE_VELOCITY])
        f -= link
        dx[2 + V.MODE_POSITION] = x[2 + V.MODE_VELOCITY]
        dx[2 + V.MODE_VELOCITY] = link / e[V.MODE_INERTIA]
    laws.memory_rates(v, x, 2, e, dx)
    if mode == 0:
        dx[0] = 0.0
        dx[1] = 0.0
    else:
        dx[0] = v
        dx[1] = (f - laws.slip_friction(mode, v, e, p[2] * u[0])) / (p[0] + e[V.EXTRA_INERTIA]
                                                                     - e[V.MODE_INERTIA])
    return f


def _source(extra):
    def text(plant, params, measured, variant):
        names = {"M": plant.params[0].name, "v": plant.states[1][0]}
        drag = "" if variant == "viscous_friction" else f" - {plant.params[1].name} * {names['v']}"
        unused = [p.name for p in plant.params[3:] if p.typical == 0.0]
        omit = (*unused, plant.params[1].name) if variant == "viscous_friction" else tuple(unused)
        body = (f"    {names['v']} = x[1]\n"
                f"    force = {plant.params[2].name} * u[0]{drag}{extra}\n"
                f"    return np.array([{names['v']}, force / {names['M']}])")
        return nonlinear_text(plant, params, measured, body, "Rigid, linear." if "sin" not in extra
                              else "Rigid.",
                              omit)
    return text


FRICTION = ("coulomb_friction", "asymmetric_coulomb_friction", "stribeck_friction", "presliding_friction",
            "load_dependent_friction", "viscous_friction", "asymmetric_viscous_friction", "quadratic_drag")
INPUT = ("actuator_saturation", "actuator_rate_limit", "actuator_deadzone", "input_play",
         "actuator_gain_asymmetry", "constant_load", "actuator_lag", "input_delay")
SENSOR = ("sensor_saturation", "sensor_rectification", "sensor_quantization", "sensor_offset", "sensor_lag",
          "sensor_nonlinearity")
TIME = ("periodic_disturbance", "sensor_drift", "parameter_drift")

ROTARY_DRIVE = Plant(
    name="rotary_drive", title="Rotary drive: motor torque to shaft angle and speed", kind=KIND,
    states=(("theta", "rad"), ("omega", "rad/s")), inputs=(("torque", "N m"),),
    params=(Param("J", "kg m^2", 0.02, True, "inertia"), Param("b", "N m s/rad", 0.06, True,
                                                               "viscous friction"),
            Param("gain", "-", 1.0, False, "torque constant ratio"), Param("k", "N m/rad", 0.0, False),
            Param("G", "N m", 0.0, False)),
    force_unit="N m", ts=0.01, amplitude=(0.9,), bias=(0.0,), band=(0.1, 4.0),
    measured={"position": (0,), "velocity": (1,), "both": (0, 1)}, position=0, velocity=1,
    effects=(*FRICTION, "linear_stiffness", "cubic_stiffness", "gravity_torque", "position_ripple",
             "end_stop",
             "hysteretic_spring", "compliance", "missing_inertia", *INPUT, *SENSOR, *TIME),
    source=_source(""), x0=(0.0, 0.0), x0_spread=(0.3, 0.5),
    loop={"design": "position", "bandwidth": 1.6, "move": 3.0},
)

LINEAR_DRIVE = Plant(
    name="linear_drive", title="Linear drive: drive voltage to carriage position and speed", kind=KIND,
    states=(("x", "m"), ("v", "m/s")), inputs=(("voltage", "V"),),
    params=(Param("m", "kg", 85.0, True, "moving mass"), Param("b", "N s/m", 220.0, True, "viscous friction"),
            Param("gain", "N/V", 35.0, False, "drive gain"), Param("k", "N/m", 0.0, False),
            Param("G", "N", 0.0, False)),
    force_unit="N", ts=0.008, amplitude=(5.0,), bias=(0.0,), band=(0.12, 4.0),
    measured={"position": (0,), "velocity": (1,), "both": (0, 1)}, position=0, velocity=1,
    effects=(*FRICTION, "linear_stiffness", "cubic_stiffness", "position_ripple", "end_stop",
             "hysteretic_spring", "compliance", "missing_inertia", *INPUT, *SENSOR, *TIME),
    source=_source(""), x0=(0.0, 0.0), x0_spread=(0.02, 0.05),
    loop={"design": "position", "bandwidth": 1.6, "move": 0.15},
)

MASS_SPRING_DAMPER = Plant(
    name="mass_spring_damper", title="Mass on a spring with a damper: force to position and speed", kind=KIND,
    states=(("x", "m"), ("v", "m/s")), inputs=(("force", "N"),),
    params=(Param("m", "kg", 1.5, True, "mass"), Param("b", "N s/m", 4.0, True, "damping"),
            Param("gain", "-", 1.0, False, "actuator gain"), Param("k", "N/m", 150.0, True,
                                                                   "spring stiffness"),
            Param("G", "N", 0.0, False)),
    force_unit="N", ts=0.01, amplitude=(9.0,), bias=(0.0,), band=(0.15, 4.0),
    measured={"position": (0,), "velocity": (1,), "both": (0, 1)}, position=0, velocity=1,
    effects=(*FRICTION, "cubic_stiffness", "quadratic_stiffness", "end_stop", "hysteretic_spring",
             "compliance",
             "missing_inertia", "actuator_saturation", "actuator_rate_limit", "actuator_deadzone",
             "input_play",
             "actuator_gain_asymmetry", "constant_load", "actuator_lag", "input_delay", "sensor_saturation",
             "sensor_rectification", "sensor_quantization", "sensor_lag", "sensor_nonlinearity", *TIME),
    source=_source(" - k * x[0]"), x0=(0.0, 0.0), x0_spread=(0.02, 0.1),
    loop={"design": "position", "bandwidth": 2.5, "move": 0.06},
)

PENDULUM = Plant(
    name="pendulum", title="Driven pendulum, hanging at zero: torque to angle and speed", kind=KIND,
    states=(("phi", "rad"), ("omega", "rad/s")), inputs=(("torque", "N m"),),
    params=(Param("J", "kg m^2", 0.05, True, "inertia about the pivot"),
            Param("b", "N m s/rad", 0.06, True, "viscous friction"), Param("gain", "-", 1.0, False,
                                                                           "torque gain"),
            Param("k", "N m/rad", 0.0, False), Param("mgl", "N m", 1.2, True,
                                                     "gravity torque at 90 degrees")),
    force_unit="N m", ts=0.0125, amplitude=(0.55,), bias=(0.0,), band=(0.1, 2.5),
    measured={"position": (0,), "velocity": (1,), "both": (0, 1)}, position=0, velocity=1,
    effects=(*FRICTION, "linear_stiffness", "cubic_stiffness", "position_ripple", "end_stop",
             "hysteretic_spring", "compliance", *INPUT, *SENSOR, *TIME),
    source=_source(" - mgl * np.sin(x[0])"), x0=(0.0, 0.0), x0_spread=(0.2, 0.5),
    loop={"design": "position", "bandwidth": 1.5, "move": 0.7},
)
