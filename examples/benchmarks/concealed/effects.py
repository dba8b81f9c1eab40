"""The catalogue as physics: how big each effect is drawn, which slots it sets, and what the key calls its
numbers.

Every draw sees a `Scene`: sizes of force, motion, input and outputs in a run of the same plant without the
effect.
`size` is 1 at first and grows when the effect would be too small to be seen.
"""

from __future__ import annotations

import math

from concealed.drawn import Drawn


def draw(effect, scene, rng, size=1.0, beyond=None):
    """Draw one effect.

    Parameters
    ----------
    effect : str
        Catalogue id.
    size : float
        ≥ 1 makes it stronger than the first draw.
    beyond : float, optional
        For thresholds: put them at `beyond` × the largest value seen, so that they are never reached.
    """
    return _DRAWS[effect](effect, scene, rng, size, beyond)


def _axis(scene, state="velocity"):
    index = scene.plant.velocity if state == "velocity" else scene.plant.position
    name = scene.plant.states[index][0]
    return {"kind": "state", "signal": name, "variables": [name]}


def _input(scene):
    name = scene.plant.inputs[0][0]
    return {"kind": "input", "signal": name, "variables": [name]}


def _output(scene, channel):
    name = scene.plant.states[scene.measured[channel]][0] + "_m"
    return {"kind": "output", "signal": name, "variables": [name]}


def _units(scene):
    plant = scene.plant
    q = plant.states[plant.position][1] if plant.position >= 0 else ""
    v = plant.states[plant.velocity][1] if plant.velocity >= 0 else ""
    return plant.force_unit, q, v, plant.inputs[0][1]


def _share(rng, low, high, size, top=0.9):
    return min(rng.uniform(low, high) * size, top)


def _coulomb(effect, s, rng, size, beyond):
    level = _share(rng, 0.12, 0.4, size) * s.force
    unit = _units(s)[0]
    return Drawn(effect, {"level_positive": level, "level_negative": level}, {"level": (level, unit)},
                 _axis(s))


def _asymmetric_coulomb(effect, s, rng, size, beyond):
    high = _share(rng, 0.18, 0.45, size) * s.force
    low = high * rng.uniform(0.25, 0.6)
    plus, minus = (high, low) if rng.uniform() < 0.5 else (low, high)
    unit = _units(s)[0]
    return Drawn(effect, {"level_positive": plus, "level_negative": minus},
                 {"level_positive": (plus, unit), "level_negative": (minus, unit)}, _axis(s))


def _stribeck(effect, s, rng, size, beyond):
    level = _share(rng, 0.12, 0.25, size, 0.45) * s.force
    static = level * rng.uniform(1.7, 2.6)
    velocity = rng.uniform(0.12, 0.3) * s.v_rms
    f, _, v, _ = _units(s)
    return Drawn(effect, {"level_positive": level, "level_negative": level, "static_extra": static - level,
                          "stribeck_velocity": velocity},
                 {"level": (level, f), "static": (static, f), "velocity": (velocity, v)}, _axis(s))


def _presliding(effect, s, rng, size, beyond):
    level = _share(rng, 0.2, 0.4, size) * s.force
    stiffness = level / (rng.uniform(0.08, 0.25) * s.q_rms)
    f, q, _, _ = _units(s)
    return Drawn(effect, {"dahl_stiffness": stiffness, "dahl_level": level},
                 {"level": (level, f), "stiffness": (stiffness, f"{f}/{q}")}, _axis(s))


def _load_dependent(effect, s, rng, size, beyond):
    factor = _share(rng, 0.15, 0.35, size, 0.7)
    return Drawn(effect, {"load_factor": factor}, {"factor": (factor, "-")}, _axis(s))


def _viscous(effect, s, rng, size, beyond):
    name = "b"
    coefficient = s.plant.params[s.plant.index(name)].typical * _share(rng, 0.8, 1.6, size, 6.0)
    f, _, v, _ = _units(s)
    return Drawn(effect, {}, {"coefficient": (coefficient, f"{f}/({v})")}, _axis(s),
                 variant="viscous_friction",
                 trusted=(name,), p={name: coefficient}, nominal_p={name: 0.0})


