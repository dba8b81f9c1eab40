"""Measure the 90 % intervals of `pwaid.mismatch` on calibration cases, never on score cases.

Reads the fits that `calibrate_decisions.py` keeps in OUT (or makes them), takes every case whose true effect is named
alone, and prints per parameter: its error, the half-width, and the width that would have been needed, in half-widths,
with the block sandwich alone and with the whole interval. Then coverage per cell, the median widening, and the
processor time. Cases with index below --split were used to set the factor in `pwaid.mismatch.discrepancy`, the others
were held back. Numbers without an interval are not counted.

    python examples/benchmarks/calibrate_intervals.py SET [SET ...] [--out DIR] [--split 42] [--part tuned|held_back]

SET is a folder made by the case generator with `--set calibration --classes single`; its key lies in SET-key/key.json.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from calibrate_decisions import evidence_of, key_of
from concealed.quantities import compare
from concealed.seeds import SLOT
from scipy.stats import t as student

from pwaid.mismatch.decide import decide
from pwaid.mismatch.intervals import covariance, feedback_widening, parameter_intervals
from pwaid.mismatch.normal import normal_equations
from pwaid.mismatch.report import effect_entries, parameter_entries

RATIOS = np.logspace(-2, 4, 181)  # of the half-width; the smallest that covers is the width needed


def named(evidence, entry):
    """The decided hypothesis when it names the one true effect first, as the score counts; None otherwise."""
    decision = decide(evidence.problem, evidence.null, evidence.singles, evidence.pairs)
    truth = entry["effects"][0]["id"]
    if decision.verdict == "named" and truth in decision.members[0].ids:
        return decision.members[0]
    return None


def sandwich(problem, fit):
    """Half-widths of the block sandwich alone."""
    C = covariance(problem, normal_equations(problem, fit))
    return student.ppf(0.95, 20) * np.sqrt(np.maximum(np.diag(C), 0)) * feedback_widening(problem, fit)


def compared(problem, h, entry, width):
    """What the score sees for these half-widths: errors and coverage by label."""
    low, high = h.fit.theta - width, h.fit.theta + width
    report = {"effects": effect_entries(h, [h.share] * len(h.located), low, high),
              "parameters": parameter_entries(problem, h, low, high)}
    return compare(entry["effects"][0], entry, report)


def needed(problem, h, entry, width) -> dict[str, float]:
    """Width that covers the truth, in half-widths, by label; infinite where none does."""
    found = {}
    for ratio in RATIOS[::-1]:
        for label, ok in compared(problem, h, entry, np.minimum(ratio * width, 50.0)).covered.items():
            found[label] = float(ratio) if ok else found.get(label, np.inf)
    return found


def judge(case: Path, entry: dict, out: Path) -> list[dict]:
    """One row per number of the effect that has an interval."""
    evidence, _ = evidence_of(case, out)
    problem, h = evidence.problem, named(evidence, entry)
    if h is None:
        return []
    started = time.process_time()
    low, high, _ = parameter_intervals(problem, h.fit)
    seconds = time.process_time() - started
    new, old = 0.5 * (high - low), sandwich(problem, h.fit)
    after, before = compared(problem, h, entry, new), compared(problem, h, entry, old)
    need, was = needed(problem, h, entry, new), needed(problem, h, entry, old)
    return [{"case": case.name, "cell": entry["cell"], "condition": entry["condition"], "plant": entry["plant"],
             "label": label, "error": after.errors[label], "before": before.covered[label], "after": ok,
             "needed_before": was[label], "needed": need[label], "seconds": seconds,
             "widening": was[label] / max(need[label], RATIOS[0]) if np.isfinite(was[label]) else np.nan,
             "index": entry["seed"] % SLOT, "clutter": entry["clutter"]}
            for label, ok in after.covered.items()]


def summary(rows: list[dict]) -> dict:
    """Coverage with the sandwich alone and in all, and the widening."""
    return {"n": len(rows), "sandwich": float(np.mean([r["before"] for r in rows])),
            "covered": float(np.mean([r["after"] for r in rows])),
            "widening_median": float(np.nanmedian([r["widening"] for r in rows])),
            "error_median": float(np.median([r["error"] for r in rows])),
            "cpu_seconds_median": float(np.median([r["seconds"] for r in rows]))} if rows else {"n": 0}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, default=Path("calibration_fits"))
    parser.add_argument("--split", type=int, default=42, help="first index that was held back")
    parser.add_argument("--part", choices=("tuned", "held_back"))
    parser.add_argument("--kept", action="store_true", help="only cases whose fits are kept already")
    args = parser.parse_args()
    rows = []
    for folder in args.sets:
        for name, entry in sorted(key_of(folder).items()):
            part = "tuned" if entry["seed"] % SLOT < args.split else "held_back"
            kept = (args.out / folder.name / f"{name}.pickle").is_file()
            if entry["class"] != "single" or args.part not in (None, part) or (args.kept and not kept):
                continue
            for r in judge(folder / name, entry, args.out / folder.name):
                rows.append(r | {"part": part})
                clutter = ", ".join(f"{k} {v:.2g}" for k, v in r["clutter"].items())
                print(f"{'ok ' if r['after'] else 'BAD'} {r['case']} {r['cell']} {r['condition']:12s} {r['plant']:20s} "
                      f"{r['label']:42s} error {100 * r['error']:8.3g} %  needs {r['needed_before']:7.2f} of the "
                      f"sandwich, {r['needed']:7.2f} of all  ({clutter})", flush=True)
    result = {f"{part}/{cell}": summary([r for r in rows if r["part"] == part and r["cell"] == cell])
              for part in ("tuned", "held_back") for cell in ("rich", "hard")}
    print("RESULT " + json.dumps(result))


if __name__ == "__main__":
    main()
