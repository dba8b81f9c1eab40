"""2014 Example 2: a rotary actuator with a harmonic drive, ω(k) = Π([ω(k−1), ω(k−2), u(k)]).

The recordings of the paper are not public; `pwaid.systems` has a stand-in, and its figures are not the paper's.
Repeats: RMSE of the free run over the λ path (Fig. 8), the free run beside a Hammerstein–Wiener and a linear model
(Fig. 9), the cyclic test (Fig. 10), and the time of a warm and of a cold start.

The paper's mesh has normal random points (`--mesh gaussian`, penalty as in the paper). The stand-in visits its plane
unevenly: fast reversals leave long tails, and standstill is a thin sheet. Normal points then put few vertices where
the data are, and free runs at small λ diverge, so the default is a mesh of the same size that follows the data, with
the mesh-independent penalty "htv".

    python maruta2014_rotary_actuator.py [--quick] [--mesh data|gaussian] [--save DIR]
"""

from __future__ import annotations

import argparse
import json
import time
from itertools import product
from pathlib import Path

import numpy as np

from pwaid.delaunay import Scaling, SimplexMesh
from pwaid.dynamics.compare import search_orders
from pwaid.dynamics.fit_measures import explained_percent, rmse
from pwaid.dynamics.narx import NARX
from pwaid.recording import Recording
from pwaid.systems.maruta2014 import RotaryActuator, maruta2014_rotary_actuator

FULL = {"n": 512_000, "train": (300_000, 400_000), "validation": (400_000, 500_000), "points": 10_000, "cycles": 200}
QUICK = {"n": 30_000, "train": (0, 15_000), "validation": (15_000, 30_000), "points": 600, "cycles": 10}
RATIOS = {"full": np.geomspace(1.0, 1e-4, 8), "quick": np.geomspace(1.0, 1e-4, 6)}


def record(size, rng):
    """Training and validation recordings of the stand-in."""
    u, omega = maruta2014_rotary_actuator(size["n"], rng)
    whole = Recording(
        0.01 * np.arange(len(u)), u, omega, input_names="u", output_names="omega", units={"u": "V", "omega": "rad/s"}
    )
    return whole[slice(*size["train"])], whole[slice(*size["validation"])]


def gaussian_mesh(X, n, rng):
    """Normal points with the mean and covariance of X, normalised by Σ^(−1/2), as in the paper.

    The eight corners of a box round the data are among the n points, so that no sample lies outside.
    """
    scaling = Scaling.covariance(X)
    Z = scaling.apply(X)
    middle, half = (Z.max(axis=0) + Z.min(axis=0)) / 2, 0.525 * np.ptp(Z, axis=0)
    corners = middle + half * np.array(list(product((-1, 1), repeat=X.shape[1])))
    inner = rng.multivariate_normal(X.mean(axis=0), np.cov(X.T), n - len(corners))
    return SimplexMesh.from_points(np.vstack([inner, scaling.undo(corners)]), scaling=scaling)


