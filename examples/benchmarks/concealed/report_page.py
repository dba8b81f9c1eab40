"""Remake the results of docs/proof.md from saved scores: everything between the two markers is replaced.

    python report_page.py SCORES --page docs/proof.md [--pictures docs/img]

SCORES holds one folder per tool as `score.py --save` wrote it: `pwaid` and any baselines.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from concealed import tables
from concealed.classes import CELLS

BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"
MAIN = "pwaid"
TITLES = {"pwaid": "pwaid", "always_parameters": "always “parameters”", "majority": "majority class",
          "bic": "BIC alone", "sindy": "sparse regression", "gaussian_process": "Gaussian process"}


def read(folder):
    """{tool: summaries}, the diagnosis first."""
    names = [n for n in TITLES if (folder / n / "score.json").exists()]
    if MAIN not in names:
        raise ValueError(f"{folder} holds no {MAIN}/score.json; run score.py --save {folder / MAIN} first")
    return {n: json.loads((folder / n / "score.json").read_text(encoding="utf-8")) for n in names}


def section(scores, rows, pictures):
    """Markdown of the results."""
    own = scores[MAIN]
    cases = sum(s["n"] for label, s in own.items() if not label.startswith("hard:"))
    failed = sum(s["failed_runs"] for label, s in own.items() if not label.startswith("hard:"))
    parts = [f"{cases} cases, {failed} failed runs. In brackets: count and 95 % Wilson interval; "
             "“met” compares the measured rate with the target, the interval says how sure that is.",
             "### Targets and measured rates", tables.headline(own),
             "### Effects that something hides",
             "The right answer is the name or no name; only a wrong name is a failure.", tables.second_kind(own),
             "### Baselines on the same cases",
             tables.comparison({TITLES[n]: s for n, s in scores.items()}, (TITLES["gaussian_process"],)),
             "### Which name for which effect", *pictures,
             "### Every measure per cell and class", tables.by_class(own),
             "### Failures one by one", f"{len(rows)} of {cases} cases. The size is what the effect leaves after the "
             "best refit of the nominal simulator, in units of the sensor noise.", tables.listed(rows)]
    return "\n\n".join(parts)


def replace(text, new):
    """`text` with what stands between the markers replaced by `new`."""
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        raise ValueError(f"the page needs the markers {BEGIN} and {END} once each")
    head, rest = text.split(BEGIN)
    return f"{head}{BEGIN}\n{new}\n{END}{rest.split(END)[1]}"


def copy_pictures(scores, page, target):
    """Copy the confusion matrices and return their markdown lines."""
    lines = []
    for cell in CELLS:
        source = scores / MAIN / f"confusion_{cell}.png"
        if source.exists():
            target.mkdir(parents=True, exist_ok=True)
            made = target / f"proof_confusion_{cell}.png"
            shutil.copyfile(source, made)
            link = Path(os.path.relpath(made, page.parent)).as_posix()
            lines.append(f"![First name given for each concealed effect, {cell} cell]({link})")
    return lines


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scores", type=Path)
    parser.add_argument("--page", type=Path, required=True)
    parser.add_argument("--pictures", type=Path, help="folder for the pictures, default img/ beside the page")
    args = parser.parse_args(argv)
    try:
        scores = read(args.scores)
        rows = json.loads((args.scores / MAIN / "failures.json").read_text(encoding="utf-8"))
        pictures = copy_pictures(args.scores, args.page, args.pictures or args.page.parent / "img")
        text = replace(args.page.read_text(encoding="utf-8"), section(scores, rows, pictures))
    except (OSError, ValueError) as problem:
        print(problem, file=sys.stderr)
        return 2
    args.page.write_text(text, encoding="utf-8")
    print("RESULT " + json.dumps({"tools": list(scores), "failures": len(rows)}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
