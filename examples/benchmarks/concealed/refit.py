"""How well can the nominal simulator, refitted, imitate the truth? Gauss–Newton on noise-free outputs.

This measures detectability: the rms of what is left, in units of the sensor noise, after free parameters and
one
initial state per recording have done all they can. It only fits; it knows no catalogue.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from concealed.integrate import simulate

WIDEST = np.log(5.0)


@dataclass(frozen=True)
class Fit:
    """Refitted parameters and, per recording, initial states and residuals divided by the noise."""

    p: np.ndarray
    x0: list
    residuals: list

    def ratio(self):
        """Rms residual in units of the noise: the largest over outputs."""
        r = np.concatenate(self.residuals)
        return float(np.sqrt((r**2).mean(axis=0)).max())


def refit(plant, p, e, free, recordings, sigma, outputs, *, hold="zero", move=True, slots=(), nsub=4,
          iterations=12):
    """Refit the nominal simulator `(p, e)` to recordings by output error.

    Parameters
    ----------
    free : sequence of int
        Indices of parameters that may move (by factors up to 5).
    recordings : list of (inputs, outputs, x0)
    sigma : array, shape (outputs,)
    slots : sequence of int
        Slots of the effect vector that share one more free factor (a rival law).
    move : bool
        False keeps the parameters and refits initial states only (held-out recordings).
    """
    free = list(free) if move else []
    slots = list(slots)
    theta = np.zeros(len(free) + bool(slots))
    starts = [np.array(x0, float) for _, _, x0 in recordings]
    scale = np.array([max(s, 1e-9) for s in plant.x0_spread])

    def residual(theta, x0, rec):
        q = np.array(p, float)
        q[free] *= np.exp(theta[:len(free)])
        rival = e.copy()
        rival[slots] *= np.exp(theta[-1]) if slots else 1.0
        _, _, y = simulate(plant, q, rival, x0, rec[0], nsub=nsub, outputs=outputs, hold=hold)
        return np.clip(np.nan_to_num((y - rec[1]) / sigma, nan=1e4), -1e4, 1e4)

    def everything(theta, starts):
        return [residual(theta, x, rec) for x, rec in zip(starts, recordings, strict=True)]

    current = everything(theta, starts)
    cost = sum((r**2).sum() for r in current)
    damping = 1e-3
    for _ in range(iterations):
        jtj, jtr = _normal(theta, starts, current, recordings, residual, scale)
        improved = False
        for _ in range(5):
            step = np.linalg.solve(jtj + damping * np.diag(np.diag(jtj) + 1e-9), -jtr)
            new_theta = np.clip(theta + step[: len(theta)], -WIDEST, WIDEST)
            moves = step[len(theta):].reshape(len(starts), -1) * scale
            new_starts = [x + d for x, d in zip(starts, moves, strict=True)]
            trial = everything(new_theta, new_starts)
            new_cost = sum((r**2).sum() for r in trial)
            if new_cost < cost:
                improved = True
                break
            damping *= 10.0
        if not improved:
            break
        gain = (cost - new_cost) / max(cost, 1e-12)
        theta, starts, current, cost = new_theta, new_starts, trial, new_cost
        damping = max(damping / 10.0, 1e-9)
        if gain < 1e-4:
            break
    q = np.array(p, float)
    q[free] *= np.exp(theta[:len(free)])
    return Fit(q, starts, current)


def _normal(theta, starts, current, recordings, residual, scale):
    """Normal equations by forward differences; initial states touch their own recording only."""
    n_theta, n_state = len(theta), len(scale)
    size = n_theta + n_state * len(starts)
    jtj = np.zeros((size, size))
    jtr = np.zeros(size)
    for i, (x0, rec, base) in enumerate(zip(starts, recordings, current, strict=True)):
        columns = []
        for j in range(n_theta):
            moved = theta.copy()
            moved[j] += 1e-4
            columns.append(((residual(moved, x0, rec) - base) / 1e-4).ravel())
        for j in range(n_state):
            moved = x0.copy()
            moved[j] += 1e-4 * scale[j]
            columns.append(((residual(theta, moved, rec) - base) / 1e-4).ravel())
        jac = np.column_stack(columns)
        where = np.r_[np.arange(n_theta), n_theta + n_state * i + np.arange(n_state)]
        jtj[np.ix_(where, where)] += jac.T @ jac
        jtr[where] += jac.T @ base.ravel()
    return jtj, jtr