def _asymmetric_viscous(effect, s, rng, size, beyond):
    name = next(n for n in ("b", "b1") if n in [p.name for p in s.plant.params])
    base = s.p[s.plant.index(name)]
    extra = _share(rng, 0.6, 1.2, size, 4.0) * base
    f, _, v, _ = _units(s)
    plus, minus = (extra, 0.0) if rng.uniform() < 0.5 else (0.0, extra)
    unit = f"{f}/({v})"
    return Drawn(effect, {"viscous_positive": plus, "viscous_negative": minus},
                 {"positive": (base + plus, unit), "negative": (base + minus, unit)}, _axis(s))


def _drag(effect, s, rng, size, beyond):
    coefficient = _share(rng, 0.2, 0.5, size, 3.0) * s.force / s.v_rms**2
    f, _, v, _ = _units(s)
    return Drawn(effect, {"drag": coefficient}, {"coefficient": (coefficient, f"{f}/({v})^2")}, _axis(s))


def _stiffness(effect, s, rng, size, beyond):
    power = {"linear_stiffness": 1, "quadratic_stiffness": 2, "cubic_stiffness": 3}[effect]
    reach = (0.55 * s.q_max) ** power
    value = _share(rng, 0.25, 0.6, size, 3.0) * s.force / reach
    if power == 2 and rng.uniform() < 0.5:
        value = -value
    f, q, _, _ = _units(s)
    return Drawn(effect, {f"stiffness_{power}": value}, {"stiffness": (value, f"{f}/{q}^{power}")},
                 _axis(s, "position"))


def _gravity(effect, s, rng, size, beyond):
    value = _share(rng, 0.25, 0.6, size, 1.5) * s.force
    phase = rng.uniform(-math.pi, math.pi)
    f = _units(s)[0]
    return Drawn(effect, {"gravity": value, "gravity_phase": phase}, {"level": (value, f),
                                                                      "phase": (phase, "rad")},
                 _axis(s, "position"))


def _ripple(effect, s, rng, size, beyond):
    value = _share(rng, 0.2, 0.45, size, 1.2) * s.force
    turns = max(s.q_max, 1e-9)
    angular = s.plant.states[s.plant.position][1] == "rad"
    if angular and turns > 1.5:
        count = float(rng.integers(6, 13))
    else:
        count = rng.uniform(2.5, 5.0) * 2.0 * math.pi / turns
    phase = rng.uniform(-math.pi, math.pi)
    f, q, _, _ = _units(s)
    return Drawn(effect, {"ripple": value, "ripple_count": count, "ripple_phase": phase},
                 {"level": (value, f), "wavenumber": (count, f"rad/{q}"), "phase": (phase, "rad")},
                 _axis(s, "position"))


def _end_stop(effect, s, rng, size, beyond):
    place = beyond * s.q_max if beyond else rng.uniform(0.5, 0.7) / size**0.5 * s.q_max
    mass = {"two_link_arm": s.p[0], "hydraulic_cylinder": s.p[0]}.get(s.plant.name, s.p[0])
    stiffness = mass * (2.0 * math.pi / (rng.uniform(10.0, 20.0) * s.plant.ts)) ** 2
    damping = rng.uniform(0.05, 0.15) * 2.0 * math.sqrt(stiffness * mass)
    f, q, v, _ = _units(s)
    return Drawn(effect, {"stop_position": place, "stop_stiffness": stiffness, "stop_damping": damping},
                 {"position": (place, q), "stiffness": (stiffness, f"{f}/{q}"),
                  "damping": (damping, f"{f}/({v})")},
                 _axis(s, "position"))


def _hysteretic(effect, s, rng, size, beyond):
    width = rng.uniform(0.35, 0.7) * s.q_rms
    stiffness = _share(rng, 0.3, 0.55, size, 1.2) * s.force / width
    order = float(rng.integers(1, 3))
    f, q, _, _ = _units(s)
    return Drawn(effect, {"bouc_stiffness": stiffness, "bouc_yield": width, "bouc_order": order},
                 {"stiffness": (stiffness, f"{f}/{q}"), "yield": (width, q), "order": (order, "-")},
                 _axis(s, "position"))


