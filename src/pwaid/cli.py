"""The command `pwaid`: sweep, demo, explain, effects.

Exit codes: 0 done, 2 unusable input (one line on stderr), 1 internal failure.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from pwaid._version import __version__
from pwaid.delaunay import SimplexMesh
from pwaid.errors import InputError, PwaidError
from pwaid.folders import ready_folder
from pwaid.lerp import WEIGHTINGS
from pwaid.path import RULES, cross_validate, solve_path
from pwaid.problem import HingeProblem
from pwaid.recording import check_samples
from pwaid.solution import Path as LambdaPath
from pwaid.tables import read_table

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except InputError as error:
        print(f"pwaid: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        return 0
    except KeyboardInterrupt:
        print("pwaid: interrupted", file=sys.stderr)
        return 1
    except PwaidError as error:
        print(f"pwaid: {error}", file=sys.stderr)
        return 1
    except Exception:
        traceback.print_exc()
        print("pwaid: internal failure; please report the lines above", file=sys.stderr)
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="pwaid", description="Learn piecewise-affine maps from recordings.")
    parser.add_argument("--version", action="version", version=f"pwaid {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    sweep = commands.add_parser("sweep", help="solve a λ path on samples of a map and choose λ")
    sweep.add_argument("data", type=Path, help="CSV with a header line")
    sweep.add_argument("--inputs", required=True, help="input columns, separated by commas")
    sweep.add_argument("--output", required=True, help="output column")
    sweep.add_argument("--validation", type=Path, help="CSV with held-out samples (else 5-fold cross-validation)")
    sweep.add_argument("--points", type=int, default=2000, help="mesh vertices (default 2000)")
    sweep.add_argument("--lambdas", type=int, default=30, help="values of λ (default 30)")
    sweep.add_argument("--weighting", choices=WEIGHTINGS, default="htv", help="what the penalty measures")
    sweep.add_argument("--rule", choices=RULES, default="min", help="how λ is chosen")
    sweep.add_argument("--tol", type=float, default=1e-4, help="certified relative gap (default 1e-4)")
    sweep.add_argument("--seed", type=int, default=0, help="for mesh and folds")
    sweep.add_argument("-o", "--out", type=Path, default=Path("pwaid-out"), help="folder for the results")
    sweep.set_defaults(run=_sweep)

    explain = commands.add_parser("explain", help="say why a simulator and recordings differ")
    explain.add_argument("case", type=Path, metavar="CASE_DIR", help="folder with case.toml, simulator and recordings")
    explain.add_argument("-o", "--out", type=Path, help="folder for the results (default: CASE_DIR/explained)")
    explain.add_argument("--jobs", type=_jobs, default=_cores(), help="threads (default: one a core, %(default)s)")
    explain.add_argument("--minutes", type=_minutes, help="try no further law after this time (default: no limit)")
    explain.add_argument("--without", action="append", default=[], metavar="EFFECT_ID", help="leave an effect out")
    explain.set_defaults(run=_explain)

    effects = commands.add_parser("effects", help="list the catalogue of effects")
    effects.set_defaults(run=_effects)

    demo = commands.add_parser("demo", help="a λ sweep, then a concealed effect explained, on packaged data")
    demo.add_argument("-o", "--out", type=Path, help="folder for the results (default: a new temporary one)")
    demo.set_defaults(run=_demo)
    return parser


def _cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _jobs(text: str) -> int:
    """A number of threads, for argparse."""
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return int(text)


def _minutes(text: str) -> float:
    """A time in minutes, for argparse."""
    try:
        minutes = float(text)
    except ValueError:
        minutes = 0.0
    if not 0 < minutes < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number of minutes")
    return minutes


class _Percent:
    """A progress bar over the stages of explain on a terminal, nothing when piped."""

    def __init__(self) -> None:
        layout = "{l_bar}{bar}| {postfix}"
        self.bar = tqdm(total=100, desc="explain", disable=not sys.stderr.isatty(), bar_format=layout)

    def __enter__(self) -> _Percent:
        return self

    def __exit__(self, *error: object) -> None:
        self.bar.close()

    def __call__(self, fraction: float, text: str) -> None:
        self.bar.set_postfix_str(text)
        self.bar.update(round(100 * fraction) - self.bar.n)


def _explain(options: argparse.Namespace) -> int:
    from pwaid import mismatch

    out = options.out or options.case / "explained"
    with _Percent() as progress:
        report = mismatch.explain_case(
            options.case, out, jobs=options.jobs, progress=progress, without=tuple(options.without),
            minutes=options.minutes,
        )
    print(report.summary)
    print(f"\nwritten: {', '.join(sorted(p.name for p in out.iterdir()))} in {out}")
    return 0


def _effects(options: argparse.Namespace) -> int:
    from pwaid import mismatch

    for row in mismatch.effects_table():
        print(f"{row['id']}  ({row['family']})")
        for key, value in row.items():
            if key not in ("id", "family") and value:
                print(f"    {key.replace('_', ' ')}: {', '.join(value) if isinstance(value, list | tuple) else value}")
    return 0


class _Bar:
    """A progress bar over λ on a terminal, nothing when piped."""

    def __init__(self) -> None:
        self.bar = None

    def __call__(self, i: int, n: int, solution) -> None:
        if self.bar is None:
            self.bar = tqdm(total=n, desc="λ path", unit="λ", disable=not sys.stderr.isatty())
        self.bar.set_postfix_str(f"gap {solution.gap:.0e}")
        self.bar.update()
        if i + 1 == n:
            self.bar.close()


def _samples(
    path: Path, inputs: list[str], output: str, part: bool = False
) -> tuple[np.ndarray, np.ndarray, dict[str, str]]:
    columns, units = read_table(path)
    for name in (*inputs, output):
        if name not in columns:
            raise InputError(f"{path.name} has no column {name!r}; its columns are {sorted(columns)}")
    X, y = check_samples(np.column_stack([columns[n] for n in inputs]), columns[output], part=part)
    return X, y, units


def _sweep(options: argparse.Namespace) -> int:
    inputs = [name.strip() for name in options.inputs.split(",") if name.strip()]
    if len(set(inputs)) < len(inputs) or not inputs:
        raise InputError(f"--inputs is {options.inputs!r}; expected different column names separated by commas")
    X, y, units = _samples(options.data, inputs, options.output)
    with ready_folder(options.out) as out:
        _sweep_into(out, options, inputs, X, y, units)
    return 0


def _sweep_into(out: Path, options: argparse.Namespace, inputs: list[str], X, y, units) -> None:
    """The path over λ of these samples, and its files."""
    mesh = SimplexMesh.from_data(X, options.points, options.seed)
    print(f"{len(y)} samples of {options.output} over {', '.join(inputs)}; {mesh.n_points} vertices, "
          f"{len(mesh.facets)} hinges; {mesh.quality}")
    settings = {"n_lambdas": options.lambdas, "tol": options.tol, "rule": options.rule, "progress": _Bar()}
    if options.validation is None:
        path = cross_validate(mesh, X, y, weighting=options.weighting, rng=options.seed, **settings)
    else:
        X_val, y_val, _ = _samples(options.validation, inputs, options.output, part=True)
        problem = HingeProblem.from_data(mesh, X, y, weighting=options.weighting)
        path = solve_path(problem, X_val=X_val, y_val=y_val, mesh=mesh, **settings)
    _report(path, out, inputs, options.output, units)


def _report(path: LambdaPath, out: Path, inputs: list[str], output: str, units: dict[str, str]) -> None:
    """Print the path and write path.csv, map.npz and pictures."""
    from pwaid import plotting

    for note in path.warnings:
        print(f"note: {note}")
    print(path)
    if path.validation_rmse is None:
        chosen = path.solutions[0]
    else:
        chosen = path.best
        figure, ax = plotting.new_figure()
        plotting.plot_path(path, ax, unit=units.get(output, ""))
        figure.savefig(out / "path.png", dpi=130)
        share = f" ({chosen.lam / path.lambda_max:.3g} λmax)" if path.lambda_max > 0.0 else ""
        print(f"chosen: λ = {chosen.lam:.4g}{share}, "
              f"{chosen.n_broken} broken hinges, held-out RMSE {path.validation_rmse[path.best_index]:.4g} "
              f"{units.get(output, '')}")
    _write_table(path, out / "path.csv")
    chosen.map.save(out / "map.npz")
    labels = [f"{name} [{units[name]}]" if units.get(name) else name for name in inputs]
    if len(inputs) == 2:
        figure, axes = plotting.new_figure(1, 2, (11, 4.4))
        plotting.plot_map(chosen.map, axes[0], labels=labels, unit=output)
        plotting.plot_shading(chosen.map, axes[1], labels=labels)
        figure.savefig(out / "map.png", dpi=130)
    elif len(inputs) == 3:
        plotting.plot_slices(chosen.map, labels=labels).savefig(out / "map.png", dpi=130)
    print(f"written: {', '.join(sorted(p.name for p in out.iterdir()))} in {out}")


def _write_table(path: LambdaPath, target: Path) -> None:
    with target.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["lambda", "objective", "gap", "broken_hinges", "seconds", "status", "heldout_rmse"])
        errors = path.validation_rmse if path.validation_rmse is not None else np.full(len(path), np.nan)
        for s, error in zip(path.solutions, errors, strict=True):
            writer.writerow([s.lam, s.objective, s.gap, s.n_broken, s.seconds, s.status.name, error])


def _demo(options: argparse.Namespace) -> int:
    """A λ sweep on the pyramid of 2014 Example 1, then a concealed effect explained from packaged recordings."""
    from pwaid import mismatch

    began = time.perf_counter()
    out = options.out or Path(tempfile.mkdtemp(prefix="pwaid-demo-"))
    with ready_folder(out / "sweep") as folder:
        _demo_sweep(folder)
    print("\nA machine that its simulator does not match: what was left out?")
    with _Percent() as progress:
        report = mismatch.explain_case(mismatch.demo_case_path(), out / "explained", jobs=_cores(), progress=progress)
    print(report.summary)
    print(f"\nreport: {out / 'explained' / 'report.html'}  ({time.perf_counter() - began:.1f} s in all)")
    return 0


def _demo_sweep(out: Path) -> None:
    rng = np.random.default_rng(0)
    X, X_val = rng.uniform(-1.1, 1.1, (2, 2000, 2))
    y, y_val = (np.maximum(1.0 - np.abs(Z).sum(axis=1), 0.0) + 0.1 * rng.standard_normal(2000) for Z in (X, X_val))
    print("A pyramid seen through noise (2014 Example 1): 2000 samples, noise 0.1, 2000 vertices")
    mesh = SimplexMesh.uniform([[-1.1, 1.1]] * 2, 2000, rng)
    problem = HingeProblem.from_data(mesh, X, y, weighting="htv")
    path = solve_path(
        problem, n_lambdas=15, start=2.0, tol=1e-3, X_val=X_val, y_val=y_val, mesh=mesh, progress=_Bar()
    )
    _report(path, out, ["x1", "x2"], "y", {})
    truth = np.maximum(1.0 - np.abs(X_val).sum(axis=1), 0.0)
    error = float(np.sqrt(np.mean((path.best.map(X_val) - truth) ** 2)))
    print(f"error against the noise-free pyramid: {error:.4f} (noise 0.1000)")
