"""Classes and cells: what each asks for, how its recipes are drawn, and when a drawn case belongs to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from concealed.case import STRANGERS, Recipe, Rejected, build
from concealed.catalogue import COMPLETED_BY, CONTAINED_IN, FAMILY, IDS, THRESHOLDS
from concealed.plants import PLANTS
from concealed.seeds import turn_of
from concealed.visibility import measure

CELLS = ("rich", "hard")
HEADLINE = ("single", "pair", "clean", "parameters", "initial_state", "unexcited", "out_of_catalogue",
            "left_out")
CONCEALED = ("concealed_controller", "concealed_parameter", "concealed_noise", "concealed_mask",
             "concealed_output")
CLASSES = HEADLINE + CONCEALED
CONDITIONS = ("closed_loop", "sine", "disturbance")

SEEN = 3.0  # an effect counts as visible when it leaves this many times the sensor noise after the best refit
SEEN_HELD_OUT = 1.5
ABOVE_DISTURBANCE = 1.5  # and this many times what the unknown disturbance does to the output
SEEN_OVER_NESTED = 1.0  # what richer dry friction leaves after plain Coulomb friction has been fitted
ATTEMPTS = 40
GROWTH = (1.0, 1.0, 1.25, 1.5, 1.5, 2.0, 2.0, 3.0)

TWO_OUTPUTS = ("constant_load", "actuator_lag", "sensor_lag", "sensor_offset", "sensor_drift")
NOT_IN_PAIRS = ("parameter_drift", "sensor_quantization", "sensor_rectification", "periodic_disturbance",
                "viscous_friction")
ABSORBED = ("quadratic_drag", "coulomb_friction", "cubic_stiffness", "sensor_nonlinearity", "input_delay",
            "actuator_lag", "leakage", "radiation", "asymmetric_viscous_friction", "actuator_saturation")
REJECTED_BY_LOOP = ("coulomb_friction", "quadratic_drag", "constant_load", "actuator_deadzone",
                    "position_ripple",
                    "actuator_gain_asymmetry", "stribeck_friction", "leakage", "overflow", "radiation")
LOAD_SIDE = ("coulomb_friction", "stribeck_friction", "quadratic_drag", "position_ripple",
             "presliding_friction")

# On linear plants some effects give the very same outputs; the key lists them, the scorer accepts either.
LINEAR = ("rotary_drive", "linear_drive", "mass_spring_damper", "two_mass_drive", "thermal_plant",
          "rl_circuit",
          "dc_motor", "hydraulic_cylinder")


def generate(name, cell, index, seed):
    """One case of class `name` in `cell`; deterministic in `seed`.

    Returns
    -------
    case : Case
        With margins filled in.
    """
    order, turn = np.random.default_rng(20261122).permutation(len(IDS)), turn_of(seed)
    index = _turned(name, cell, index, turn)
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, attempt])
        size = GROWTH[min(attempt, len(GROWTH) - 1)]
        recipe = _recipe(name, cell, index, attempt, size, rng, order, turn)
        try:
            case = build(recipe, rng)
            measure(case)
            _accept(name, cell, case)
        except Rejected:
            continue
        case.facts["attempts"] = attempt + 1
        return case
    message = f"class {name}, cell {cell}, seed {seed}: no case in {ATTEMPTS} draws"
    raise RuntimeError(message + "; widen the recipe")


def _turned(name, cell, index, turn):
    """Where a case stands in the lists of effects: sets of few cases differ in what they hold, and so do cells."""
    return index + 13 * turn + (len(IDS) // 2 if turn and name == "left_out" and cell == "hard" else 0)


def _plants_with(effects, rng, among=None):
    fits = [n for n, p in PLANTS.items() if all(e in p.effects for e in effects)
            and (among is None or n in among)]
    return str(rng.choice(fits)) if fits else None


def _recipe(name, cell, index, attempt, size, rng, order, turn):
    effects = _effects(name, index, size, rng, order)
    wanted = [e for e, _ in effects]
    among = ("two_mass_drive",) if name == "concealed_output" else None
    plant = _plants_with(wanted, rng, among)
    if name == "out_of_catalogue" and STRANGERS[index % len(STRANGERS)] == "torque_speed_limit":
        plant = str(rng.choice(["rotary_drive", "linear_drive", "two_mass_drive", "dc_motor"]))
    kinds = len(STRANGERS) if turn and name == "out_of_catalogue" else len(IDS)
    condition = CONDITIONS[(index + index // kinds + turn) % 3] if cell == "hard" else ""
    recipe = Recipe(plant=plant, excitation=str(rng.choice(["multisine", "multisine", "steps"])),
                    noise=rng.uniform(0.01, 0.05), effects=tuple(effects),
                    hold="first" if cell == "rich" and rng.uniform() < 0.1 else "zero",
                    repeats=rng.uniform() < (0.25 if cell == "rich" else 0.4), floor=rng.uniform() < 0.3)
    if attempt > 5 or "sensor_quantization" in wanted:
        recipe = replace(recipe, noise=rng.uniform(0.01, 0.02))
    recipe = replace(recipe, measured=_measured(PLANTS[plant], wanted, condition, rng, name, effects))
    if cell == "hard":
        recipe = _harder(recipe, condition, rng)
    recipe = _special(name, index, recipe, rng)
    if recipe.excitation == "closed_loop":  # a controller holds its command, and never gives the same one twice
        recipe = replace(recipe, hold="zero", repeats=False)
    return recipe


def _effects(name, index, size, rng, order):
    """Ids and size factors for one draw of the class."""
    if name in ("single", "left_out"):
        return [(IDS[order[index % len(IDS)]], size)]
    if name == "pair":
        return _pair(rng, size)
    if name == "concealed_mask":
        (big, _), (small, _) = _pair(rng, size)
        return [(big, 1.5), (small, 0.35 * size)]
    if name == "unexcited":
        return [(THRESHOLDS[index % len(THRESHOLDS)], 1.0)]
    pools = {"concealed_controller": REJECTED_BY_LOOP, "concealed_parameter": ABSORBED,
             "concealed_output": LOAD_SIDE}
    if name in pools:
        return [(pools[name][index % len(pools[name])], size)]
    if name == "concealed_noise":
        return [(IDS[int(rng.integers(len(IDS)))], 1.0)]
    return []


def _pair(rng, size):
    plant = PLANTS[str(rng.choice(list(PLANTS)))]
    pool = [e for e in plant.effects if e not in NOT_IN_PAIRS]
    while True:
        a, b = (str(e) for e in rng.choice(pool, 2, replace=False))
        if FAMILY[a] != FAMILY[b]:
            return [(a, size), (b, size)]


def _measured(plant, wanted, condition, rng, name, effects):
    """Label of the measured set; effects that one output cannot tell from another mostly get two."""
    labels = list(plant.measured)
    if name == "concealed_output":
        return "motor_velocity"
    if condition == "closed_loop" or name == "concealed_controller":
        labels = [k for k in labels if k not in ("current",) or plant.name == "rl_circuit"]
    if plant.name == "two_mass_drive" and "backlash" in wanted:
        labels = [k for k in labels if k.startswith("both")]
    rich = [k for k in labels if len(plant.measured[k]) > 1]
    if rich and any(e in TWO_OUTPUTS for e in wanted):
        labels = rich
    return str(rng.choice(labels))


def _harder(recipe, condition, rng):
    recipe = replace(recipe, noise=rng.uniform(0.01, 0.02))
    if condition == "disturbance":
        return replace(recipe, disturbance=rng.uniform(0.05, 0.1), coloured_sensor=rng.uniform() < 0.3)
    return replace(recipe, excitation=condition)


def _special(name, index, recipe, rng):
    if name == "clean":
        return replace(recipe, parameter_error=False)
    if name == "initial_state":
        return replace(recipe, parameter_error=False, state_error=True)
    if name == "unexcited":
        return replace(recipe, beyond=rng.uniform(1.25, 1.7))
    if name == "out_of_catalogue":
        return replace(recipe, stranger=STRANGERS[index % len(STRANGERS)])
    if name == "concealed_controller":
        return replace(recipe, excitation="closed_loop", noise=rng.uniform(0.01, 0.02))
    if name == "concealed_parameter":
        return replace(recipe, excitation="sine", same_amplitude=True, noise=rng.uniform(0.01, 0.02))
    if name == "concealed_noise":
        return replace(recipe, noise=rng.uniform(0.06, 0.15))
    if name == "concealed_output":
        return replace(recipe, load_side=True)
    return recipe


def _accept(name, cell, case):
    """Raise `Rejected` unless the case is what its class says."""
    margins = case.margins.values()
    held = case.heldout_margins.values()
    if name in ("single", "pair", "left_out", "out_of_catalogue"):
        if name == "out_of_catalogue" and case.recipe.stranger == "output_dropout":
            return
        floor = ABOVE_DISTURBANCE * case.facts["disturbance_ratio"]
        _need(min(margins) >= max(SEEN, floor), "the effect is too small to be seen")
        _need(min(case.nested.values(), default=np.inf) >= max(SEEN_OVER_NESTED, floor / SEEN),
              "plain Coulomb friction imitates the effect")
        _need(min(held) >= max(SEEN_HELD_OUT, 0.5 * floor),
              "the effect is too small on the held-out recordings")
    elif name == "parameters":
        _need(case.facts["nominal_ratio"] >= SEEN, "the parameter errors do not show")
        _need(case.margins["everything"] < 1.2, "more than parameters is wrong")
    elif name in ("clean", "initial_state"):
        _need(case.margins["everything"] < 1.2, "something shows")
    elif name == "unexcited":
        _need(max(margins) < 0.3 and max(held) < 0.3, "the effect shows")
    elif name == "concealed_controller":
        _need(min(margins) >= 1.0, "nothing left to see")
    elif name == "concealed_parameter":
        _need(min(margins) >= 1.5 and case.facts["nominal_ratio"] > 3.0 * min(margins), "not absorbed")
    elif name == "concealed_noise":
        _need(0.4 <= min(margins) <= 1.6, "not of the size of the noise")
    elif name == "concealed_mask":
        big, small = case.margins.values()
        _need(small >= 1.5 and big >= 4.0 * small, "no masking")
    else:
        _need(0.7 <= min(margins) <= 3.0, "not barely visible")


def _need(condition, why):
    if not condition:
        raise Rejected(why)


def equivalents(case):
    """Ids whose law gives the very same outputs as the truth on these recordings, per true effect."""
    out = {}
    single = len(case.measured) == 1
    linear = case.plant.name in LINEAR
    for d in case.drawn:
        same = []
        if single and linear and d.id in ("actuator_lag", "sensor_lag"):
            same = ["actuator_lag", "sensor_lag"]
        if d.id in ("head_offset", "sensor_offset") and case.plant.name in ("single_tank", "cascaded_tanks"):
            same = ["head_offset", "sensor_offset"]
        drifting = ("constant_load", "sensor_drift")
        steady = case.plant.name in ("mass_spring_damper", "thermal_plant")
        if linear and d.id in ("constant_load", "sensor_offset") and (steady or (single and _is_speed(case))):
            same = ["constant_load", "sensor_offset"]
        if linear and single and not _is_speed(case) and d.id in drifting and not steady:
            same = list(drifting)
        out[d.id] = [s for s in same if s != d.id]
    return out


def _is_speed(case):
    return case.plant.velocity in case.measured or case.plant.position < 0


def left_out_ids(case):
    """Ids left out of the catalogue: the truth, its doubles, the laws that contain it, and what makes it of others.

    On a linear plant loads at several equations make the offset of any reading.
    """
    out = []
    for d in case.drawn:
        out += [d.id, *CONTAINED_IN.get(d.id, ()), *COMPLETED_BY.get(d.id, ()), *equivalents(case)[d.id]]
        if d.id == "sensor_offset" and case.plant.name in LINEAR:
            out.append("constant_load")
    return out
