"""Horizontal two-link arm; states q1, q2, w1, w2; inputs two joint torques. Friction and missing
inertia at joint 1."""

from __future__ import annotations

import math

from concealed import laws
from concealed import vector as V
from concealed.jit import njit
from concealed.plants.axis import TIME
from concealed.plants.base import Param, Plant, nonlinear_text

KIND = 2


@njit
def rhs(x, u, p, e, w, mode, dx):
    """p = a1, a2, a3 (inertia about joint 1, coupling, link 2), b1, b2, gain."""
    c2, s2 = math.cos(x[1]), math.sin(x[1])
    m11 = p[0] + 2.0 * p[1] * c2 + e[V.EXTRA_INERTIA]
    m12 = p[2] + p[1] * c2
    m22 = p[2]
    on = e[V.CORIOLIS]
    h1 = -on * p[1] * s2 * (2.0 * x[2] * x[3] + x[3] * x[3])
    h2 = on * p[1] * s2 * x[2] * x[2]
    f1 = p[5] * u[0] + w - p[3] * x[2] - h1 + laws.smooth_force(x[0], x[2], x, 4, e)
    f2 = p[5] * u[1] - p[4] * x[3] - h2
    laws.memory_rates(x[2], x, 4, e, dx)
    dx[1] = x[3]
    if mode == 0:
        dx[0] = 0.0
        dx[2] = 0.0
        dx[3] = f2 / m22
        return f1 - m12 * dx[3]
    f1 -= laws.slip_friction(mode, x[2], e, p[5] * u[0])
    det = m11 * m22 - m12 * m12
    dx[0] = x[2]
    dx[2] = (m22 * f1 - m12 * f2) / det
    dx[3] = (m11 * f2 - m12 * f1) / det
    return f1 - m12 * f2 / m22


def _text(plant, params, measured, variant):
    if variant == "coriolis_torque":
        speed, h1, h2 = "", "", ""
    else:
        speed = "    s2 = np.sin(q2)\n"
        h1, h2 = " + a2 * s2 * (2.0 * w1 * w2 + w2 * w2)", " - a2 * s2 * w1 * w1"
    body = ("    q2, w1, w2 = x[1], x[2], x[3]\n"
            "    c2 = np.cos(q2)\n"
            f"{speed}"
            "    m11 = a1 + 2.0 * a2 * c2\n"
            "    m12 = a3 + a2 * c2\n"
            "    m22 = a3\n"
            f"    f1 = gain * u[0] - b1 * w1{h1}\n"
            f"    f2 = gain * u[1] - b2 * w2{h2}\n"
            "    det = m11 * m22 - m12 * m12\n"
            "    return np.array([w1, w2, (m22 * f1 - m12 * f2) / det, (m11 * f2 - m12 * f1) / det])")
    note = "Rigid links in a horizontal plane."
    return nonlinear_text(plant, params, measured, body, note)


ARM = Plant(
    name="two_link_arm", title="Two-link arm: joint torques to joint angles and speeds", kind=KIND,
    states=(("q1", "rad"), ("q2", "rad"), ("w1", "rad/s"), ("w2", "rad/s")),
    inputs=(("tau1", "N m"), ("tau2", "N m")),
    params=(Param("a1", "kg m^2", 0.5, True, "inertia about joint 1 without the coupling"),
            Param("a2", "kg m^2", 0.12, False, "coupling inertia"), Param("a3", "kg m^2", 0.16, False,
                                                                          "link 2"),
            Param("b1", "N m s/rad", 1.2, True, "viscous friction, joint 1"),
            Param("b2", "N m s/rad", 0.5, True, "viscous friction, joint 2"), Param("gain", "-", 1.0, False)),
    force_unit="N m", ts=0.01, amplitude=(3.0, 1.2), bias=(0.0, 0.0), band=(0.1, 3.0),
    measured={"positions": (0, 1), "velocities": (2, 3)}, position=0, velocity=2,
    effects=("coulomb_friction", "asymmetric_coulomb_friction", "stribeck_friction", "presliding_friction",
             "asymmetric_viscous_friction", "quadratic_drag", "linear_stiffness",
             "gravity_torque", "end_stop", "missing_inertia", "coriolis_torque", "actuator_saturation",
             "actuator_deadzone", "actuator_gain_asymmetry", "constant_load", "actuator_lag", "input_delay",
             "sensor_saturation", "sensor_quantization", "sensor_lag", *TIME),
    source=_text, x0=(0.0, 0.8, 0.0, 0.0), x0_spread=(0.2, 0.3, 0.2, 0.3), switches={"coriolis": 1.0},
    loop={"design": "position", "bandwidth": 1.5, "move": 0.9},
)