def _compliance(effect, s, rng, size, beyond):
    inertia = rng.uniform(0.3, 0.55) * s.p[0]
    omega = 2.0 * math.pi * rng.uniform(0.35, 0.7) / size**0.3 * s.plant.band[1]
    stiffness = inertia * omega**2
    damping = rng.uniform(0.03, 0.1) * 2.0 * math.sqrt(stiffness * inertia)
    f, q, v, _ = _units(s)
    return Drawn(effect, {"mode_inertia": inertia, "mode_stiffness": stiffness, "mode_damping": damping},
                 {"stiffness": (stiffness, f"{f}/{q}"), "inertia": (inertia, s.plant.params[0].unit),
                  "damping": (damping, f"{f}/({v})")}, _axis(s, "position"))


def _backlash(effect, s, rng, size, beyond):
    twist = s.force / s.p[2]
    gap = _share(rng, 0.6, 2.0, size, 8.0) * twist
    return Drawn(effect, {"half_gap": gap}, {"half_gap": (gap, "rad"), "stiffness": (s.p[2], "N m/rad")},
                 {"kind": "state", "signal": "q_m - q_l", "variables": ["q_m", "q_l"]})


def _missing_inertia(effect, s, rng, size, beyond):
    first = s.plant.params[0]
    extra = _share(rng, 0.2, 0.5, size, 1.0) * s.p[0] * (0.15 if s.plant.name == "two_link_arm" else 1.0)
    return Drawn(effect, {"extra_inertia": extra}, {"inertia": (extra, first.unit)}, _axis(s),
                 trusted=(first.name,))


def _coriolis(effect, s, rng, size, beyond):
    value = s.p[1] * min(size, 1.25)
    return Drawn(effect, {}, {"coefficient": (value, "kg m^2")}, _axis(s), variant=effect, p={"a2": value},
                 nominal_p={"a2": value}, nominal_switches={"coriolis": 0.0})


def _saturation(effect, s, rng, size, beyond):
    reach = s.u_max - abs(s.u_mean)
    limit = abs(s.u_mean) + (beyond * reach if beyond else rng.uniform(0.4, 0.65) / size**0.5 * reach)
    return Drawn(effect, {"limit": limit}, {"limit": (limit, _units(s)[3])}, _input(s))


def _rate_limit(effect, s, rng, size, beyond):
    rate = beyond * 12.0 * s.slope if beyond else rng.uniform(0.35, 0.7) / size * s.slope
    return Drawn(effect, {"rate": rate}, {"rate": (rate, _units(s)[3] + "/s")}, _input(s))


def _deadzone(effect, s, rng, size, beyond):
    width = _share(rng, 0.15, 0.4, size) * s.u_rms
    return Drawn(effect, {"half_width": width}, {"half_width": (width, _units(s)[3])}, _input(s))


def _play(effect, s, rng, size, beyond):
    width = _share(rng, 0.15, 0.35, size) * s.u_rms
    return Drawn(effect, {"play": width}, {"half_width": (width, _units(s)[3])}, _input(s))


def _gain_asymmetry(effect, s, rng, size, beyond):
    half = _share(rng, 0.1, 0.22, size, 0.6) * rng.choice([-1.0, 1.0])
    return Drawn(effect, {"gain_asymmetry": half},
                 {"gain_positive": (1.0 + half, "-"), "gain_negative": (1.0 - half, "-")}, _input(s))


def _load(effect, s, rng, size, beyond):
    value = _share(rng, 0.2, 0.5, size, 1.0) * s.force * rng.choice([-1.0, 1.0])
    return Drawn(effect, {"load": value}, {"level": (value, _units(s)[0])}, _input(s))


def _actuator_lag(effect, s, rng, size, beyond):
    tau = _share(rng, 0.7, 2.0, size, 8.0) / (2.0 * math.pi * s.plant.band[1])
    return Drawn(effect, {"lag": tau}, {"time_constant": (tau, "s")}, _input(s))


def _delay(effect, s, rng, size, beyond):
    substeps = round(_share(rng, 2.2, 6.0, size, 30.0) * 24)
    seconds = substeps / 24 * s.plant.ts
    return Drawn(effect, {"delay_substeps": substeps}, {"delay": (seconds, "s")}, _input(s))


