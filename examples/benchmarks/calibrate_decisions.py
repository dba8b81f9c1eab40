"""Set the decision thresholds of `pwaid.mismatch` on calibration cases, never on score cases.

Fits every hypothesis of every case below SET once, keeps the fits in OUT, decides on them, compares with the key
and prints how often the right answer came, per cell and class, with the numbers that the thresholds act on. A
second run reads the fits back, so that another rule or threshold costs seconds.

    python examples/benchmarks/calibrate_decisions.py SET [SET ...] [--processes N] [--limit N] [--out DIR]

SET is a folder made by the case generator with `--set calibration`; its key lies in SET-key/key.json.
"""

from __future__ import annotations

import argparse
import json
import pickle
import time
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from pwaid.mismatch.case import load_case
from pwaid.mismatch.decide import decide
from pwaid.mismatch.effects.base import Effect
from pwaid.mismatch.effects.registry import CATALOGUE
from pwaid.mismatch.explain import collect_case
from pwaid.mismatch.plant import Plant

NAMED = {"single", "pair", "concealed_controller", "concealed_parameter", "concealed_noise", "concealed_mask",
         "concealed_output"}  # classes in which an effect is to be named; in the others every name is false


class Writer(pickle.Pickler):
    """Effects by id and law, the plant by nothing: both hold functions."""

    def persistent_id(self, item):
        if isinstance(item, Effect):
            return "effect", item.id, item.law
        return ("plant",) if isinstance(item, Plant) else None


class Reader(pickle.Unpickler):
    """The other way, with the plant of the case folder."""

    def __init__(self, file, plant):
        super().__init__(file)
        self.plant = plant

    def persistent_load(self, key):
        if key[0] == "plant":
            return self.plant
        return next(e for e in CATALOGUE if (e.id, e.law) == key[1:])


def key_of(folder: Path) -> dict:
    """Case name to its entry in the key."""
    table = json.loads((folder.parent / f"{folder.name}-key" / "key.json").read_text())
    cases = table.get("cases", table)
    return cases if isinstance(cases, dict) else {c["case"]: c for c in cases}


def evidence_of(case: Path, out: Path, without=()):
    """The fits of a case, from OUT when they are there, and the seconds of processor time they took."""
    loaded = load_case(case)
    path = out / f"{case.name}.pickle"
    if path.is_file():
        with path.open("rb") as file:
            return Reader(file, loaded.plant).load()
    started = time.process_time()
    evidence = collect_case(loaded, without=without)
    stored = evidence, time.process_time() - started
    out.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        Writer(file).dump(stored)
    return stored


def judge(case: Path, entry: dict, out: Path, without) -> dict:
    """One line and whether the answer was right."""
    truth = [e["id"] for e in entry.get("effects", ())]
    same = {e["id"]: {e["id"], *e.get("equivalents", ())} for e in entry.get("effects", ())}
    try:
        evidence, seconds = evidence_of(case, out, without)
        d = decide(evidence.problem, evidence.null, evidence.singles, evidence.pairs)
        verdict, first = d.verdict, list(d.members[0].ids) if d.members else []
        everyone = [i for h in d.members for i in h.ids]
    except Exception as error:
        traceback.print_exc()
        verdict, first, everyone, seconds = f"error {type(error).__name__}: {error}", [], [], 0.0
    if entry["class"] in NAMED:
        right = bool(first) and all(any(i in same[t] for i in first) for t in truth) and len(first) == len(truth)
    else:
        right = not first and not verdict.startswith("error")
    return {"case": case.name, "class": entry["class"], "cell": entry["cell"], "right": right, "verdict": verdict,
            "truth": truth, "first": first, "all": everyone, "seconds": seconds, "plant": entry["plant"],
            "condition": entry.get("condition", "")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, default=Path("calibration_fits"))
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--limit", type=int, default=10**6)
    parser.add_argument("--classes", nargs="*")
    args = parser.parse_args()
    todo = []
    for folder in args.sets:
        runs = json.loads((folder / "runs.json").read_text()) if (folder / "runs.json").is_file() else {}
        for name, entry in list(key_of(folder).items())[:args.limit]:
            if not args.classes or entry["class"] in args.classes:
                todo.append((folder / name, entry, args.out / folder.name, runs.get(name, [])))
    tally: dict[str, list[int]] = {}
    todo.sort(key=lambda item: item[0].name)  # names are hashes: any part of the run is a fair sample
    with ProcessPoolExecutor(args.processes) as pool:
        for done in as_completed([pool.submit(judge, *item) for item in todo]):
            r = done.result()
            tally.setdefault(f"{r['cell']}/{r['class']}", []).append(int(r["right"]))
            print(f"{'ok ' if r['right'] else 'BAD'} {r['case']} {r['cell']}/{r['class']:17s} {r['plant']:22s} "
                  f"{r['condition']:12s} {'+'.join(r['truth']) or '-':40s} {r['verdict']:15s} "
                  f"{'+'.join(r['first']) or '-':36s} {','.join(r['all'][len(r['first']):])} {r['seconds']:.0f} s",
                  flush=True)
    print("RESULT " + json.dumps({"right": {k: [sum(v), len(v)] for k, v in sorted(tally.items())}}))


if __name__ == "__main__":
    main()
