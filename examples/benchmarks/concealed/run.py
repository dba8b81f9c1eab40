"""Run the diagnosis over a set of case folders, several at a time; start again where it stopped.

    python run.py CASES -o RESULTS [--processes 2] [--timeout 900] [--retry] [--command "pwaid explain"]

For each case the command gets `CASE_DIR -o RESULTS/CASE` and, for leave-one-effect-out cases, `--without ID`
for
each id of `CASES/runs.json`. The driver sees case folders only, never the key.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def pending(cases, results, retry):
    """Names of cases without a report, and without a recorded failure unless `retry`."""
    out = []
    for folder in sorted(p.parent for p in cases.glob("*/case.toml")):
        target = results / folder.name
        failed = (target / "failure.txt").exists() and not retry
        if not (target / "report.json").exists() and not failed:
            out.append(folder.name)
    return out


def run_one(name, cases, results, command, without, timeout):
    """Run one case; return its row for the log. A failure leaves `failure.txt` and no report."""
    target = results / name
    target.mkdir(parents=True, exist_ok=True)
    call = [*command, str(cases / name), "-o", str(target)]
    for effect in without:
        call += ["--without", effect]
    start = time.time()
    try:
        done = subprocess.run(call, capture_output=True, text=True, timeout=timeout,
                              env=os.environ | ONE_THREAD,
                              check=False)
        code, text = done.returncode, done.stderr
    except subprocess.TimeoutExpired:
        code, text = -1, f"stopped after {timeout} s"
    seconds = time.time() - start
    report = target / "report.json"
    if code != 0 or not report.exists():
        (target / "failure.txt").write_text(f"exit code {code}\n{text}", encoding="utf-8")
        report.unlink(missing_ok=True)
    else:
        (target / "failure.txt").unlink(missing_ok=True)
    return {"case": name, "code": code, "seconds": round(seconds, 2)}


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--timeout", type=float, default=900.0, help="seconds for one case")
    parser.add_argument("--retry", action="store_true", help="run failed cases again")
    parser.add_argument("--command", default="pwaid explain")
    args = parser.parse_args(argv)
    if not (args.cases / "runs.json").exists():
        parser.error(f"{args.cases} holds no runs.json; give the folder that generate.py wrote with --out")
    runs = json.loads((args.cases / "runs.json").read_text(encoding="utf-8"))
    args.out.mkdir(parents=True, exist_ok=True)
    todo = pending(args.cases, args.out, args.retry)
    log = args.out / "log.jsonl"
    failed = 0
    with ThreadPoolExecutor(args.processes) as pool, log.open("a", encoding="utf-8") as lines:
        jobs = [pool.submit(run_one, name, args.cases, args.out, shlex.split(args.command),
                            runs.get(name, []),
                            args.timeout) for name in todo]
        for count, job in enumerate(jobs):
            row = job.result()
            failed += row["code"] != 0
            lines.write(json.dumps(row) + "\n")
            lines.flush()
            if sys.stderr.isatty():
                print(f"\r{count + 1}/{len(todo)}, {failed} failed", end="", file=sys.stderr)
    done = len(list(args.out.glob("*/report.json")))
    print("RESULT " + json.dumps({"cases": len(runs), "reports": done, "ran": len(todo), "failed": failed}))


if __name__ == "__main__":
    main()
