"""Ids and families of the design's effect table, and which laws contain which."""

from __future__ import annotations

FAMILIES = {
    "dry_friction": ("coulomb_friction", "asymmetric_coulomb_friction", "stribeck_friction",
                     "presliding_friction",
                     "load_dependent_friction"),
    "smooth_damping": ("viscous_friction", "asymmetric_viscous_friction", "quadratic_drag"),
    "position": ("linear_stiffness", "cubic_stiffness", "quadratic_stiffness", "gravity_torque",
                 "position_ripple",
                 "end_stop"),
    "hysteresis": ("hysteretic_spring",),
    "transmission": ("backlash", "compliance"),
    "inertial": ("missing_inertia", "coriolis_torque"),
    "actuator": ("actuator_saturation", "actuator_rate_limit", "actuator_deadzone", "input_play",
                 "actuator_gain_asymmetry", "constant_load", "actuator_lag", "input_delay"),
    "sensor": ("sensor_saturation", "sensor_rectification", "sensor_quantization", "sensor_offset",
               "sensor_lag",
               "sensor_nonlinearity"),
    "fluid": ("square_root_outflow", "head_offset", "leakage", "overflow"),
    "thermal": ("radiation", "second_thermal_mass"),
    "time": ("periodic_disturbance", "sensor_drift", "parameter_drift"),
}
FAMILY = {effect: family for family, members in FAMILIES.items() for effect in members}
IDS = tuple(FAMILY)

RICHER_FRICTION = ("asymmetric_coulomb_friction", "stribeck_friction", "presliding_friction",
                   "load_dependent_friction")

# Laws that contain another one as a special case: taken out together in leave-one-effect-out runs. Dahl's friction is
# Bouc and Wen's law without the linear spring.
CONTAINED_IN = {
    "coulomb_friction": (*RICHER_FRICTION, "hysteretic_spring"), "presliding_friction": ("hysteretic_spring",),
    "viscous_friction": ("asymmetric_viscous_friction",),
    "linear_stiffness": ("hysteretic_spring", "presliding_friction"),
    "gravity_torque": ("position_ripple",), "compliance": ("backlash",),
}

# What a simpler law of the catalogue needs beside it to be the very same law: taken out too.
COMPLETED_BY = {"asymmetric_coulomb_friction": ("constant_load",)}

THRESHOLDS = ("actuator_saturation", "actuator_rate_limit", "end_stop", "sensor_saturation", "overflow")
