"""Run the diagnosis over many case folders in a few long-lived processes; start again where it stopped.

    python examples/benchmarks/explain_batch.py CASES -o RESULTS [--processes 2]

Same answers as `pwaid explain` on each folder, without its page, pictures, isolability matrix and next experiment, and
without starting Python for every case. CASES/runs.json lists the cases and the ids that each is to do without; without
that file every folder with a case.toml is one. It sees case folders only, never a key. Cases are taken in the order of
their names: those of the generator are hashes, so that a part of the run is a fair sample.
"""

from __future__ import annotations

import argparse
import json
import time
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from pwaid.mismatch.case import load_case
from pwaid.mismatch.explain import collect_case, conclude


def run(case: Path, out: Path, without) -> tuple[str, str]:
    """Explain one case; its verdict, or what went wrong, which is kept in failure.txt."""
    started = time.perf_counter()
    out.mkdir(parents=True, exist_ok=True)
    try:
        report = conclude(collect_case(load_case(case), without=without), started=started, brief=True)
    except Exception as error:
        (out / "failure.txt").write_text(traceback.format_exc(), encoding="utf-8")
        return case.name, f"failed: {type(error).__name__}: {error}"
    (out / "report.json").write_text(json.dumps(report.to_dict(), indent=1, allow_nan=False), encoding="utf-8")
    return case.name, report.verdict


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args()
    listed = args.cases / "runs.json"
    runs = json.loads(listed.read_text(encoding="utf-8")) if listed.is_file() else {
        f.parent.name: [] for f in args.cases.glob("*/case.toml")}
    todo = [n for n in sorted(runs) if not any((args.out / n / f).is_file() for f in ("report.json", "failure.txt"))]
    failed = 0
    with ProcessPoolExecutor(args.processes) as pool:
        jobs = [pool.submit(run, args.cases / n, args.out / n, runs[n]) for n in todo]
        for count, job in enumerate(as_completed(jobs)):
            name, verdict = job.result()
            failed += verdict.startswith("failed")
            print(f"{count + 1}/{len(todo)} {name} {verdict}", flush=True)
    done = len(list(args.out.glob("*/report.json")))
    print("RESULT " + json.dumps({"cases": len(runs), "reports": done, "ran": len(todo), "failed": failed}))


if __name__ == "__main__":
    main()
