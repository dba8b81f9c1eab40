"""Score results against the sealed key: tables per cell and class, confusion matrix, failures one by one.

    python score.py --key KEY_DIR --seal KEY.sha256 --results RESULTS [--cases CASES] [--save DIR]

Prints markdown tables and one line `RESULT {json}` with one entry per cell and class. `--save` writes score.json,
failures.json, tables.md and the confusion matrices; `report_page.py` makes the docs page from them.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from concealed import clutter, picture, seal, tables
from concealed.catalogue import FAMILY
from concealed.classes import CELLS
from concealed.judge import judge
from concealed.summary import failures, grouped
from concealed.write import digest

REASONS = Path(__file__).resolve().parent / "reasons.json"


def load(key_folder, seal_file, results, cases=None, first=None):
    """Judge all results, or those of the `first` cases by name: names are hashes, so these are a fair sample.

    Raises ValueError when the key, a truth file or a case folder is not the sealed one.
    """
    seal.check(key_folder / "key.json", seal_file)
    key = json.loads((key_folder / "key.json").read_text(encoding="utf-8"))["cases"]
    verdicts = []
    for case, entry in sorted(key.items())[:first]:
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
        small = {clutter.IDS[name] for name in entry["clutter"]}
        verdict.facts["absent_name"] = verdict.facts["failed"] or (bool(verdict.ids) and verdict.ids[0] not in small)
        verdicts.append(verdict)
    return verdicts


def write(verdicts, summaries, rows, folder):
    """Everything that `report_page.py` needs, into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "score.json").write_text(json.dumps(summaries, indent=1), encoding="utf-8")
    (folder / "failures.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
    text = "\n\n".join([tables.headline(summaries), tables.by_class(summaries), tables.second_kind(summaries),
                        tables.listed(rows)])
    (folder / "tables.md").write_text(text + "\n", encoding="utf-8")
    for cell in CELLS:
        group = [v for v in verdicts if v.entry["cell"] == cell and v.entry["class"] == "single"]
        if group:
            picture.confusion(group, folder / f"confusion_{cell}.png")


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--key", type=Path, required=True, help="folder that holds key.json and truth/")
    parser.add_argument("--seal", type=Path, required=True, help="file with the hash written before the run")
    parser.add_argument("--results", type=Path, required=True)
    parser.add_argument("--first", type=int, help="score this many cases only, in the order of their names")
    parser.add_argument("--cases", type=Path, help="also check that the case folders are the sealed ones")
    parser.add_argument("--save", type=Path, help="folder for tables, failures and confusion matrix")
    parser.add_argument("--reasons", type=Path, default=REASONS, help="JSON {case: why it failed}, written by hand")
    args = parser.parse_args(argv)
    try:
        verdicts = load(args.key, args.seal, args.results, args.cases, args.first)
        reasons = json.loads(args.reasons.read_text(encoding="utf-8"))
    except (OSError, ValueError) as problem:
        print(problem, file=sys.stderr)
        return 2
    summaries, rows = grouped(verdicts), failures(verdicts, reasons)
    if args.save:
        write(verdicts, summaries, rows, args.save)
    print(tables.headline(summaries), tables.by_class(summaries), tables.second_kind(summaries), sep="\n\n")
    if not args.save:
        print(tables.listed(rows))
    print("RESULT " + json.dumps(summaries))
    return 0


if __name__ == "__main__":
    sys.exit(main())
