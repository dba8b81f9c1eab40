"""Cascaded tanks: a NARX model of the lower level, free run on the test record.

Reads PWAID_DATA/cascaded_tanks/dataBenchmark.mat (4 s, 1024 + 1024 samples). The upper tank is not measured; the pump
voltage u through a first-order filter that cannot exceed a limit stands in for it (a tank overflows),
v(k) = min(c, a·v(k−1) + (1 − a)·u(k−1)), which needs no measurement in free run. It starts from the mean of the first
20 inputs of the estimation record in both records, which begin in the same unknown state. The map bends along y(k−1)
and v(k−1); u(k−1) enters linearly. It is fitted one step ahead (convex) and then refined by free run. Pole a, limit c,
mesh and λ are chosen on the estimation record alone: it is cut into eight blocks, each is simulated by a model of the
seven others, and the RMSE over all blocks counts. The test record is simulated once, at the end.

    python cascaded_tanks_narx.py [--quick] [--save DIR]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from pwaid.dynamics.narx import NARX
from pwaid.dynamics.refine import free_run_scale, refine, refine_path
from pwaid.errors import InputError
from pwaid.recording import Recording

FILE = "cascaded_tanks/dataBenchmark.mat"
STRUCTURE = NARX(output_lags=1, input_lags=1, direct=False, nonlinear=("y(k-1)", "v(k-1)"))
CANDIDATES = {
    "full": [(a, c, n) for a in (0.92, 0.94, 0.96) for c in (4.2, 4.6, np.inf) for n in (20, 40)],
    "quick": [(0.94, 4.2, 40)],
}
RATIOS = (3.0, 1.0, 0.3, 0.1, 0.03)
ONE_STEP = np.logspace(-0.5, -4, 8)
BLOCKS = 8


def load() -> tuple[np.ndarray, ...]:
    """u and y of the estimation record, u and y of the test record, V."""
    folder = os.environ.get("PWAID_DATA")
    if not folder or not (Path(folder) / FILE).is_file():
        sys.exit(f"{FILE} is missing: set PWAID_DATA to the folder of real recordings that holds it")
    content = loadmat(Path(folder) / FILE)
    return tuple(content[name].ravel().astype(float) for name in ("uEst", "yEst", "uVal", "yVal"))


def record(u: np.ndarray, y: np.ndarray, pole: float, limit: float, v_start: float) -> Recording:
    """A recording with the filtered input as a second channel."""
    v = np.empty_like(u)
    v[0] = min(v_start, limit)
    for k in range(1, len(u)):
        v[k] = min(limit, pole * v[k - 1] + (1 - pole) * u[k - 1])
    return Recording(
        4.0 * np.arange(len(u)), np.column_stack([u, v]), y, input_names=("u", "v"), output_names="y"
    )


def blocks(whole: Recording):
    """For each block: the recordings left of and right of it, and the block with its initial samples."""
    cuts, first = np.linspace(0, len(whole), BLOCKS + 1).astype(int), STRUCTURE.lags.first
    for a, b in pairwise(cuts):
        rest = [r for r in (whole[:a] if a else None, whole[b:] if b < len(whole) else None) if r is not None]
        yield rest, whole[max(a - first, 0) : b]


def judge(whole: Recording, mesh, lambdas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Free-run RMSE over all blocks: of the one-step models, and of the refined ones."""
    one_step, refined = [], []
    for rest, block in blocks(whole):
        problem = STRUCTURE.problem(rest, mesh)
        path = problem.path(lambdas, block, tol=1e-3)
        one_step.append(path.free_run_rmse)
        middle = path.solutions[len(lambdas) // 2][0].values
        try:
            refined.append(refine_path(problem, middle, rest, RATIOS, block, steps=8)[1])
        except InputError:  # the one-step model diverges over the record
            refined.append(np.full(len(RATIOS), np.inf))
    return tuple(np.sqrt(np.mean(np.square(errors), axis=0)) for errors in (one_step, refined))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one candidate instead of eighteen")
    parser.add_argument("--save", type=Path, help="write figures to this directory")
    arguments = parser.parse_args()
    u, y, u_test, y_test = load()
    v_start = float(u[:20].mean())

    best = {"rmse": np.inf}
    print("free-run RMSE over the blocks of the estimation record, V:")
    for pole, limit, n_points in CANDIDATES["quick" if arguments.quick else "full"]:
        whole = record(u, y, pole, limit, v_start)
        problem = STRUCTURE.problem(whole, n_points=n_points, rng=0)
        lambdas = problem.lambda_max() * ONE_STEP
        one_step, refined = judge(whole, problem.mesh, lambdas)
        print(f"  pole {pole}, limit {limit}, {n_points} points: "
              f"one-step {np.round(one_step, 3).tolist()}, "
              f"refined {np.round(refined, 3).tolist()}", flush=True)  # fmt: skip
        for kind, errors in (("one-step", one_step), ("refined", refined)):
            if errors.min() < best["rmse"]:
                best = {"rmse": errors.min(), "kind": kind, "at": int(np.argmin(errors)), "pole": pole,
                        "limit": limit, "problem": problem, "lambdas": lambdas, "n_points": n_points}  # fmt: skip
    print(f"chosen: {best['kind']}, pole {best['pole']}, limit {best['limit']}, {best['n_points']} points, "
          f"λ number {best['at']}")  # fmt: skip

    whole = record(u, y, best["pole"], best["limit"], v_start)
    test = record(u_test, y_test, best["pole"], best["limit"], v_start)
    models = final_models(best, whole)
    runs = {name: model.simulate(test) for name, model in models.items()}
    for name, run in runs.items():
        print(f"test record: {name:>10} RMSE {run.rmse(test.outputs):.3f} V; estimation record "
              f"{models[name].free_run_rmse([whole]):.3f} V; {run}")  # fmt: skip
    print("published: linear 0.588, polynomial NARX 0.41, best black box 0.306, grey box 0.18 V")
    if arguments.save:
        draw(arguments.save, test, runs)
    print("RESULT " + json.dumps({
        "free_run_rmse_v": round(runs["chosen"].rmse(test.outputs), 4),
        "one_step_free_run_rmse_v": round(runs["one-step"].rmse(test.outputs), 4),
        "linear_free_run_rmse_v": round(runs["linear"].rmse(test.outputs), 4),
    }))  # fmt: skip


def final_models(best: dict, whole: Recording) -> dict:
    """The linear, the one-step and the chosen model, fitted to the whole estimation record."""
    problem, lambdas = best["problem"], best["lambdas"]
    at = best["at"] if best["kind"] == "one-step" else len(lambdas) // 2
    values = problem.solve(float(lambdas[at]), tol=1e-3)[0].values
    models = {"linear": problem.linear(), "one-step": problem.model(values[:, None])}
    models["chosen"] = models["one-step"]
    if best["kind"] == "refined":
        scale = free_run_scale(problem, values, whole)
        x = values
        for ratio in RATIOS[: best["at"] + 1]:
            step = refine(problem, x, whole, ratio * scale, steps=8)
            x = step.unknowns
        models["chosen"] = step.model
    return models


def draw(folder: Path, test: Recording, runs: dict) -> None:
    """Free run on the test record."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    figure, axis = plt.subplots(figsize=(8, 3.2), layout="constrained")
    axis.plot(test.time, test.outputs, color="k", lw=2, label="measured")
    for name in ("linear", "chosen"):
        axis.plot(test.time, runs[name].outputs, lw=1, label=f"{name}: {runs[name].rmse(test.outputs):.3f} V")
    axis.set(xlabel="t [s]", ylabel="lower level [V]", title="Cascaded tanks: free run on the test record")
    axis.legend(fontsize=8)
    figure.savefig(folder / "narx_cascaded_tanks.png", dpi=90)


if __name__ == "__main__":
    main()
