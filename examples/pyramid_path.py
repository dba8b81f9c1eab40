"""2014 Example 1: a pyramid seen through noise, over the whole regularisation path (Fig. 4).

y = max(1 − |x₁| − |x₂|, 0) + η, η ~ N(0, 0.1²), |x|_∞ < 1.1; N = 2000 samples to learn, 2000 to choose λ, N̂ = 8830
uniform grid points, λ from 2 λmax to 1e-4 λmax. Full size: ten seeds, the papers' penalty ("pairs") and the Hessian
total variation ("htv"); errors are against the noise-free pyramid on 20 000 fresh points.
"""

from __future__ import annotations

import time

import numpy as np

import pwaid
from _common import options, result
from pwaid import plotting

BOX = [[-1.1, 1.1]] * 2
NOISE = 0.1


def pyramid(X):
    return np.maximum(1.0 - np.abs(X).sum(axis=1), 0.0)


def run(seed: int, n_points: int, n_lambdas: int, tol: float, weightings=("pairs", "htv")):
    """The paths of one seed: {weighting: (path, RMSE against the truth at the chosen λ, seconds)}."""
    rng = np.random.default_rng(seed)
    X, X_val = rng.uniform(-1.1, 1.1, (2, 2000, 2))
    X_test = rng.uniform(-1.1, 1.1, (20_000, 2))
    y, y_val = (pyramid(Z) + NOISE * rng.standard_normal(2000) for Z in (X, X_val))
    mesh = pwaid.SimplexMesh.uniform(BOX, n_points, rng)
    runs = {}
    for weighting in weightings:
        began = time.perf_counter()
        problem = pwaid.HingeProblem.from_data(mesh, X, y, weighting=weighting)
        path = pwaid.solve_path(
            problem, n_lambdas=n_lambdas, start=2.0, ratio=1e-4, tol=tol, X_val=X_val, y_val=y_val, mesh=mesh
        )
        error = float(np.sqrt(np.mean((path.best.map(X_test) - pyramid(X_test)) ** 2)))
        runs[weighting] = path, error, time.perf_counter() - began
    return runs


def figure(path, folder):
    """2014 Fig. 4: the error over λ, and the map at the weakest, the chosen and the strongest λ."""
    fig, ax = plotting.new_figure(size=(11, 7.5))
    ax.remove()
    places = fig.add_gridspec(2, 3)
    plotting.plot_path(path, fig.add_subplot(places[0, :]), noise=NOISE)
    for column, solution in enumerate((path.solutions[-1], path.best, path.solutions[0])):
        surface = fig.add_subplot(places[1, column], projection="3d")
        plotting.plot_surface(solution.map, surface)
        surface.set_title(rf"$\lambda$ = {solution.lam / path.lambda_max:.2g} $\lambda^{{\max}}$")
        surface.set_zlim(-0.2, 1.1)
    fig.savefig(folder / "pyramid_path.png", dpi=110)
    fig, axes = plotting.new_figure(1, 2, (11, 4.4))
    plotting.plot_map(path.best.map, axes[0])
    plotting.plot_shading(path.best.map, axes[1])
    fig.savefig(folder / "pyramid_map.png", dpi=110)


def main():
    chosen = options(__doc__.splitlines()[0], seeds=(10, "how many seeds at full size"))
    seeds, n_points, n_lambdas, tol = (2, 2000, 15, 1e-3) if chosen.quick else (chosen.seeds, 8830, 30, 1e-4)
    errors, ratios = {"pairs": [], "htv": []}, []
    for seed in range(seeds):
        runs = run(seed, n_points, n_lambdas, tol)
        for weighting, (path, error, seconds) in runs.items():
            ratio = path.best.lam / path.lambda_max
            errors[weighting].append(error)
            if weighting == "pairs":
                ratios.append(ratio)
            print(
                f"seed {seed} {weighting:5s} λmax {path.lambda_max:7.4f}  chosen {ratio:.2e} λmax  "
                f"RMSE to the truth {error:.5f}  worst gap {path.gaps.max():.0e}  {seconds:6.1f} s",
                flush=True,
            )
        if seed == 0 and chosen.save:
            print(runs["pairs"][0])
            figure(runs["pairs"][0], chosen.save)
    medians = {w: float(np.median(e)) for w, e in errors.items()}
    spread = {w: (float(np.min(e)), float(np.max(e))) for w, e in errors.items()}
    print(f"median RMSE against the truth over {seeds} seeds: {medians}; range {spread}")
    result(
        rmse_truth_pairs=medians["pairs"],
        rmse_truth_htv=medians["htv"],
        best_lambda_ratio=float(np.median(ratios)),
        seeds=seeds,
        n_points=n_points,
    )


if __name__ == "__main__":
    main()
