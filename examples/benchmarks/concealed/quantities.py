"""Numbers of the key in the words of the catalogue (`pwaid effects`), and how far a report is from them.

The key describes the truth as physics (an inertia, a spring, a heat capacity); the catalogue describes laws (a share,
a frequency, a rate). Each effect has one function here that turns the first into the second with the true nominal
parameters, so that no alias has to be guessed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

# Reported, but not part of the parameter error: badly determined by nature, or phases.
MINOR = ("damping", "damping_ratio", "share", "phase", "ambient", "amplitude_sin", "amplitude_cos")
SIDED = {"end_stop": ("position",), "sensor_saturation": ("limit",)}  # one-sided forms count from the other side


@dataclass
class Comparison:
    """Relative error and 90 % coverage per number, `id.name`; `unmatched` are numbers the report does not give."""

    errors: dict = field(default_factory=dict)
    covered: dict = field(default_factory=dict)
    unmatched: list = field(default_factory=list)


def expected(truth, entry, match=None):
    """The true numbers of one effect under the catalogue's names.

    Parameters
    ----------
    truth : dict
        One of the key entry's `effects`.
    entry : dict
        The key's entry; `parameters_true` holds the plant's true parameters.
    match : dict, optional
        The effect as reported: some laws have several forms, told apart by `law`, `where` or the parameters given.

    Returns
    -------
    dict
        Name -> value. Empty when the reported form of the law has no number in common with the truth.
    """
    values = {k: n["value"] for k, n in truth["parameters"].items()}
    rule = _RULES.get(truth["id"])
    return rule(values, entry, match or {}) if rule else values


def compare(truth, entry, report):
    """Compare the numbers of one true effect with the report that names it."""
    out = Comparison()
    match = next(e for e in report["effects"] if e["id"] == truth["id"])
    derive = _DERIVED.get(truth["id"])
    got = derive(match, report) if derive else match.get("parameters", {})
    for name, want in expected(truth, entry, match).items():
        label = f"{truth['id']}.{name}"
        value = got.get(name)
        if value is None or value.get("value") is None:
            out.unmatched.append(label)
            continue
        want = _in_unit(truth, want, value)
        if name == "phase":
            off = (value["value"] - want + math.pi) % (2.0 * math.pi) - math.pi
            out.errors[label] = abs(off) / math.pi
            continue
        low, high, found = value.get("low"), value.get("high"), value["value"]
        if name in SIDED.get(truth["id"], ()):
            found = abs(found)
            low, high = sorted((abs(low), abs(high))) if None not in (low, high) else (low, high)
        out.errors[label] = abs(found - want) / max(abs(want), 1e-300)
        if low is not None and high is not None:
            out.covered[label] = bool(low <= want <= high)
    return out


def primary(found):
    """Errors, or coverage, of the numbers that define an effect (damping, phases, shares of a spill left out)."""
    return [v for label, v in found.items() if label.split(".")[1] not in MINOR]


def _in_unit(truth, want, value):
    """The true value in the unit of the report, when the key offers its numbers in that unit; else as it stands."""
    for source in truth["parameters"].values():
        for option in source.get("also", []):
            if value.get("unit") == option["unit"] and option["unit"] != source["unit"]:
                return want * option["value"] / source["value"]
    return want


def _renamed(**names):
    return lambda v, entry, match: {new: v[old] for old, new in names.items()}


def _stribeck(v, entry, match):
    return {"level": v["level"], "excess": v["static"] - v["level"], "stribeck_speed": v["velocity"]}


def _asymmetric_viscous(v, entry, match):
    """What both directions share is the nominal coefficient, which is refitted: only the difference is the effect."""
    return {"difference": v["positive"] - v["negative"]}


def _hysteretic(v, entry, match):
    return {"force": v["stiffness"] * v["yield"], "yield_displacement": v["yield"], "order": v["order"]}


def _compliance(v, entry, match):
    whole = next(iter(entry["parameters_true"].values()))  # every plant lists its inertia first
    return {"load_share": v["inertia"] / whole, "frequency": math.sqrt(v["stiffness"] / v["inertia"]),
            "damping_ratio": v["damping"] / (2.0 * math.sqrt(v["stiffness"] * v["inertia"]))}


def _coriolis(v, entry, match):
    """The product of both speeds appears twice in the equations of an arm, a squared speed once; as a multiple of what
    the simulator's own inertia asks for, the coefficient is 1."""
    if "own inertia" in match.get("law", ""):
        return {"coefficient": 1.0}
    speeds = [n for n in match.get("where", {}).get("variables", []) if "(" not in n]
    return {"coefficient": v["coefficient"] * (2.0 if len(set(speeds)) == 2 else 1.0)}


def _gain_asymmetry(v, entry, match):
    plus, minus = v["gain_positive"], v["gain_negative"]
    return {"asymmetry": (plus - minus) / (plus + minus)} if "sign(u)" in match.get("law", "sign(u)") else {}


