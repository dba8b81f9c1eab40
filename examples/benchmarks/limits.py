"""How far the mesh carries: facets, time and memory for d = 1…6, and data where trees and networks win.

Part 1: a mesh of N̂ vertices in d dimensions (uniform), N = 4000 samples of a noisy ridge; one solve at 0.01 λmax to a
certified gap of 1e-3. Part 2: 9568 samples of a smooth function of four correlated inputs with interactions, made to
resemble the combined-cycle power plant data (narrow ranges, noise a quarter of the signal): held-out RMSE beside
gradient boosting, a random forest and a small network.
"""

from __future__ import annotations

import json
import sys
import time
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor, RandomForestRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

import pwaid

sys.path.insert(0, str(Path(__file__).parents[1]))
from _common import options, result


def dimension_row(d: int, n: int) -> dict:
    rng = np.random.default_rng(d)
    X = rng.uniform(-1, 1, (4000, d))
    y = np.abs(X.sum(axis=1)) + 0.1 * rng.standard_normal(len(X))
    tracemalloc.start()
    began = time.perf_counter()
    mesh = pwaid.SimplexMesh.uniform([[-1, 1]] * d, n, rng)
    meshed = time.perf_counter()
    problem = pwaid.HingeProblem.from_data(mesh, X, y, weighting="htv")
    assembled = time.perf_counter()
    lam = 0.01 * np.abs(problem.c).sum() / problem.n_points
    solution = pwaid.solve(problem, lam, tol=1e-3)
    solved = time.perf_counter()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return {
        "d": d, "vertices": mesh.n_points, "simplices": mesh.n_simplices, "facets": problem.n_hinges,
        "facets_per_vertex": problem.n_hinges / mesh.n_points, "mesh_s": meshed - began,
        "assembly_s": assembled - meshed, "solve_s": solved - assembled, "gap": solution.gap,
        "python_peak_MB": peak / 1e6,
    }


def plant(n: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """Four correlated inputs and a smooth output with interactions, noise 0.25 of the signal's deviation."""
    mixing = np.array([[1.0, 0.0, 0.0, 0.0], [0.84, 0.54, 0.0, 0.0], [-0.5, -0.1, 0.86, 0.0], [-0.54, 0.2, 0.1, 0.8]])
    Z = rng.standard_normal((n, 4)) @ mixing.T
    signal = -1.5 * Z[:, 0] - 0.4 * np.tanh(Z[:, 1]) + 0.2 * np.sin(2 * Z[:, 2]) * Z[:, 0]
    signal += 0.25 * np.cos(3 * Z[:, 1]) * np.exp(-(Z[:, 3] ** 2)) + 0.1 * Z[:, 2] * Z[:, 3]
    return Z, signal + 0.25 * signal.std() * rng.standard_normal(n)


def rivals(quick: bool) -> dict:
    rng = np.random.default_rng(0)
    n = 2000 if quick else 9568
    Z, y = plant(n, rng)
    cut = int(0.8 * n)
    models = {
        "pwaid (d = 4)": pwaid.PWARegressor(200 if quick else 800, cv=3, n_lambdas=8, random_state=0),
        "gradient boosting": HistGradientBoostingRegressor(random_state=0),
        "random forest": RandomForestRegressor(100, random_state=0),
        "network 64-64": make_pipeline(
            StandardScaler(), MLPRegressor(hidden_layer_sizes=(64, 64), early_stopping=True, random_state=0)
        ),
    }
    rows = {}
    for name, model in models.items():
        began = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            error = model.fit(Z[:cut], y[:cut]).predict(Z[cut:]) - y[cut:]
        rows[name] = {"rmse": float(np.sqrt(np.mean(error**2))), "seconds": time.perf_counter() - began}
    return rows


def main():
    chosen = options(__doc__.splitlines()[0])
    sizes = {1: 1000, 2: 1000, 3: 1000, 4: 1000, 5: 1000, 6: 300}
    if chosen.quick:
        sizes = {1: 300, 2: 300, 3: 300, 4: 200, 5: 100}
    dimension_row(2, 50)  # compile
    print("| d | N̂ | simplices | facets | facets/N̂ | mesh s | A and F s | solve s | gap | peak MB |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    rows = []
    for d, n in sizes.items():
        r = dimension_row(d, n)
        rows.append(r)
        print(f"| {d} | {r['vertices']} | {r['simplices']} | {r['facets']} | {r['facets_per_vertex']:.1f} | "
              f"{r['mesh_s']:.2f} | {r['assembly_s']:.2f} | {r['solve_s']:.2f} | {r['gap']:.0e} | "
              f"{r['python_peak_MB']:.0f} |", flush=True)
    table = rivals(chosen.quick)
    print("\n| model on plant-like data, d = 4 | held-out RMSE | s |\n|---|---|---|")
    for name, row in table.items():
        print(f"| {name} | {row['rmse']:.4f} | {row['seconds']:.1f} |")
    if chosen.save:
        (chosen.save / "limits.json").write_text(json.dumps({"dimensions": rows, "rivals": table}, indent=1))
    result(facets_per_vertex={str(r["d"]): r["facets_per_vertex"] for r in rows},
           rmse={name: row["rmse"] for name, row in table.items()})


if __name__ == "__main__":
    main()
