"""Backlash drive: half gap, stiffness and damping of the joint from simulated recordings with both encoders.

The drive is the bench of Yamada, Ruderman and Fujimoto (`pwaid.systems.yamada2018_bench`, a stand-in: its recordings
are not public). The encoders give the twist θ_B = θ_M − θ_L and its rate ω_B, the sensor the joint torque. The PWA map
T = Π(θ_B, ω_B) is learnt without being told that there is a gap; then half gap, stiffness and damping are read off
from its two outer flanks, K(θ_B ∓ β) + D_B ω_B. The true torque jumps at first contact by D_B ω_B, which a continuous
map can only approximate: samples of the flanks are taken clear of the edge.

    python backlash_identification.py [--quick] [--save DIR]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt

from pwaid.delaunay import Scaling, SimplexMesh
from pwaid.path import solve_path
from pwaid.problem import HingeProblem
from pwaid.pwa_map import PWAMap
from pwaid.systems.yamada2018_bench import Bench

CUTOFF_HZ = 2000.0


def record(bench: Bench, seconds: float, oversample: int, rng):
    """An open-loop run: random torque held for 8 ms about a slow sine, so that both flanks are met often."""
    n = round(seconds * bench.rate)
    hold = round(0.008 * bench.rate)
    t = np.arange(n) / bench.rate
    torque = 1.5 * np.sin(2 * np.pi * 1.0 * t) + np.repeat(rng.normal(0, 1.0, -(-n // hold)), hold)[:n]
    return bench.open_loop(torque, oversample=oversample, rng=rng)


def twist(run) -> tuple[np.ndarray, np.ndarray]:
    """(θ_B, ω_B) from both encoders by a zero-phase filter, and the filtered torque; ends left out."""
    dt = run.time[1] - run.time[0]
    sections = butter(2, CUTOFF_HZ, fs=1.0 / dt, output="sos")
    theta = sosfiltfilt(sections, run.theta_M - run.theta_L)
    torque = sosfiltfilt(sections, run.T_s)
    keep = slice(200, -200)
    return np.column_stack([theta, np.gradient(theta, dt)])[keep], torque[keep]


def flank_law(pwa: PWAMap, X: np.ndarray) -> tuple[float, float, float]:
    """Half gap, stiffness, damping: least squares through the map at the samples in clear contact on either side.

    Clear contact: past the edge by a quarter of the way to the largest twist. The edge is first taken where the map's
    torque exceeds 15 % of its largest magnitude, then at the half gap found.
    """
    T = pwa(X, outside="affine")
    theta, omega = X.T
    largest = np.quantile(np.abs(theta), 0.999)
    edge = np.abs(theta)[np.abs(T) > 0.15 * np.quantile(np.abs(T), 0.999)].min()
    for _ in range(3):
        clear = np.abs(theta) > edge + 0.25 * (largest - edge)
        basis = np.column_stack([theta, omega, -np.sign(theta)])[clear]
        stiffness, damping, preload = np.linalg.lstsq(basis, T[clear], rcond=None)[0]
        edge = preload / stiffness
    return edge, stiffness, damping


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a shorter recording and a coarser mesh")
    parser.add_argument("--save", type=Path, help="write figures to this directory")
    arguments = parser.parse_args()
    rng = np.random.default_rng(2018)
    bench = Bench(torque_noise=0.02)
    seconds, n_points = (4.0, 400) if arguments.quick else (20.0, 1500)
    X, T = twist(record(bench, seconds, 8, rng))
    X_val, T_val = twist(record(bench, seconds / 4, 8, rng))

    mesh = SimplexMesh.from_data(X, n_points, rng, scaling=Scaling.covariance(X))
    problem = HingeProblem.from_data(mesh, X, T)
    inside = mesh.contains(X_val)
    path = solve_path(
        problem, n_lambdas=8, ratio=1e-5, tol=1e-3, X_val=X_val[inside], y_val=T_val[inside], mesh=mesh
    )
    print(path)
    pwa = PWAMap(mesh, path.best.values)
    truth = (bench.plant.beta, bench.plant.K, bench.plant.D_B)
    found = flank_law(pwa, X)
    errors = [100.0 * abs(f / t - 1.0) for f, t in zip(found, truth, strict=True)]
    for name, f, t, e in zip(("half gap [rad]", "stiffness [N m/rad]", "damping [N m s/rad]"), found, truth, errors,
                             strict=True):  # fmt: skip
        print(f"{name:>20}: {f:.5g}, truth {t:.5g}, error {e:.2f} %")
    if arguments.save:
        draw(arguments.save, X, T, pwa)
    print("RESULT " + json.dumps({
        "half_gap_error_percent": round(errors[0], 3),
        "stiffness_error_percent": round(errors[1], 3),
        "damping_error_percent": round(errors[2], 3),
    }))  # fmt: skip


def draw(folder: Path, X: np.ndarray, T: np.ndarray, pwa: PWAMap) -> None:
    """The learnt torque over the twist, at three rates."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    theta = np.linspace(*np.quantile(X[:, 0], [0.001, 0.999]), 400)
    figure, axis = plt.subplots(figsize=(6, 3.5), layout="constrained")
    axis.plot(1e3 * X[::20, 0], T[::20], ".", ms=1, color="0.7", label="samples")
    for rate in (-2.0, 0.0, 2.0):
        torque = pwa(np.column_stack([theta, np.full_like(theta, rate)]), outside="affine")
        axis.plot(1e3 * theta, torque, label=f"ω_B = {rate:+.0f} rad/s")
    axis.set(xlabel="θ_B [mrad]", ylabel="joint torque [N m]", title="Backlash: the learnt map")
    axis.legend(fontsize=8)
    figure.savefig(folder / "narx_backlash.png", dpi=90)


if __name__ == "__main__":
    main()
