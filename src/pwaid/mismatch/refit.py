"""Refit a fitted hypothesis to outputs that another one made: a few chord Gauss-Newton steps.

    minimise over (θ, x0)   Σ ‖(target - ŷ(θ, x0))/σ‖² + Σ (a/prior)²

The hypothesis starts from its own fit to the recordings, which the maker of the target fits too, so the steps are
small and one Jacobian serves them all. That makes a refit cost three simulations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Jacobian, jacobian, output_rows
from pwaid.mismatch.hypotheses import Hypothesis
from pwaid.mismatch.nullfit import Problem

__all__ = ["Refitter", "noise_of", "times_noise"]

DAMPINGS = (1e-4, 1e-1)
CLIP = 1e4


def noise_of(problem: Problem) -> np.ndarray:
    """The noise floor per output (ny,), never below 1e-5 of the output's spread."""
    return np.maximum(problem.floor.level, 1e-5 * np.std(problem.train.Y, axis=0) + 1e-300)


def times_noise(a, b, noise) -> float:
    """RMS difference of two output signals (N, ny) in units of the noise, of the output that tells most."""
    d = np.clip((a - b) / noise, -CLIP, CLIP)
    return float(np.sqrt(np.max(np.mean(d**2, axis=0))))


@dataclass
class Refitter:
    """A hypothesis with its simulation and Jacobian over `data`, ready to be refitted to other outputs.

    `X0` (n_segments, nx): start states over `data`, `ranges` (nx,) their magnitudes. `noise` (ny,): weights.
    `known`: how many of the last segments start from states that are known, and not refitted.
    """

    hypothesis: Hypothesis
    data: Dataset
    X0: np.ndarray
    noise: np.ndarray
    ranges: np.ndarray
    known: int = 0

    def __post_init__(self):
        self.model, self.theta = self.hypothesis.fit.model, self.hypothesis.fit.theta
        self.X0, self.ranges = self.model.opened(self.X0), self.model.start_ranges(self.ranges)
        self.Y = self.model.simulate(self.theta, self.X0, self.data)[0]
        self.bounds = self.model.bounds(self.data.sample_time)
        self.J: Jacobian = jacobian(self.model, self.theta, self.X0, self.data, self.noise, self.Y, self.ranges,
                                    bounds=self.bounds)
        ny = self.Y.shape[1]
        for a, b in self.data.segments[len(self.data.segments) - self.known:, :2]:
            self.J.S[int(a) * ny:int(b) * ny] = 0.0

    def refit(self, target, steps: int = 2) -> np.ndarray:
        """Outputs (N, ny) of the refit to `target` (N, ny) after at most `steps` steps for each damping."""
        theta, X0, Y = self.theta, self.X0, self.Y
        cost = self._cost(Y, theta, target)
        for mu in DAMPINGS:
            for _ in range(steps):
                d, starts = self._step(target, Y, theta, mu)
                new = np.clip(theta + d, *self.bounds)
                moved = self.model.simulate(new, X0 + starts, self.data)[0]
                after = self._cost(moved, new, target)
                if not after < cost:
                    break
                done = cost - after < 1e-3 * cost
                theta, X0, Y, cost = new, X0 + starts, moved, after
                if done:
                    return Y
        return Y

    def _weighted(self, Y, target):
        return np.clip((target - Y) / self.noise, -CLIP, CLIP).ravel()

    def _cost(self, Y, theta, target) -> float:
        r = self._weighted(Y, target)
        cost = float(r @ r + np.sum((self._prior * theta) ** 2))
        return cost if np.isfinite(cost) else np.inf

    @property
    def _prior(self) -> np.ndarray:
        return np.concatenate([1 / np.log1p(self.model.settings.tolerance), np.zeros(self.model.nz)])

    def _step(self, target, Y, theta, mu):
        """One damped Gauss-Newton step; the start states of every segment are eliminated by least squares."""
        r = self._weighted(Y, target)
        G, left, saved = self.J.G.copy(), r.copy(), []
        for rows in output_rows(self.data):
            S = self.J.S[rows] * self.ranges
            S = np.vstack([S, 1e-5 * np.linalg.norm(S, axis=0).max(initial=1e-12) * np.eye(S.shape[1])])
            zero = np.zeros((S.shape[1], G.shape[1] + 1))
            both = np.vstack([np.column_stack([self.J.G[rows], r[rows]]), zero])
            solution = np.linalg.lstsq(S, both, rcond=None)[0]
            fitted = (S @ solution)[:rows.stop - rows.start]
            G[rows] -= fitted[:, :-1]
            left[rows] -= fitted[:, -1]
            saved.append(solution)
        H = G.T @ G + np.diag(self._prior**2)
        H += np.diag(mu * np.diag(H) + 1e-12 * (1 + np.max(np.diag(H), initial=0.0)))
        d = np.linalg.solve(H, G.T @ left - self._prior**2 * theta) if len(H) else np.zeros(0)
        starts = np.array([(s[:, -1] - s[:, :-1] @ d) * self.ranges for s in saved])
        return d, starts
