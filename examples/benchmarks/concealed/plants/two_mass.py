"""Two inertias and a shaft: states motor angle, motor speed, load angle, load speed."""

from __future__ import annotations

from concealed import laws
from concealed import vector as V
from concealed.jit import njit
from concealed.plants.axis import SENSOR, TIME
from concealed.plants.base import Param, Plant, nonlinear_text

KIND = 1


@njit
def rhs(x, u, p, e, w, mode, dx):
    """p = motor inertia, load inertia, shaft stiffness, shaft damping, motor and load viscous friction,
    gain."""
    shaft = laws.gap_force(x[0] - x[2], x[1] - x[3], p[2], p[3], e[V.HALF_GAP])
    side = 2 * int(e[V.FRICTION_SIDE])
    motor = p[6] * u[0] - p[4] * x[1] - shaft + w
    load = shaft - p[5] * x[3]
    extra = laws.smooth_force(x[side], x[side + 1], x, 4, e)
    laws.memory_rates(x[side + 1], x, 4, e, dx)
    if side == 0:
        motor += extra
        held = motor
        transmitted = p[6] * u[0]
    else:
        load += extra
        held = load
        transmitted = shaft
    dry = 0.0 if mode == 0 else laws.slip_friction(mode, x[side + 1], e, transmitted)
    dx[0] = x[1]
    dx[2] = x[3]
    dx[1] = (motor - (dry if side == 0 else 0.0)) / p[0]
    dx[3] = (load - (dry if side == 2 else 0.0)) / (p[1] + e[V.EXTRA_INERTIA])
    if mode == 0:
        dx[side] = 0.0
        dx[side + 1] = 0.0
    return held


def _text(plant, params, measured, variant):
    body = ("    q_m, w_m, q_l, w_l = x[0], x[1], x[2], x[3]\n"
            "    shaft = k * (q_m - q_l) + d * (w_m - w_l)\n"
            "    motor = gain * u[0] - shaft - b_m * w_m\n"
            "    load = shaft - b_l * w_l\n"
            "    return np.array([w_m, motor / J_m, w_l, load / J_l])")
    return nonlinear_text(plant, params, measured, body, "Linear shaft without play.")


TWO_MASS_DRIVE = Plant(
    name="two_mass_drive", title="Two-mass drive: motor torque to motor and load motion", kind=KIND,
    states=(("q_m", "rad"), ("w_m", "rad/s"), ("q_l", "rad"), ("w_l", "rad/s")), inputs=(("torque", "N m"),),
    params=(Param("J_m", "kg m^2", 0.002, False, "motor inertia"), Param("J_l", "kg m^2", 0.006, True,
                                                                         "load inertia"),
            Param("k", "N m/rad", 9.0, True, "shaft stiffness"), Param("d", "N m s/rad", 0.012, False,
                                                                       "shaft damping"),
            Param("b_m", "N m s/rad", 0.012, True, "motor viscous friction"),
            Param("b_l", "N m s/rad", 0.008, False, "load viscous friction"),
            Param("gain", "-", 1.0, False, "torque gain")),
    force_unit="N m", ts=0.002, amplitude=(0.5,), bias=(0.0,), band=(0.4, 18.0),
    measured={"motor_velocity": (1,), "both_positions": (0, 2), "both_velocities": (1, 3),
              "motor_position": (0,)},
    position=0, velocity=1,
    effects=("coulomb_friction", "asymmetric_coulomb_friction", "stribeck_friction", "presliding_friction",
             "load_dependent_friction", "quadratic_drag", "backlash", "cubic_stiffness", "position_ripple",
             "actuator_saturation", "actuator_rate_limit", "actuator_deadzone", "input_play",
             "actuator_gain_asymmetry", "constant_load", "actuator_lag", "input_delay", *SENSOR, *TIME),
    source=_text, x0=(0.0, 0.0, 0.0, 0.0), x0_spread=(0.05, 0.3, 0.05, 0.3),
    loop={"design": "position", "bandwidth": 2.5, "move": 2.0},
)
