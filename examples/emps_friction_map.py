"""EMPS: friction of a ball-screw axis as a PWA map, force = Π(velocity, acceleration).

Reads PWAID_DATA/emps/DATA_EMPS.mat (1 kHz, Janot, Gautier, Brunot 2019). Velocity and acceleration: central
differences of the position after a zero-phase filter (Butterworth of order 4, run forwards and backwards, 60 Hz);
the force gtau·vir goes through the same filter. 0.5 s at either end are left out (filter transient). Stretches of
1 s are taken in turn to estimate, to choose λ, and to judge: the last ones are never used for anything else.

    python emps_friction_map.py [--quick] [--save DIR]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.signal import butter, sosfiltfilt

from pwaid.delaunay import Scaling, SimplexMesh
from pwaid.path import solve_path
from pwaid.problem import HingeProblem
from pwaid.pwa_map import PWAMap

FILE = "emps/DATA_EMPS.mat"
CUTOFF_HZ = 60.0
STRETCH_S = 1.0
SLOW = 0.01  # m/s, either side of standstill


def load() -> dict:
    """Time, position and force of the estimation record."""
    folder = os.environ.get("PWAID_DATA")
    if not folder or not (Path(folder) / FILE).is_file():
        sys.exit(f"{FILE} is missing: set PWAID_DATA to the folder of real recordings that holds it")
    content = loadmat(Path(folder) / FILE)
    return {
        "t": content["t"].ravel(),
        "q": content["qm"].ravel(),
        "force": float(content["gtau"].ravel()[0]) * content["vir"].ravel(),
    }


def motion(data: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(velocity, acceleration) in m/s and m/s², force in N, and time in s, without the ends."""
    dt = float(np.median(np.diff(data["t"])))
    sections = butter(4, CUTOFF_HZ, fs=1.0 / dt, output="sos")
    q, force = sosfiltfilt(sections, data["q"]), sosfiltfilt(sections, data["force"])
    velocity = np.gradient(q, dt)
    acceleration = np.gradient(velocity, dt)
    keep = slice(round(0.5 / dt), -round(0.5 / dt))
    return np.column_stack([velocity, acceleration])[keep], force[keep], data["t"][keep]


def parts(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masks of the estimation, λ-choice and held-out stretches: 3, 1 and 1 of every 5."""
    turn = ((t - t[0]) // STRETCH_S).astype(int) % 5
    return np.isin(turn, (0, 2, 3)), turn == 1, turn == 4


def friction_mesh(X: np.ndarray, n_velocity: int, n_acceleration: int) -> SimplexMesh:
    """A grid over velocity and acceleration whose velocity steps shrink towards zero, where friction jumps."""
    v = 1.03 * np.abs(X[:, 0]).max()
    a_low, a_high = X[:, 1].min(), X[:, 1].max()
    margin = 0.03 * (a_high - a_low)
    s = np.linspace(-1.0, 1.0, n_velocity)
    velocities = v * np.sign(s) * np.abs(s) ** 2.5
    accelerations = np.linspace(a_low - margin, a_high + margin, n_acceleration)
    P = np.array([(x, y) for x in velocities for y in accelerations])
    return SimplexMesh.from_points(P, scaling=Scaling.units(X.std(axis=0)))


def jump_at_standstill(X: np.ndarray, pwa: PWAMap) -> tuple[float, float]:
    """The change of force from −SLOW to +SLOW, N, at the median |acceleration| of the crossings, m/s².

    The mean over crossings in both directions; where the recording has no samples the map only interpolates.
    """
    near = np.abs(X[:, 0]) < SLOW
    a = float(np.median(np.abs(X[near, 1])))
    ends = pwa(np.array([[sign * SLOW, way * a] for way in (-1.0, 1.0) for sign in (-1.0, 1.0)]), outside="affine")
    return float(np.mean(ends[1::2] - ends[::2])), a


def relative_error(measured: np.ndarray, predicted: np.ndarray) -> float:
    """100·‖measured − predicted‖/‖measured‖."""
    return 100.0 * float(np.linalg.norm(measured - predicted) / np.linalg.norm(measured))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a coarser mesh and fewer λ")
    parser.add_argument("--save", type=Path, help="write figures to this directory")
    arguments = parser.parse_args()
    X, force, t = motion(load())
    train, choose, test = parts(t)

    mesh = friction_mesh(X, *((31, 9) if arguments.quick else (61, 21)))
    problem = HingeProblem.from_data(mesh, X[train], force[train], weighting="htv", outside="drop")
    path = solve_path(
        problem, n_lambdas=8 if arguments.quick else 16, ratio=1e-7, tol=1e-3, X_val=X[choose], y_val=force[choose],
        mesh=mesh,
    )  # fmt: skip
    print(path)
    pwa = PWAMap(mesh, path.best.values)
    basis = lambda X: np.column_stack([X[:, 1], X[:, 0], np.ones(len(X))])  # noqa: E731
    viscous = np.linalg.lstsq(basis(X[train]), force[train], rcond=None)[0]
    error = relative_error(force[test], pwa(X[test], outside="affine"))
    viscous_error = relative_error(force[test], basis(X[test]) @ viscous)
    print(f"held-out force error: PWA {error:.2f} %, viscous friction only {viscous_error:.2f} %")

    jump, crossing = jump_at_standstill(X, pwa)
    print(f"across zero velocity, at the {crossing:.2f} m/s² at which the recording crosses it, the force of the map "
          f"changes by {jump:.1f} N between ∓{SLOW} m/s (published Coulomb friction: 2·20.4 = 40.8 N)")  # fmt: skip
    if arguments.save:
        draw(arguments.save, X, force, pwa)
    print("RESULT " + json.dumps({
        "heldout_force_error_percent": round(error, 3),
        "viscous_force_error_percent": round(viscous_error, 3),
        "jump_at_zero_velocity_n": round(jump, 2),
    }))  # fmt: skip


def draw(folder: Path, X: np.ndarray, force: np.ndarray, pwa: PWAMap) -> None:
    """Friction at zero acceleration, and the samples of small acceleration."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    v = np.linspace(X[:, 0].min(), X[:, 0].max(), 2000)
    slow = np.abs(X[:, 1]) < 0.2
    figure, axis = plt.subplots(figsize=(6, 3.5), layout="constrained")
    axis.plot(X[slow, 0], force[slow], ".", ms=1.5, color="0.6", label="|acceleration| < 0.2 m/s²")
    axis.plot(v, pwa(np.column_stack([v, 0 * v])), color="tab:blue", lw=2, label="PWA map at zero acceleration")
    axis.set(xlabel="velocity [m/s]", ylabel="force [N]", title="EMPS: friction learnt from the recording")
    axis.legend(fontsize=8, loc="upper left")
    figure.savefig(folder / "narx_emps_friction.png", dpi=90)


if __name__ == "__main__":
    main()