def _channel(s, rng):
    return int(rng.integers(len(s.measured)))


def _sensor(effect, s, rng, size, beyond):
    c = _channel(s, rng)
    unit = s.plant.states[s.measured[c]][1]
    std = s.y_std[c]
    where = _output(s, c)
    base = {"sensor_channel": c}
    if effect == "sensor_saturation":
        reach = s.y_max[c] - abs(s.y_mean[c])
        limit = abs(s.y_mean[c]) + (beyond * reach if beyond else rng.uniform(0.4, 0.65) / size**0.5 * reach)
        return Drawn(effect, base | {"sensor_limit": limit}, {"limit": (limit, unit)}, where)
    if effect == "sensor_rectification":
        return Drawn(effect, base | {"rectified": 1.0}, {}, where)
    if effect == "sensor_quantization":
        step = _share(rng, 0.2, 0.5, size, 1.5) * std
        return Drawn(effect, base | {"quantum": step}, {"step": (step, unit)}, where)
    if effect == "sensor_offset":
        value = _share(rng, 0.2, 0.5, size, 2.0) * std * rng.choice([-1.0, 1.0])
        return Drawn(effect, base | {"offset": value}, {"offset": (value, unit)}, where)
    if effect == "sensor_lag":
        tau = _share(rng, 0.7, 2.0, size, 8.0) / (2.0 * math.pi * s.plant.band[1])
        return Drawn(effect, base | {"sensor_lag": tau}, {"time_constant": (tau, "s")}, where)
    if effect == "sensor_nonlinearity":
        cubic = _share(rng, 0.12, 0.25, size, 0.6) / s.y_max[c] ** 2 * rng.choice([-1.0, 1.0])
        if cubic < 0.0:
            cubic *= 0.7
        return Drawn(effect, base | {"sensor_cubic": cubic}, {"cubic": (cubic, f"1/({unit})^2")}, where)
    slope = _share(rng, 0.8, 1.6, size, 6.0) * std / s.seconds * rng.choice([-1.0, 1.0])
    return Drawn(effect, base | {"drift": slope}, {"slope": (slope, f"{unit}/s")}, where)


def _outflow(effect, s, rng, size, beyond):
    names = ("c",) if s.plant.name == "single_tank" else ("c1", "c2")
    nominal, key = {}, {}
    for i, name in enumerate(names):
        c = s.p[s.plant.index(name)]
        nominal[name] = c / math.sqrt(max(s.x_mean[i], 0.02))
        key[f"coefficient_{i + 1}" if len(names) > 1 else "coefficient"] = (c, "m^2.5/s")
    return Drawn(effect, {}, key, {"kind": "state", "signal": s.plant.states[0][0],
                                   "variables": [n for n, _ in s.plant.states]},
                 variant=effect, nominal_p=nominal, nominal_switches={"square_root": 0.0})


def _head(effect, s, rng, size, beyond):
    head = _share(rng, 0.08, 0.2, size, 1.0)
    signal = s.plant.states[-1][0]
    return Drawn(effect, {"head": head}, {"offset": (head, "m")},
                 {"kind": "state", "signal": signal, "variables": [signal]})


def _leakage(effect, s, rng, size, beyond):
    if s.plant.name == "hydraulic_cylinder":
        leak = s.p[5] * _share(rng, 1.0, 3.0, size, 10.0)
        return Drawn(effect, {}, {"coefficient": (leak, "m^3/s/Pa")},
                     {"kind": "state", "signal": "p", "variables": ["p"]}, variant=effect, p={"leak": leak},
                     nominal_p={"leak": 0.0})
    mean_flow = s.p[s.plant.index("gain")] * s.u_mean
    leak = _share(rng, 0.25, 0.5, size, 2.0) * mean_flow / s.x_mean[0]
    signal = s.plant.states[0][0]
    return Drawn(effect, {"leak": leak}, {"coefficient": (leak, "m^2/s")},
                 {"kind": "state", "signal": signal, "variables": [signal]})