def compare(train, validation, quick):
    """Linear output-error and Hammerstein–Wiener models, orders searched on the validation data."""
    pair = [(r.inputs[:, 0], r.outputs[:, 0]) for r in (train, validation)]
    pair[1] = tuple(a[:20_000] for a in pair[1])  # enough to rank orders
    options = {"n_b": range(1, 4), "n_f": range(1, 4), "n_k": range(2)} if quick else {}
    evaluations = 12 if quick else 20
    return [search_orders(*pair, units=units, evaluations=evaluations, **options) for units in (0, 10)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a small run, under a minute")
    parser.add_argument("--mesh", choices=("data", "gaussian"), default="data", help="where the grid points lie")
    parser.add_argument("--save", type=Path, help="write figures to this directory")
    arguments = parser.parse_args()
    size = QUICK if arguments.quick else FULL
    rng = np.random.default_rng(2014)

    train, validation = record(size, rng)
    narx = NARX(output_lags=2, input_lags=0, direct=True)
    X, _ = narx.regressors(train)
    if arguments.mesh == "gaussian":
        problem = narx.problem(train, gaussian_mesh(X, size["points"], rng), weighting="pairs")
    else:
        problem = narx.problem(train, n_points=size["points"], rng=rng, weighting="htv")
    mesh = problem.mesh
    largest = problem.lambda_max()
    print(f"{len(train)} samples, {problem.n_dropped} outside the mesh; {mesh.n_points} points, "
          f"{mesh.n_simplices} simplices, {problem.problems[0].n_hinges} hinges; λmax = {largest:.4g}")  # fmt: skip

    began = time.perf_counter()
    lambdas = largest * RATIOS["quick" if arguments.quick else "full"]
    path = problem.path(lambdas, validation, tol=1e-3)
    seconds = time.perf_counter() - began
    print(f"mesh: {arguments.mesh}; path of {len(lambdas)} λ in {seconds:.1f} s (free runs included)")
    for lam, error, (s,) in zip(lambdas, path.free_run_rmse, path.solutions, strict=True):
        print(f"  λ/λmax {lam / largest:8.2e}  free-run RMSE {error:7.4f} rad/s  broken {s.n_broken:6d}  "
              f"gap {s.gap:.1e}  {s.seconds:5.1f} s")  # fmt: skip
    best = path.best_index
    run = path.best.simulate(validation)
    print(f"best free run: {run}")

    # warm: from the λ before; cold: from zero, to the same certified gap
    warm_seconds = path.solutions[best][0].seconds
    cold_seconds = problem.solve(lambdas[best], tol=1e-3)[0].seconds

    measured = validation.outputs[:, 0]
    u = validation.inputs[:, 0]
    linear, hammerstein = compare(train, validation, arguments.quick)
    simulated = {"linear output error": linear.model.simulate(u), "Hammerstein–Wiener": hammerstein.model.simulate(u)}
    explained = explained_percent(measured, run.outputs[:, 0])
    print(f"output RMS {np.sqrt(np.mean(measured**2)):.3f} rad/s")
    print(f"PWA: RMSE {run.rmse(measured):.4f} rad/s, {explained:.1f} % explained")
    for name, model in (("linear output error", linear), ("Hammerstein–Wiener", hammerstein)):
        y = simulated[name]
        print(f"{name}, orders {model.model.orders} of {len(model.tried)} tried: RMSE {rmse(measured, y):.4f} rad/s, "
              f"{explained_percent(measured, y):.1f} %")  # fmt: skip

    shares = {name: explained_percent(measured, y) for name, y in simulated.items()}
    t, cycle, responses = RotaryActuator().cyclic_test(size["cycles"], rng)
    periodic = np.tile(cycle, 3)  # the third period is free of the start
    settled = slice(2 * len(cycle), 3 * len(cycle))
    mean = responses.mean(axis=0)
    cyclic = {"PWA": path.best.free_run(periodic, np.zeros((2, 1))).outputs[settled, 0]}
    cyclic["Hammerstein–Wiener"] = hammerstein.model.simulate(periodic)[settled]
    for name, y in cyclic.items():
        print(f"cyclic test, {size['cycles']} cycles: {name} RMSE to the mean response {rmse(mean, y):.4f} rad/s "
              f"(spread of the cycles {responses.std(axis=0).mean():.4f})")  # fmt: skip
    if arguments.save:
        cyclic_test = (t, cycle, responses, cyclic)
        draw(arguments.save, path, largest, validation, run, simulated["Hammerstein–Wiener"], cyclic_test)
    print("RESULT " + json.dumps({
        "explained_percent": round(explained, 3),
        "hammerstein_wiener_explained_percent": round(shares["Hammerstein–Wiener"], 3),
        "linear_explained_percent": round(shares["linear output error"], 3),
        "rmse_rad_s": round(run.rmse(measured), 5),
        "hammerstein_wiener_rmse_rad_s": round(rmse(measured, simulated["Hammerstein–Wiener"]), 5),
        "cyclic_rmse_rad_s": round(rmse(mean, cyclic["PWA"]), 5),
        "cyclic_hammerstein_wiener_rmse_rad_s": round(rmse(mean, cyclic["Hammerstein–Wiener"]), 5),
        "best_lambda_ratio": float(f"{lambdas[best] / largest:.4g}"),
        "warm_seconds": round(warm_seconds, 2),
        "cold_seconds": round(cold_seconds, 2),
    }))  # fmt: skip


def draw(folder, path, largest, validation, run, hammerstein, cyclic) -> None:
    """Figures 8–10 of the paper, redrawn."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    figure, axis = plt.subplots(figsize=(5, 3), layout="constrained")
    axis.loglog(path.lambdas / largest, path.free_run_rmse, "o-")
    axis.set(xlabel="λ/λmax", ylabel="free-run RMSE [rad/s]", title="Free run over the λ path (2014, Fig. 8)")
    figure.savefig(folder / "narx_rotary_path.png", dpi=90)

    last = slice(len(validation) - 1000, None)
    figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
    t = validation.time[last] - validation.time[last][0]
    axis.plot(t, validation.outputs[last, 0], color="tab:red", lw=2.5, alpha=0.6, label="device (stand-in)")
    axis.plot(t, run.outputs[last, 0], color="tab:blue", lw=1, label="PWA, free run")
    axis.plot(t, hammerstein[last], color="tab:green", lw=1, ls="--", label="Hammerstein–Wiener")
    axis.set(xlabel="t [s]", ylabel="ω [rad/s]", title="Last 10 s of the validation data (2014, Fig. 9)")
    axis.legend(loc="upper right", fontsize=8)
    figure.savefig(folder / "narx_rotary_validation.png", dpi=90)

    t, cycle, responses, models = cyclic
    figure, (above, below) = plt.subplots(2, 1, figsize=(7, 4.5), sharex=True, layout="constrained")
    above.step(t, cycle, where="post", color="k")
    above.set(ylabel="u [V]", title="Cyclic test (2014, Fig. 10)")
    below.plot(t, responses.T, color="tab:red", lw=0.3, alpha=0.3)
    below.plot(t, models["PWA"], color="tab:blue", label="PWA")
    below.plot(t, models["Hammerstein–Wiener"], color="tab:green", ls="--", label="Hammerstein–Wiener")
    below.set(xlabel="t [s]", ylabel="ω [rad/s]")
    below.legend(fontsize=8)
    figure.savefig(folder / "narx_rotary_cyclic.png", dpi=90)


if __name__ == "__main__":
    main()
