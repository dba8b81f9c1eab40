"""Judge one report against one entry of the key. No tables here: only what is right and what is wrong."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

NAMING = ("named", "one_of")
LARGEST_SET = 3
MINOR = ("damping", "order", "phase", "share")  # reported, but not part of the parameter error

# Names that a report may use for a number of the key, per key name.
ALIASES = {
    "level": ("level", "offset", "load", "amplitude", "force", "torque"),
    "level_positive": ("level_positive", "positive", "level_plus"),
    "level_negative": ("level_negative", "negative", "level_minus"),
    "static": ("static", "static_level", "breakaway"), "velocity": ("velocity", "stribeck_velocity"),
    "factor": ("factor", "coefficient", "ratio", "gain"), "coefficient": ("coefficient", "b", "c", "k",
                                                                          "value"),
    "half_width": ("half_width", "width", "half_gap"), "half_gap": ("half_gap", "gap", "half_width"),
    "limit": ("limit", "level"), "rate": ("rate", "limit"), "delay": ("delay", "seconds"),
    "time_constant": ("time_constant", "tau"), "stiffness": ("stiffness", "k", "coefficient", "sigma"),
    "position": ("position", "gap", "limit"), "inertia": ("inertia", "mass", "extra_inertia", "load_inertia"),
    "offset": ("offset", "head", "level"), "step": ("step", "quantum", "resolution"),
    "cubic": ("cubic", "coefficient"),
    "slope": ("slope", "rate", "drift"), "capacity": ("capacity", "heat_capacity"),
    "conductance": ("conductance", "coupling"), "yield": ("yield", "yield_displacement"),
    "wavenumber": ("wavenumber", "count", "order", "frequency"), "frequency": ("frequency",),
    "relative_change": ("relative_change", "change"), "coefficient_1": ("coefficient_1", "coefficient"),
    "coefficient_2": ("coefficient_2",),
}
TOTALS = {"asymmetric_viscous_friction": ("difference", "positive", "negative"),
          "actuator_gain_asymmetry": ("ratio", "gain_positive", "gain_negative")}


@dataclass
class Verdict:
    """What one report got right. `errors` and `covered` hold one entry per parameter that could be
    compared."""

    case: str
    entry: dict
    verdict: str
    ids: list
    seconds: float
    facts: dict = field(default_factory=dict)
    removed: float | None = None
    errors: dict = field(default_factory=dict)
    covered: dict = field(default_factory=dict)
    unmatched: list = field(default_factory=list)


def judge(case, entry, report, families):
    """Compare a report (or None when the run failed) with the key's entry."""
    verdict = "failed" if report is None else report["verdict"]
    found = [] if report is None or verdict not in NAMING else report.get("effects", [])
    ids = [e["id"] for e in found]
    out = Verdict(case, entry, verdict, ids, 0.0 if report is None else float(report.get("seconds",
                                                                                         math.nan)))
    truths = entry["effects"]
    accepted = [{t["id"], *t["equivalents"]} for t in truths]
    kin = [{families.get(i, "") for i in a} for a in accepted]
    named_families = {families.get(i, "") for i in ids}
    small = len(ids) <= LARGEST_SET
    out.facts = {
        "named": bool(ids),
        "failed": verdict == "failed",
        "unexplained": verdict == "unexplained",
        "quiet": verdict in ("agreement", "parameters_only"),
        "exact_first": bool(ids) and any(ids[0] in a for a in accepted),
        "exact_strict": bool(ids) and any(ids[0] == t["id"] for t in truths),
        "in_set": small and any(a & set(ids) for a in accepted),
        "family": bool(ids) and any(families.get(ids[0], "") in k for k in kin),
        "both": small and len(truths) == 2 and all(a & set(ids) for a in accepted),
        "both_family": small and len(truths) == 2 and all(k & named_families for k in kin),
        "extra_name": verdict == "named" and len(ids) > max(len(truths), 1),
        "wrong_name": bool(ids) and not any(a & set(ids) for a in accepted),
    }
    if report is not None and out.facts["exact_first"] and verdict == "named":
        out.removed = removed_share(entry, report)
        for truth in truths:
            match = next((e for e in found if e["id"] == truth["id"]), None)
            if match is not None:
                _numbers(out, truth, match)
    return out


def removed_share(entry, report):
    """Share of the explainable held-out squared error that the repair removes, outputs in units of their
    noise.

    The floor is the distance of the recording from the noise-free truth under the same input.
    """
    before = after = 0.0
    for name, outputs in report.get("fit", {}).items():
        floors = entry["floor_rmse"].get(name)
        if floors is None or not name.startswith("test"):
            continue
        for signal, rows in outputs.items():
            if signal not in floors or "rmse" not in rows.get("refitted",
                                                              {}) or "rmse" not in rows.get("repaired", {}):
                continue
            weight = 1.0 / entry["sigma"][signal] ** 2
            before += weight * (rows["refitted"]["rmse"] ** 2 - floors[signal] ** 2)
            after += weight * (rows["refitted"]["rmse"] ** 2 - rows["repaired"]["rmse"] ** 2)
    return after / before if before > 0.0 else None


def _numbers(out, truth, match):
    """Parameter errors and interval coverage of one named effect."""
    true, got = truth["parameters"], match.get("parameters", {})
    if truth["id"] in TOTALS:
        kind, plus, minus = TOTALS[truth["id"]]
        a, b = _find(plus, got), _find(minus, got)
        if a is None or b is None:
            out.unmatched.append(f"{truth['id']}.{kind}")
            return
        want = _total(kind, true[plus]["value"], true[minus]["value"])
        out.errors[f"{truth['id']}.{kind}"] = abs(_total(kind, a["value"], b["value"]) - want) / abs(want)
        return
    for name, number in true.items():
        label = f"{truth['id']}.{name}"
        value = _find(name, got)
        if value is None or value.get("value") is None:
            out.unmatched.append(label)
            continue
        want = _same_unit(number, value)
        if name == "phase":
            off = (value["value"] - want + math.pi) % (2.0 * math.pi) - math.pi
            out.errors[label] = abs(off) / math.pi
        else:
            out.errors[label] = abs(value["value"] - want) / max(abs(want), 1e-300)
            if value.get("low") is not None and value.get("high") is not None:
                out.covered[label] = bool(value["low"] <= want <= value["high"])


def _total(kind, a, b):
    return a - b if kind == "difference" else a / b


def _find(name, got):
    for alias in ALIASES.get(name, (name,)):
        if alias in got:
            return got[alias]
    return got.get(name)


def _same_unit(number, value):
    """The true value in the unit of the report, when the key offers it in that unit; else as it stands."""
    for option in number.get("also", []):
        if value.get("unit") == option["unit"] and option["unit"] != number["unit"]:
            return option["value"]
    return number["value"]


def primary(errors):
    """Errors of the numbers that define an effect (damping ratios, orders, phases left out)."""
    return [v for label, v in errors.items() if label.split(".")[1] not in MINOR]