def _overflow(effect, s, rng, size, beyond):
    reach = s.x_max[0] - s.x_mean[0]
    brim = s.x_mean[0] + (beyond * reach if beyond else rng.uniform(0.3, 0.6) / size**0.5 * reach)
    slots, key = {"brim": brim}, {"level": (brim, "m")}
    if s.plant.name == "cascaded_tanks":
        slots["brim_share"] = rng.uniform(0.2, 0.9)
        key["share"] = (slots["brim_share"], "-")
    signal = s.plant.states[0][0]
    return Drawn(effect, slots, key, {"kind": "state", "signal": signal, "variables": [signal]})


def _radiation(effect, s, rng, size, beyond):
    hot, cold = s.x_mean[0] + 273.15, s.p[3] + 273.15
    lost = s.p[1] * (s.x_mean[0] - s.p[3])
    value = _share(rng, 0.5, 1.0, size, 4.0) * lost / (hot**4 - cold**4)
    return Drawn(effect, {"radiation": value}, {"coefficient": (value, "W/K^4")},
                 {"kind": "state", "signal": "T", "variables": ["T"]})


def _second_mass(effect, s, rng, size, beyond):
    capacity = rng.uniform(0.4, 1.0) * size * s.p[0]
    conductance = rng.uniform(0.5, 1.5) * s.p[1]
    return Drawn(effect, {"second_capacity": capacity, "second_conductance": conductance},
                 {"capacity": (capacity, "J/K"), "conductance": (conductance, "W/K")},
                 {"kind": "state", "signal": "T", "variables": ["T"]})


def _tone(effect, s, rng, size, beyond):
    value = _share(rng, 0.25, 0.5, size, 2.0) * s.force
    low, high = s.plant.band
    frequency = low * (high / low) ** rng.uniform(0.35, 0.75)
    phase = rng.uniform(-math.pi, math.pi)
    return Drawn(effect, {"tone": value, "tone_frequency": frequency, "tone_phase": phase},
                 {"level": (value, _units(s)[0]), "frequency": (frequency, "Hz"), "phase": (phase, "rad")},
                 _input(s))


def _parameter_drift(effect, s, rng, size, beyond):
    choice = {"mass_spring_damper": "k", "pendulum": "mgl", "two_mass_drive": "b_m", "two_link_arm": "b1",
              "single_tank": "c", "cascaded_tanks": "c2", "thermal_plant": "G", "dc_motor": "R",
              "rl_circuit": "R", "hydraulic_cylinder": "b"}
    name = choice.get(s.plant.name, "b")
    rate = _share(rng, 0.35, 0.7, size, 3.0) / s.seconds
    return Drawn(effect, {}, {"rate": (rate, "1/s")}, {"kind": "parameter", "signal": name, "variables": ["t"]},
                 drift=(name, rate))


_DRAWS = {
    "coulomb_friction": _coulomb, "asymmetric_coulomb_friction": _asymmetric_coulomb,
    "stribeck_friction": _stribeck,
    "presliding_friction": _presliding, "load_dependent_friction": _load_dependent,
    "viscous_friction": _viscous,
    "asymmetric_viscous_friction": _asymmetric_viscous, "quadratic_drag": _drag,
    "linear_stiffness": _stiffness,
    "cubic_stiffness": _stiffness, "quadratic_stiffness": _stiffness, "gravity_torque": _gravity,
    "position_ripple": _ripple, "end_stop": _end_stop, "hysteretic_spring": _hysteretic,
    "backlash": _backlash,
    "compliance": _compliance, "missing_inertia": _missing_inertia, "coriolis_torque": _coriolis,
    "actuator_saturation": _saturation, "actuator_rate_limit": _rate_limit, "actuator_deadzone": _deadzone,
    "input_play": _play, "actuator_gain_asymmetry": _gain_asymmetry, "constant_load": _load,
    "actuator_lag": _actuator_lag, "input_delay": _delay, "sensor_saturation": _sensor,
    "sensor_rectification": _sensor, "sensor_quantization": _sensor, "sensor_offset": _sensor,
    "sensor_lag": _sensor,
    "sensor_nonlinearity": _sensor, "sensor_drift": _sensor, "square_root_outflow": _outflow,
    "head_offset": _head,
    "leakage": _leakage, "overflow": _overflow, "radiation": _radiation, "second_thermal_mass": _second_mass,
    "periodic_disturbance": _tone, "parameter_drift": _parameter_drift,
}
