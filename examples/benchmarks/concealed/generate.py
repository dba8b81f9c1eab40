"""Write a set of sealed cases: folders for the tool, a key for the scorer, and the key's hash.

    python generate.py --set calibration --out DIR [--cells rich hard] [--classes single pair …] [--n 2 single=12 …]
    [--key DIR]

The set is deterministic: a case depends on its set, cell, class and index alone. Case names say nothing.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from concealed import seal
from concealed.catalogue import IDS
from concealed.classes import CELLS, CLASSES, CONCEALED, generate, left_out_ids
from concealed.seeds import SEEDS, SLOT
from concealed.write import key_entry, truth_bytes, write_case

DEFAULT_N = {"single": len(IDS), "left_out": len(IDS), "clean": 40}


def seed_of(which, cell, name, index):
    """Seed of a case, among the ten thousand of its set."""
    if index >= SLOT:
        raise ValueError(f"index {index} of class {name}: a class holds at most {SLOT} cases per cell")
    return SEEDS[which] + (CELLS.index(cell) * len(CLASSES) + CLASSES.index(name)) * SLOT + index


def case_name(seed):
    """A name that tells nothing about the class."""
    return "case_" + hashlib.sha256(f"concealed {seed}".encode()).hexdigest()[:10]


def counted(text):
    """`12` or `single=12` as (class or "", count)."""
    name, _, count = text.rpartition("=")
    if (name and name not in CLASSES) or not count.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r}: expected N or CLASS=N with CLASS one of {', '.join(CLASSES)}")
    return name, int(count)


def jobs(which, cells, classes, n):
    """All (class, cell, index, seed) of a set; the second kind of concealment has one cell of its own.

    `n` maps a class, or "" for all, to its number of cases per cell; what it leaves out has the default number.
    """
    out = []
    for name in classes:
        count = n.get(name, n.get("")) or DEFAULT_N.get(name, 20)
        for cell in ("rich",) if name in CONCEALED else cells:
            out += [(name, cell, i, seed_of(which, cell, name, i)) for i in range(count)]
    return sorted(out, key=lambda job: case_name(job[3]))


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--set", dest="which", choices=sorted(SEEDS), default="calibration")
    parser.add_argument("--out", type=Path, required=True, help="folder for the cases")
    parser.add_argument("--key", type=Path, help="folder for the key, default OUT-key")
    parser.add_argument("--cells", nargs="+", choices=CELLS, default=list(CELLS))
    parser.add_argument("--classes", nargs="+", choices=CLASSES, default=list(CLASSES))
    parser.add_argument("--n", nargs="+", type=counted, default=[], metavar="N or CLASS=N",
                        help="cases per class and cell, default every id for single, else 20 to 40")
    args = parser.parse_args(argv)
    key_folder = args.key or args.out.with_name(args.out.name + "-key")
    for folder in (args.out, key_folder):
        if folder.exists() and any(folder.iterdir()):
            parser.error(f"{folder} is not empty; choose another folder or empty it")
        folder.mkdir(parents=True, exist_ok=True)
    (key_folder / "truth").mkdir()
    start = time.time()
    entries, runs, missing = {}, {}, []
    todo = jobs(args.which, args.cells, args.classes, dict(args.n))
    for count, (name, cell, index, seed) in enumerate(todo):
        label = case_name(seed)
        try:
            case = generate(name, cell, index, seed)
        except RuntimeError as failure:
            missing.append(str(failure))
            continue
        entry = key_entry(case, name, cell, seed)
        entry["folder_sha256"] = write_case(case, args.out / label)
        truth = truth_bytes(case)
        (key_folder / "truth" / f"{label}.npz").write_bytes(truth)
        entry["truth_sha256"] = hashlib.sha256(truth).hexdigest()
        entries[label] = entry
        runs[label] = left_out_ids(case) if name == "left_out" else []
        if sys.stderr.isatty():
            print(f"\r{count + 1}/{len(todo)}", end="", file=sys.stderr)
    (args.out / "runs.json").write_text(json.dumps(runs, indent=1), encoding="utf-8")
    key = {"schema": "concealed-key/1", "set": args.which, "cases": entries, "not_found": missing}
    (key_folder / "key.json").write_text(json.dumps(key, indent=1), encoding="utf-8")
    sha = seal.seal(key_folder / "key.json", args.out / "key.sha256")
    result = {"cases": len(entries), "not_found": len(missing), "key_sha256": sha,
              "seconds": round(time.time() - start, 1)}
    print("RESULT " + json.dumps(result))


if __name__ == "__main__":
    main()
