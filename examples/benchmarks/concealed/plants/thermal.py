"""Heated body: C dT/dt = K u − G (T − T_a); temperatures in degrees Celsius."""

from __future__ import annotations

from concealed import vector as V
from concealed.jit import njit
from concealed.plants.base import Param, Plant, nonlinear_text

KIND = 5
KELVIN = 273.15


@njit
def rhs(x, u, p, e, w, dx):
    """p = capacity, conductance, gain, ambient temperature."""
    hot, cold = x[0] + KELVIN, p[3] + KELVIN
    flow = p[2] * u[0] + w - p[1] * (x[0] - p[3]) - e[V.RADIATION] * (hot**4 - cold**4)
    if e[V.SECOND_CAPACITY] > 0.0:
        passed = e[V.SECOND_CONDUCTANCE] * (x[0] - x[1 + V.SECOND_STORE])
        flow -= passed
        dx[1 + V.SECOND_STORE] = passed / e[V.SECOND_CAPACITY]
    dx[0] = flow / p[0]


def _text(plant, params, measured, variant):
    body = "    return np.array([(gain * u[0] - G * (x[0] - T_a)) / C])"
    return nonlinear_text(plant, params, measured, body, "One lumped capacity.")


THERMAL_PLANT = Plant(
    name="thermal_plant", title="Heated body: heater power to temperature", kind=KIND,
    states=(("T", "degC"),), inputs=(("heater", "W"),),
    params=(Param("C", "J/K", 120.0, True, "heat capacity"), Param("G", "W/K", 0.45, True, "loss to ambient"),
            Param("gain", "-", 1.0, False, "heater efficiency"), Param("T_a", "degC", 22.0, False,
                                                                       "ambient")),
    force_unit="W", ts=4.0, amplitude=(28.0,), bias=(48.0,), band=(0.0002, 0.008),
    measured={"temperature": (0,)}, position=-1, velocity=-1,
    effects=("radiation", "second_thermal_mass", "actuator_saturation", "actuator_rate_limit",
             "constant_load",
             "input_delay", "sensor_saturation", "sensor_quantization",
             "sensor_nonlinearity", "periodic_disturbance", "sensor_drift", "parameter_drift"),
    source=_text, x0=(90.0,), x0_spread=(25.0,), loop={"design": "store", "move": 35.0},
)
