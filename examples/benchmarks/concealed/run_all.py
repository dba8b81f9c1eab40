"""The whole proof with one command: generate, run the diagnosis, score, run and score the baselines, make the page.

    python run_all.py WORK [--set calibration|score|score2|…] [--n 2 single=12] [--classes …] [--cells …]
                      [--processes 2] [--command "pwaid explain"] [--baselines …] [--page ../../../docs/proof.md]

Every step resumes where it stopped. The cases are written once; the hash of their key is printed and must be committed
before the diagnosis is allowed to see a score set: with a score set the run stops after writing the cases until
`--seal FILE` names the committed copy of WORK/cases/key.sha256.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from concealed.seeds import SEEDS

HERE = Path(__file__).resolve().parent
BASELINES = ("always_parameters", "majority", "bic", "sindy", "gaussian_process")


def call(script, *words):
    """Run one of the scripts beside this one; stop everything when it fails."""
    done = subprocess.run([sys.executable, str(HERE / script), *map(str, words)], capture_output=True, text=True,
                          check=False)
    if done.returncode != 0:
        raise SystemExit(f"{script} stopped with exit code {done.returncode}:\n{done.stderr.strip()}")
    print(f"{script}: {done.stdout.strip().splitlines()[-1][:300]}", flush=True)


def generate(args):
    """Write the cases unless they are there; a set with another composition needs another folder."""
    wanted = {"set": args.which, "n": args.n, "classes": args.classes, "cells": args.cells}
    note = args.work / "composition.json"
    if note.exists():
        found = json.loads(note.read_text(encoding="utf-8"))
        if found != wanted:
            raise SystemExit(f"{args.work} holds the cases of {found}, asked for were {wanted}; choose another folder")
        return
    words = ["--set", args.which, "--out", args.work / "cases"]
    for option in ("n", "classes", "cells"):
        value = getattr(args, option)
        if value:
            words += [f"--{option}", *value]
    call("generate.py", *words)
    note.write_text(json.dumps(wanted), encoding="utf-8")


def diagnose(args):
    """The diagnosis and the baselines, each into its own folder of results."""
    cases, results = args.work / "cases", args.work / "results"
    rest = ("--processes", args.processes, "--timeout", args.timeout)
    call("run.py", cases, "-o", results / "pwaid", "--command", args.command, *rest)
    for name in args.baselines:
        if name == "bic":
            call("baselines/bic.py", results / "pwaid", "-o", results / name)
        else:
            command = f'"{sys.executable}" "{HERE / "baselines" / name}.py"'
            call("run.py", cases, "-o", results / name, "--command", command, *rest)


def score(args):
    """Score every folder of results against the sealed key, and make the page when one is named."""
    scores = args.work / "scores"
    for name in ("pwaid", *args.baselines):
        call("score.py", "--key", args.work / "cases-key", "--seal", args.seal, "--cases", args.work / "cases",
             "--results", args.work / "results" / name, "--save", scores / name)
    if args.page:
        call("report_page.py", scores, "--page", args.page)


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path, help="folder for cases, key, results and scores")
    parser.add_argument("--set", dest="which", choices=sorted(SEEDS), default="calibration")
    parser.add_argument("--n", nargs="+", help="cases per class and cell, or CLASS=N, as generate.py takes it")
    parser.add_argument("--classes", nargs="+")
    parser.add_argument("--cells", nargs="+")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--timeout", type=float, default=1800.0, help="seconds for one case")
    parser.add_argument("--command", default="pwaid explain")
    parser.add_argument("--baselines", nargs="*", choices=BASELINES, default=list(BASELINES))
    parser.add_argument("--seal", type=Path, help="committed copy of the key's hash; required for the score set")
    parser.add_argument("--page", type=Path, help="markdown page whose results are remade")
    args = parser.parse_args(argv)
    args.work.mkdir(parents=True, exist_ok=True)
    generate(args)
    if args.seal is None and args.which.startswith("score"):
        print(f"commit a copy of {args.work / 'cases' / 'key.sha256'}, then run again with --seal COPY")
        return 0
    args.seal = args.seal or args.work / "cases" / "key.sha256"
    diagnose(args)
    score(args)
    result = json.loads((args.work / "scores" / "pwaid" / "score.json").read_text(encoding="utf-8"))
    print("RESULT " + json.dumps(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
