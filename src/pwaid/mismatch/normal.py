"""The normal equations at a fit, start states eliminated: what an error of the outputs does to the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pwaid.mismatch.fit import Fit, jacobian, output_rows, weighted
from pwaid.mismatch.nullfit import Problem

__all__ = ["NormalEquations", "normal_equations"]

WIDE = 3.0  # times the fit's difference steps, to both sides: kinks of the cost average out


@dataclass(frozen=True)
class NormalEquations:
    """Sensitivities G (N ny, n) and residual r (N ny,), weighted and without what start states can absorb.

    `inverse` (n, n) is (GᵀG + P)⁻¹ with P = diag(`prior`²), the soft prior of the nominal parameters; `left` (n,) is
    the Gauss-Newton step that the fit has still to go, within the bounds.
    """

    G: np.ndarray
    r: np.ndarray
    prior: np.ndarray
    inverse: np.ndarray
    left: np.ndarray
    blocks: Sequence[tuple[slice, np.ndarray, np.ndarray]]

    def without_starts(self, v: np.ndarray) -> np.ndarray:
        """A weighted output signal (N ny,) or several (N ny, m), less what start states can absorb."""
        return _without_starts(self.blocks, v)

    def bias(self, s: np.ndarray) -> np.ndarray:
        """Shift of the fitted parameters, (n,) or (n, m), when the outputs change by s (start states taken out)."""
        return self.inverse @ (self.G.T @ s)

    def unabsorbed(self, s: np.ndarray) -> np.ndarray:
        """What the parameters leave of s (start states taken out)."""
        return s - self.G @ self.bias(s)


def normal_equations(problem: Problem, fit: Fit) -> NormalEquations:
    """Linearise a fit on the training recordings; two Jacobians, differences to both sides."""
    data, model = problem.train, fit.model
    bounds = model.bounds(data.sample_time)
    up = jacobian(model, fit.theta, fit.X0, data, problem.sigma, fit.Y, problem.ranges, bounds=bounds, wide=WIDE)
    down = jacobian(model, fit.theta, fit.X0, data, problem.sigma, fit.Y, problem.ranges, want_states=False,
                    wide=-WIDE)
    blocks = []
    for rows in output_rows(data):
        S = up.S[rows] * model.start_ranges(problem.ranges)
        blocks.append((rows, S, S.T @ S + 1e-9 * np.eye(S.shape[1]) * (np.trace(S.T @ S) + 1e-12)))
    G = _without_starts(blocks, 0.5 * (up.G + down.G))
    r = _without_starts(blocks, weighted(fit.Y, data, problem.sigma))
    prior = np.concatenate([1 / np.log1p(model.settings.tolerance), np.zeros(model.nz)])
    H = G.T @ G
    H[np.diag_indices_from(H)] += prior**2 + 1e-10 * (1 + np.diag(H))
    inverse = np.linalg.pinv(H)
    aim = np.clip(fit.theta + inverse @ (G.T @ r - prior**2 * fit.theta), *bounds)
    return NormalEquations(G, r, prior, inverse, aim - fit.theta, blocks)


def _without_starts(blocks, v):
    v = v.copy()
    for rows, S, A in blocks:
        v[rows] -= S @ np.linalg.solve(A, S.T @ v[rows])
    return v
