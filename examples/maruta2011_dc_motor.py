"""2011 section V: a DC motor with a harmonic drive, ω̇ = Π(i, ω).

The recordings of the paper are not public; `pwaid.systems` has a stand-in, and its figures are not the paper's.
Repeats: three compression levels with the map and the shading of its simplices (Table I), and a periodic validation
input, 100 cycles, with the PWA and the linear model (Fig. 9). λ is chosen on the last tenth of the training data.

    python maruta2011_dc_motor.py [--quick] [--save DIR]
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from pwaid.delaunay import SimplexMesh
from pwaid.dynamics.fit_measures import rmse
from pwaid.dynamics.narx import NARX
from pwaid.path import solve_path
from pwaid.problem import HingeProblem
from pwaid.pwa_map import PWAMap
from pwaid.systems.maruta2011 import DCMotor, maruta2011_dc_motor

BOX = [[-1.5, 1.5], [-35.0, 35.0]]  # A, rad/s: 2011 eq. (16)
FULL = {"n": 511_996, "points": 10_000, "cycles": 100, "lambdas": 12}
QUICK = {"n": 30_000, "points": 600, "cycles": 5, "lambdas": 8}


def free_runner(pwa: PWAMap, dt: float):
    """ω(k) = ω(k−1) + dt·Π(i(k−1), ω(k−1)): the forward difference that was learnt, as a NARX model."""
    swap = np.array([[0.0, 1.0], [1.0, 0.0]])  # φ = (ω(k−1), i(k−1)) to (i, ω)
    narx = NARX(output_lags=1, input_lags=1, direct=False, nonlinear=swap)
    return narx.wrap(PWAMap(pwa.mesh, dt * pwa.values), theta=[[1.0, 0.0]], limit=1e4)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a small run, under a minute")
    parser.add_argument("--save", type=Path, help="write figures to this directory")
    arguments = parser.parse_args()
    size = QUICK if arguments.quick else FULL
    rng = np.random.default_rng(2011)

    data = maruta2011_dc_motor(size["n"], rng)
    X, y = np.column_stack([data.current, data.speed]), data.acceleration
    inside = np.abs(X[:, 1]) <= BOX[1][1]
    print(f"{len(y)} samples, {int((~inside).sum())} outside ±35 rad/s left out")
    X, y = X[inside], y[inside]
    cut = round(0.9 * len(y))

    mesh = SimplexMesh.uniform(BOX, size["points"], rng)
    problem = HingeProblem.from_data(mesh, X[:cut], y[:cut], weighting="pairs")
    began = time.perf_counter()
    path = solve_path(
        problem, n_lambdas=size["lambdas"], ratio=1e-6, start=2.0, tol=1e-3, X_val=X[cut:], y_val=y[cut:], mesh=mesh
    )
    seconds = time.perf_counter() - began
    print(f"{mesh.n_points} points, {mesh.n_simplices} triangles, {problem.n_hinges} hinges; "
          f"λmax = {path.lambda_max:.4g}; path in {seconds:.1f} s")  # fmt: skip
    print(path)
    levels = {"weak": path.solutions[-1], "moderate": path.best, "strong": path.solutions[0]}
    for name, s in levels.items():
        w = s.lam / np.sqrt(2 * problem.loss(s.values))
        print(f"{name:>9} compression: λ = {s.lam:.4g} (w = {w:.3g} of the 2011 form), {s.n_broken} broken hinges")

    t, current, cycles = DCMotor().periodic_test(size["cycles"], rng)
    two = np.tile(current, 2)  # the second period is free of the start
    models = {"PWA": PWAMap(mesh, path.best.values), "linear": PWAMap(mesh, problem.affine_values.copy())}
    start, dt = cycles[0, :1][:, None], DCMotor().dt
    runs = {name: free_runner(m, dt).free_run(two, start) for name, m in models.items()}
    simulated = {name: run.outputs[len(t) :, 0] for name, run in runs.items()}
    for name, run in runs.items():
        print(f"{name}: free run {run}")
    errors = {name: rmse(cycles, np.tile(y, len(cycles))) for name, y in simulated.items()}
    print(f"{len(cycles)} cycles: RMSE {errors['PWA']:.3f} rad/s (PWA), {errors['linear']:.3f} rad/s (linear); "
          f"spread of the cycles about their mean {(cycles - cycles.mean(axis=0)).std():.3f}")  # fmt: skip
    if arguments.save:
        draw(arguments.save, mesh, levels, t, current, cycles, simulated)
    print("RESULT " + json.dumps({
        "rmse_pwa": round(errors["PWA"], 4),
        "rmse_linear": round(errors["linear"], 4),
        "seconds_path": round(seconds, 1),
        "best_lambda_ratio": float(f"{path.best.lam / path.lambda_max:.4g}"),
    }))  # fmt: skip


def draw(folder, mesh, levels, t, current, cycles, simulated) -> None:
    """Table I and Fig. 9 of the paper, redrawn."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    figure, axes = plt.subplots(2, 3, figsize=(9, 5.2), sharex=True, sharey=True, layout="constrained")
    triangles = (mesh.points[:, 0], mesh.points[:, 1], mesh.simplices)
    # one scale of grey for the three levels: darker means a larger contribution (2011 eq. 17)
    shades = {name: PWAMap(mesh, s.values).extrapolation_error() for name, s in levels.items()}
    darkest = np.quantile(shades["moderate"], 0.995)
    for (above, below), (name, s) in zip(axes.T, levels.items(), strict=True):
        surface = above.tripcolor(*triangles, s.values, shading="gouraud", cmap="RdBu_r", rasterized=True)
        above.tricontour(*triangles, s.values, levels=12, colors="k", linewidths=0.5)
        above.set(title=f"{name} compression")
        below.tripcolor(*triangles, facecolors=shades[name], cmap="Greys", vmin=0, vmax=darkest, rasterized=True)
        below.set(xlabel="i [A]")
    figure.colorbar(surface, ax=axes[0], label="ω̇ [rad/s²]")
    axes[0, 0].set(ylabel="ω [rad/s]")
    axes[1, 0].set(ylabel="ω [rad/s]")
    figure.savefig(folder / "narx_dc_motor_levels.png", dpi=60)

    figure, (above, below) = plt.subplots(2, 1, figsize=(7, 4.5), sharex=True, layout="constrained")
    above.step(t, current, where="post", color="k")
    above.set(ylabel="i [A]", title="Periodic validation (2011, Fig. 9)")
    below.plot(t, cycles.T, color="tab:blue", lw=0.3, alpha=0.3)
    below.plot(t, simulated["PWA"], color="tab:red", lw=1.5, label="PWA")
    below.plot(t, simulated["linear"], color="tab:green", ls="--", label="linear")
    below.set(xlabel="t [s]", ylabel="ω [rad/s]")
    below.legend(fontsize=8, loc="upper right")
    figure.savefig(folder / "narx_dc_motor_validation.png", dpi=90)


if __name__ == "__main__":
    main()
