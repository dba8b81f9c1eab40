"""Counts with Wilson intervals and medians per cell and class, and the targets of issue 6."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from concealed.classes import CONCEALED
from concealed.quantities import primary
from concealed.wilson import wilson

SINGLE = ("exact_first", "exact_strict", "in_set", "family", "refused", "extra_name", "wrong_name")
PAIR = ("both", "both_family", "in_set", "refused", "wrong_name")
QUIET = ("false_name", "absent_name", "quiet")
REFUSE = ("refused", "unexplained")
MEASURES = {"single": SINGLE, "pair": PAIR, "clean": QUIET, "parameters": QUIET, "initial_state": QUIET,
            "unexcited": QUIET, "out_of_catalogue": REFUSE, "left_out": REFUSE}
RIGHT = {"single": "exact_first", "pair": "both", "clean": "quiet", "parameters": "quiet", "initial_state": "quiet",
         "unexcited": "quiet", "out_of_catalogue": "refused", "left_out": "refused"}
PAIRED = ("pair", "concealed_mask")

# The rows of issue 6: (row, class, measure, target in the rich cell, in the hard cell). "min" and "max" bound from
# below and from above, "within" from both sides.
ROWS = (
    ("exact name first", "single", "exact_first", "min", 0.92, 0.80),
    ("truth in the returned set of at most 3", "single", "in_set", "min", 0.99, 0.95),
    ("family right", "single", "family", "min", 0.98, 0.92),
    ("both effects of a pair", "pair", "both", "min", 0.80, 0.55),
    ("false name on clean data", "clean", "false_name", "max", 0.02, 0.05),
    ("false name on parameter errors only", "parameters", "false_name", "max", 0.05, 0.05),
    ("refuses out of catalogue: strangers", "out_of_catalogue", "refused", "min", 0.95, 0.80),
    ("refuses out of catalogue: truth left out", "left_out", "refused", "min", 0.95, 0.80),
    ("refuses needlessly", "single", "refused", "max", 0.10, 0.30),
    ("explainable held-out error removed when named (median)", "single", "removed_median", "min", 0.90, 0.70),
    ("effect parameter error (median)", "single", "parameter_error_median", "max", 0.03, 0.15),
    ("90 % intervals cover the truth", "single", "coverage", "within", (0.85, 0.95), (0.80, 0.97)),
)


def right(verdict):
    """Is the answer the right one? Effects concealed on purpose need no name, only never a wrong one."""
    name = verdict.entry["class"]
    if name in RIGHT:
        return verdict.facts[RIGHT[name]]
    return not (verdict.facts["wrong_name"] or verdict.facts["failed"])


def measures_of(name):
    """Measures that are counted for a class."""
    return MEASURES.get(name, PAIR if name in PAIRED else SINGLE)


def summarise(verdicts):
    """Counts with Wilson intervals and medians for a list of verdicts of one class."""
    name, n = verdicts[0].entry["class"], len(verdicts)
    out = {"n": n, "failed_runs": sum(v.facts["failed"] for v in verdicts),
           "right": sum(bool(right(v)) for v in verdicts)}
    for measure in measures_of(name):
        out[measure] = _proportion(sum(bool(v.facts[measure]) for v in verdicts), n)
    removed = [v.removed for v in verdicts if v.removed is not None]
    errors = [e for v in verdicts for e in primary(v.errors)]
    covered = [c for v in verdicts for c in primary(v.covered)]
    anyhow = [v.removed_any for v in verdicts if v.removed_any is not None]
    if removed:
        out["removed_median"] = round(float(np.median(removed)), 4)
    if anyhow:
        out["removed_any_median"] = round(float(np.median(anyhow)), 4)
    if errors:
        out["parameter_error_median"] = round(float(np.median(errors)), 4)
    if covered:
        out["coverage"] = _proportion(sum(covered), len(covered))
    out["unmatched_parameters"] = sorted({u for v in verdicts for u in v.unmatched})
    out["seconds_median"] = round(float(np.median([v.seconds for v in verdicts])), 2)
    return out


def _proportion(hits, n):
    low, high = wilson(hits, n)
    return {"hits": hits, "n": n, "rate": round(hits / n, 4), "low": round(low, 4), "high": round(high, 4)}


def grouped(verdicts):
    """Dict "cell/class" -> summary, with the hard cell also split by condition."""
    groups = defaultdict(list)
    for v in verdicts:
        cell, name = v.entry["cell"], v.entry["class"]
        if name in CONCEALED:
            groups[f"concealed/{name}"].append(v)
            continue
        groups[f"{cell}/{name}"].append(v)
        if cell == "hard":
            groups[f"hard:{v.entry['condition']}/{name}"].append(v)
    return {label: summarise(group) for label, group in sorted(groups.items())}


def met(kind, bound, value):
    """Does a measured value meet its target?"""
    if kind == "within":
        return bound[0] <= value <= bound[1]
    return value >= bound if kind == "min" else value <= bound


def failures(verdicts, reasons):
    """One row per case that is not right: what it was, what was said, and the reason when one is written down."""
    rows = []
    for v in verdicts:
        if right(v):
            continue
        entry = v.entry
        rows.append({
            "case": v.case, "cell": "concealed" if entry["class"] in CONCEALED else entry["cell"],
            "class": entry["class"], "plant": entry["plant"], "condition": entry["condition"],
            "measured": entry["measured"], "noise": entry["noise"],
            "truth": [e["id"] for e in entry["effects"]] or [entry["stranger"] or "nothing"],
            "size": entry["detectability"], "verdict": v.verdict, "answer": v.ids,
            "reason": reasons.get(v.case, ""),
        })
    return rows
