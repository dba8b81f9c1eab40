"""Judge one report against one entry of the key. No tables here: only what is right and what is wrong."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

from concealed.quantities import compare

NAMING = ("named", "one_of")
LARGEST_SET = 3


@dataclass
class Verdict:
    """What one report got right.

    `removed` is counted for right names, `removed_any` for every report that holds fits; `errors` and `covered` hold
    one entry per parameter that could be compared.
    """

    case: str
    entry: dict
    verdict: str
    ids: list
    seconds: float
    facts: dict = field(default_factory=dict)
    removed: float | None = None
    removed_any: float | None = None
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
    small = len(set(ids)) <= LARGEST_SET
    groups = [[ids[i] for i in g] for g in (report or {}).get("alternatives") or [range(len(ids))]] if ids else []
    alien = [i for i in ids if not any(i in a for a in accepted)]
    out.facts = {
        "named": bool(ids),
        "failed": verdict == "failed",
        "unexplained": verdict == "unexplained",
        "quiet": verdict in ("agreement", "parameters_only"),
        "exact_first": bool(ids) and any(ids[0] in a for a in accepted),
        "exact_strict": bool(ids) and any(ids[0] == t["id"] for t in truths),
        "in_set": small and any(a & set(ids) for a in accepted),
        "family": bool(ids) and any(families.get(ids[0], "") in k for k in kin),
        "both": small and len(truths) == 2 and any(_both(accepted, g) for g in groups),
        "both_family": small and len(truths) == 2 and all(k & named_families for k in kin),
        "extra_name": verdict == "named" and len(ids) > max(len(truths), 1),
        "wrong_name": bool(alien) if verdict == "named" else bool(ids) and len(alien) == len(ids),
    }
    if report is None:
        return out
    out.removed_any = removed_share(entry, report)
    if out.facts["exact_first"] and verdict == "named":
        out.removed = out.removed_any
        for truth in truths:
            if truth["id"] in ids:
                numbers = compare(truth, entry, report)
                out.errors |= numbers.errors
                out.covered |= numbers.covered
                out.unmatched += numbers.unmatched
    return out


def _both(accepted, group):
    """Whether one alternative of an answer names both effects, each by a name of its own."""
    a, b = accepted
    return any(i in a and j in b for i, j in itertools.permutations(group, 2))


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
