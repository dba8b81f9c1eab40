"""The problems: the pyramid of 2014 Example 1, and an actuator with friction in the place of 2014 Example 2's."""

from __future__ import annotations

import numba
import numpy as np

from pwaid.delaunay import SimplexMesh
from pwaid.problem import HingeProblem

__all__ = ["friction_actuator", "pyramid"]


def pyramid(n_points: int = 8830, n_samples: int = 2000, seed: int = 0, weighting: str = "pairs") -> HingeProblem:
    """max(1 − |x₁| − |x₂|, 0) with noise 0.1 on [−1.1, 1.1]² (2014 eq. 20), uniform samples and mesh points."""
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1.1, 1.1, (n_samples, 2))
    y = np.maximum(1.0 - np.abs(X).sum(axis=1), 0.0) + 0.1 * rng.standard_normal(n_samples)
    mesh = SimplexMesh.uniform([[-1.1, 1.1]] * 2, n_points, rng)
    return HingeProblem.from_data(mesh, X, y, weighting=weighting)


def friction_actuator(n_points: int = 10_000, n_samples: int = 100_000, seed: int = 0) -> HingeProblem:
    """ω(k) from (ω(k − 1), ω(k − 2), u(k)) of a simulated actuator with Stribeck friction (2014 eq. 21–22).

    Sampled every 10 ms; the torque command changes every 0.1 s, normally distributed with deviation 1 V.
    """
    rng = np.random.default_rng(seed)
    command = np.repeat(rng.standard_normal(n_samples // 10 + 2), 10)[: n_samples + 2]
    speed = _simulate(command) + 0.05 * rng.standard_normal(n_samples + 2)
    X = np.column_stack([speed[1:-1], speed[:-2], command[2:]])
    mesh = SimplexMesh.gaussian(X, n_points, rng)
    return HingeProblem.from_data(mesh, X, speed[2:], outside="drop")


@numba.njit(cache=True)
def _simulate(command):
    """Speed in rad/s: inertia, viscous and Stribeck friction, 100 explicit steps a sample."""
    speed = np.zeros(command.size)
    v, step = 0.0, 1e-4
    for k in range(1, command.size):
        for _ in range(100):
            friction = (0.3 + 0.2 * np.exp(-((v / 1.0) ** 2))) * np.tanh(v / 0.1) + 0.03 * v
            v += step * 80.0 * (command[k] - friction)
        speed[k] = v
    return speed
