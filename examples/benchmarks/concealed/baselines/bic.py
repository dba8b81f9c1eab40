"""Baseline: BIC alone. The diagnosis' own fitted candidates, ranked by BIC; the lowest is named, whatever it is.

    python baselines/bic.py RESULTS -o OUT

RESULTS is the folder that `run.py` filled. Each candidate of a report needs `bic` (white-noise BIC on the training
recordings) and `values` (its parameters); the report needs `bic_null` for the refitted simulator without an effect.
A case without a report gets none here either, so that it counts as failed for both.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from concealed.baselines.common import report


def diagnose(full):
    """The report of the candidate with the lowest BIC.

    Raises
    ------
    ValueError
        When the report lacks the figures; it then comes from an older version of the diagnosis.
    """
    rows = full["candidates"]
    if "bic_null" not in full or any("bic" not in r for r in rows):
        raise ValueError("the report holds no bic of its candidates or no bic_null; run the diagnosis again")
    found = [r for r in rows if r["bic"] is not None]
    best = min(found, key=lambda r: r["bic"], default=None)
    tried, seconds = full["hypotheses_tried"], full["seconds"]
    if best is None or (full["bic_null"] is not None and full["bic_null"] <= best["bic"]):
        return report("parameters_only", tried=tried, seconds=seconds)
    return report("named", _effects(best), tried=tried, seconds=seconds)


def _effects(best):
    """One entry per id; a pair's values are told apart by `id.name`."""
    out = []
    for effect in best["id"].split(" + "):
        own = {}
        for name, value in best.get("values", {}).items():
            owner, _, short = name.rpartition(".")
            if owner in ("", effect):
                own[short] = {"value": value}
        out.append({"id": effect, "parameters": own})
    return out


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=Path, help="folder that run.py filled with the diagnosis")
    parser.add_argument("-o", "--out", type=Path, required=True)
    args = parser.parse_args(argv)
    done = 0
    for path in sorted(args.results.glob("*/report.json")):
        try:
            answer = diagnose(json.loads(path.read_text(encoding="utf-8")))
        except ValueError as problem:
            print(f"{path}: {problem}", file=sys.stderr)
            return 2
        target = args.out / path.parent.name
        target.mkdir(parents=True, exist_ok=True)
        (target / "report.json").write_text(json.dumps(answer, indent=1), encoding="utf-8")
        done += 1
    print("RESULT " + json.dumps({"reports": done}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
