"""Score results against the sealed key: tables per cell and class, confusion matrix, failures one by one.

    python score.py --key KEY_DIR --seal KEY.sha256 --results RESULTS [--cases CASES] [--save DIR]

Prints markdown tables and one line `RESULT {json}` with one entry per cell and class.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from concealed import seal
from concealed.effects import FAMILY, IDS
from concealed.judge import judge, primary
from concealed.wilson import wilson
from concealed.write import digest

SINGLE = ("exact_first", "exact_strict", "in_set", "family", "refused", "extra_name", "wrong_name")
PAIR = ("both", "both_family", "in_set", "refused", "wrong_name")
QUIET = ("false_name", "quiet")
REFUSE = ("refused", "unexplained")
MEASURES = {"single": SINGLE, "pair": PAIR, "clean": QUIET, "parameters": QUIET, "initial_state": QUIET,
            "unexcited": QUIET, "out_of_catalogue": REFUSE, "left_out": REFUSE}
RIGHT = {"single": "exact_first", "pair": "both", "clean": "quiet", "parameters": "quiet",
         "initial_state": "quiet",
         "unexcited": "quiet", "out_of_catalogue": "refused", "left_out": "refused"}
PAIRED = ("pair", "concealed_mask")

# Issue 6: (class, measure) -> target in the rich and in the hard cell; a minus sign means "at most".
TARGETS = {
    ("single", "exact_first"): (0.92, 0.80), ("single", "in_set"): (0.99, 0.95), ("single",
                                                                                  "family"): (0.98, 0.92),
    ("single", "refused"): (-0.10, -0.30), ("single", "removed_median"): (0.90, 0.70),
    ("single", "parameter_error_median"): (-0.03, -0.15), ("pair", "both"): (0.80, 0.55),
    ("clean", "false_name"): (-0.02, -0.05), ("parameters", "false_name"): (-0.05, -0.05),
    ("out_of_catalogue", "refused"): (0.95, 0.80), ("left_out", "refused"): (0.95, 0.80),
}
COVERAGE = {"rich": (0.85, 0.95), "hard": (0.80, 0.97)}


def measures_of(name):
    """Measures that are counted for a class."""
    return MEASURES.get(name, PAIR if name in PAIRED else SINGLE)


def load(key_folder, seal_file, results, cases=None):
    """Judge all results; raises ValueError when the key, a truth file or a case folder is not the sealed
    one."""
    seal.check(key_folder / "key.json", seal_file)
    key = json.loads((key_folder / "key.json").read_text(encoding="utf-8"))["cases"]
    verdicts = []
    for case, entry in sorted(key.items()):
        truth = key_folder / "truth" / f"{case}.npz"
        if seal.sha256(truth) != entry["truth_sha256"]:
            raise ValueError(f"{truth.name} is not the sealed one; generate the set again")
        if cases is not None and digest(cases / case) != entry["folder_sha256"]:
            raise ValueError(f"case folder {case} is not the sealed one; generate the set again")
        path = results / case / "report.json"
        report = json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
        verdict = judge(case, entry, report, FAMILY)
        verdict.facts["refused"] = not verdict.facts["named"] and not verdict.facts["failed"]
        verdict.facts["false_name"] = verdict.facts["named"] or verdict.facts["failed"]
        verdicts.append(verdict)
    return verdicts


def summarise(verdicts):
    """Counts with Wilson intervals and medians for a list of verdicts of one class."""
    name, n = verdicts[0].entry["class"], len(verdicts)
    out = {"n": n, "failed_runs": sum(v.facts["failed"] for v in verdicts)}
    for measure in measures_of(name):
        hits = sum(bool(v.facts[measure]) for v in verdicts)
        low, high = wilson(hits, n)
        out[measure] = {"hits": hits, "rate": round(hits / n, 4), "low": round(low, 4),
                        "high": round(high, 4)}
    removed = [v.removed for v in verdicts if v.removed is not None]
    errors = [e for v in verdicts for e in primary(v.errors)]
    covered = [c for v in verdicts for c in v.covered.values()]
    if removed:
        out["removed_median"] = round(float(np.median(removed)), 4)
    if errors:
        out["parameter_error_median"] = round(float(np.median(errors)), 4)
    if covered:
        low, high = wilson(sum(covered), len(covered))
        out["coverage"] = {"hits": sum(covered), "n": len(covered), "rate": round(sum(covered) / len(covered),
                                                                                  4),
                           "low": round(low, 4), "high": round(high, 4)}
    out["unmatched_parameters"] = sorted({u for v in verdicts for u in v.unmatched})
    out["seconds_median"] = round(float(np.median([v.seconds for v in verdicts])), 2)
    return out


def grouped(verdicts):
    """Dict "cell/class" -> summary, with the hard cell also split by condition."""
    groups = defaultdict(list)
    for v in verdicts:
        cell, name = v.entry["cell"], v.entry["class"]
        if name.startswith("concealed_"):
            groups[f"concealed/{name}"].append(v)
            continue
        groups[f"{cell}/{name}"].append(v)
        if cell == "hard":
            groups[f"hard:{v.entry['condition']}/{name}"].append(v)
    return {label: summarise(group) for label, group in sorted(groups.items())}


def met(cell, name, measure, value):
    """True, False, or None when issue 6 sets no target."""
    if cell not in ("rich", "hard"):
        return None
    if measure == "coverage":
        low, high = COVERAGE[cell]
        return low <= value <= high if name == "single" else None
    target = TARGETS.get((name, measure))
    if target is None:
        return None
    bound = target[cell == "hard"]
    return value >= bound if bound >= 0.0 else value <= -bound


def table(summaries):
    """Markdown table of all groups: one row per group and measure."""
    lines = ["| cell | class | n | measure | hits | rate | 95 % interval | target |",
             "|---|---|---|---|---|---|---|---|"]
    for label, s in summaries.items():
        cell, name = label.split("/")
        for measure, v in s.items():
            if isinstance(v, dict):
                ok = met(cell, name, measure, v["rate"])
                n = v.get("n", s["n"])
                lines.append(f"| {cell} | {name} | {n} | {measure} | {v['hits']} | {v['rate']:.1%} | "
                             f"{v['low']:.1%} – {v['high']:.1%} | {_word(ok)} |")
            elif measure.endswith("_median") and measure != "seconds_median":
                lines.append(f"| {cell} | {name} | {s['n']} | {measure} | | {v:.1%} | | "
                             f"{_word(met(cell, name, measure, v))} |")
    return "\n".join(lines)


def _word(ok):
    return {None: "", True: "met", False: "**missed**"}[ok]


def failures(verdicts):
    """Markdown list of every case that is not right, with what it was and what was said."""
    lines = []
    for v in verdicts:
        name, entry = v.entry["class"], v.entry
        wrong = v.facts["wrong_name"] or v.facts["failed"]
        if (not v.facts[RIGHT[name]]) if name in RIGHT else wrong:
            truth = " + ".join(e["id"] for e in entry["effects"]) or entry["stranger"] or "nothing"
            size = ", ".join(f"{k} {m:.1f}" for k, m in entry["detectability"].items())
            said = f"{v.verdict} {v.ids}" if v.ids else v.verdict
            where = f"{entry['cell']}/{name}: {entry['plant']}, {entry['condition']}"
            seen = f"measured {', '.join(entry['measured'])}, noise {entry['noise']:.1%}"
            lines.append(f"* `{v.case}` {where}, {seen}; truth {truth} (size in noise: {size}); said {said}")
    return "\n".join(lines)


def confusion(verdicts, path):
    """Picture: true effect of single-effect cases against the first name given."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = [v for v in verdicts if v.entry["class"] == "single"]
    extra = ["agreement", "parameters_only", "unexplained", "failed"]
    columns = [*IDS, *extra]
    counts = np.zeros((len(IDS), len(columns)))
    for v in rows:
        said = v.ids[0] if v.ids and v.ids[0] in IDS else v.verdict
        if said in columns:
            counts[IDS.index(v.entry["effects"][0]["id"]), columns.index(said)] += 1
    fig, ax = plt.subplots(figsize=(11, 10))
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    ax.imshow(share, cmap="Blues", vmin=0, vmax=1)
    for i, j in zip(*np.nonzero(counts), strict=True):
        ax.text(j, i, int(counts[i, j]), ha="center", va="center", fontsize=6,
                color="white" if share[i, j] > 0.6 else "black")
    ax.set_xticks(range(len(columns)), columns, rotation=90, fontsize=6)
    ax.set_yticks(range(len(IDS)), IDS, fontsize=6)
    ax.axvline(len(IDS) - 0.5, color="grey", lw=0.8)
    ax.set_xlabel("first name, or verdict without a name")
    ax.set_ylabel("concealed effect")
    fig.tight_layout()
    fig.savefig(path, dpi=90)
    plt.close(fig)


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--key", type=Path, required=True, help="folder that holds key.json and truth/")
    parser.add_argument("--seal", type=Path, required=True, help="file with the hash written before the run")
    parser.add_argument("--results", type=Path, required=True)
    parser.add_argument("--cases", type=Path, help="also check that the case folders are the sealed ones")
    parser.add_argument("--save", type=Path, help="folder for tables, failures and confusion matrix")
    args = parser.parse_args(argv)
    try:
        verdicts = load(args.key, args.seal, args.results, args.cases)
    except (OSError, ValueError) as problem:
        print(problem, file=sys.stderr)
        return 2
    summaries = grouped(verdicts)
    text, listed = table(summaries), failures(verdicts)
    print(text)
    if args.save:
        args.save.mkdir(parents=True, exist_ok=True)
        (args.save / "table.md").write_text(text + "\n", encoding="utf-8")
        (args.save / "failures.md").write_text(listed + "\n", encoding="utf-8")
        (args.save / "score.json").write_text(json.dumps(summaries, indent=1), encoding="utf-8")
        for cell in ("rich", "hard"):
            group = [v for v in verdicts if v.entry["cell"] == cell]
            confusion(group, args.save / f"confusion_{cell}.png")
    else:
        print(listed)
    print("RESULT " + json.dumps(summaries))
    return 0


if __name__ == "__main__":
    sys.exit(main())