def _sensor_nonlinearity(v, entry, match):
    return {"coefficient": v["cubic"]} if "^3" in match.get("law", "y^3") else {}


def _leakage(v, entry, match):
    p = entry["parameters_true"]
    if entry["plant"] == "hydraulic_cylinder":
        return {"coefficient": v["coefficient"] * p["stiffness"]}
    return {"coefficient": v["coefficient"] / p["area" if "area" in p else "area1"]}


def _head(v, entry, match):
    both = "second_offset" in match.get("parameters", {})
    return {"second_offset" if both else "offset": v["offset"]}


def _outflow(v, entry, match):
    """k·sqrt(reference·h) = c·sqrt(h): the coefficient c of the tank, or of both tanks, that the report speaks of."""
    if "second_reference" in match.get("parameters", {}):
        return {"outlet": v["coefficient_1"], "second_outlet": v["coefficient_2"]}
    upper = match.get("where", {}).get("signal") == "h1"
    return {"outlet": v["coefficient" if "coefficient" in v else "coefficient_1" if upper else "coefficient_2"]}


def _radiation(v, entry, match):
    p = entry["parameters_true"]
    return {"coefficient": v["coefficient"] / p["C"] * 300.0**4 / 75.0, "ambient": p["T_a"]}


def _second_mass(v, entry, match):
    return {"coupling_rate": v["conductance"] / entry["parameters_true"]["C"],
            "time_constant": v["capacity"] / v["conductance"]}


def _tone(v, entry, match):
    return {"angular_frequency": 2.0 * math.pi * v["frequency"], "level": v["level"],
            "amplitude_sin": v["level"] * math.cos(v["phase"]), "amplitude_cos": v["level"] * math.sin(v["phase"])}


_RULES = {
    "stribeck_friction": _stribeck, "load_dependent_friction": _renamed(factor="load_factor"),
    "asymmetric_viscous_friction": _asymmetric_viscous,
    "quadratic_stiffness": _renamed(stiffness="coefficient"), "cubic_stiffness": _renamed(stiffness="coefficient"),
    "gravity_torque": _renamed(level="torque", phase="phase"), "hysteretic_spring": _hysteretic,
    "backlash": _renamed(half_gap="half_gap"), "compliance": _compliance, "coriolis_torque": _coriolis,
    "input_play": _renamed(half_width="half_gap"), "actuator_gain_asymmetry": _gain_asymmetry,
    "sensor_nonlinearity": _sensor_nonlinearity, "sensor_drift": _renamed(slope="rate"),
    "square_root_outflow": _outflow, "head_offset": _head, "leakage": _leakage, "radiation": _radiation,
    "second_thermal_mass": _second_mass, "periodic_disturbance": _tone,
}


def _difference(match, report):
    """Difference of the two coefficients; it has no interval of its own."""
    got = match.get("parameters", {})
    plus, minus = got.get("coefficient_positive"), got.get("coefficient_negative")
    if plus is None or minus is None or None in (plus["value"], minus["value"]):
        return got
    return {"difference": {"value": plus["value"] - minus["value"], "unit": plus.get("unit")}}


def _magnitude(match, report):
    """The sign of a Coriolis term follows from the order of the joints; its size is compared."""
    got = match.get("parameters", {}).get("coefficient")
    if got is None or got.get("value") is None:
        return {}
    low, high = got.get("low"), got.get("high")
    if None in (low, high) or low <= 0.0 <= high:
        return {"coefficient": {"value": abs(got["value"])}}
    low, high = sorted((abs(low), abs(high)))
    return {"coefficient": {"value": abs(got["value"]), "low": low, "high": high}}


def _outlet(match, report):
    """The outlet coefficients from the refitted linear ones and the reference levels."""
    signal = match.get("where", {}).get("signal")
    found, got = {}, match.get("parameters", {})
    for outlet, of, name in (("outlet", "reference", {"h": "c", "h1": "c1", "h2": "c2"}.get(signal)),
                             ("second_outlet", "second_reference", "c2")):
        linear = report.get("parameters", {}).get(name, {}).get("refitted")
        reference = got.get(of, {}).get("value")
        if linear is not None and reference is not None and reference >= 0.0:
            found[outlet] = {"value": linear * math.sqrt(reference)}
    return found


def _amplitude(match, report):
    """Both quadrature amplitudes, and their length as `level`."""
    got = match.get("parameters", {})
    pair = [got.get(n, {}).get("value") for n in ("amplitude_sin", "amplitude_cos")]
    if None in pair:
        return got
    return got | {"level": {"value": math.hypot(*pair), "unit": got["amplitude_sin"].get("unit")}}


_DERIVED = {"asymmetric_viscous_friction": _difference, "coriolis_torque": _magnitude,
            "square_root_outflow": _outlet, "periodic_disturbance": _amplitude}
