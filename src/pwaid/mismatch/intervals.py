"""Confidence intervals that survive coloured residuals: a block sandwich around the fit."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.stats import t as student

from pwaid.mismatch.fit import Fit, jacobian
from pwaid.mismatch.hygiene import leads_input
from pwaid.mismatch.nullfit import Problem

__all__ = ["covariance", "feedback_widening", "parameter_intervals"]


def covariance(problem: Problem, fit: Fit, blocks: int = 40) -> np.ndarray:
    """Covariance of the global parameters on the fitted axis, start states projected out.

    H⁻¹ (Σ_b g_b g_bᵀ) H⁻¹ with the gradient summed over blocks of time, so that neighbouring errors
    may be correlated; never smaller than the white-noise formula.
    """
    data, model = problem.train, fit.model
    J = jacobian(model, fit.theta, fit.X0, data, problem.sigma, fit.Y, problem.ranges,
                 bounds=model.bounds(data.sample_time))
    r = np.clip((data.Y - fit.Y) / problem.sigma, -1e3, 1e3).ravel()
    ny = data.Y.shape[1]
    G = J.G.copy()
    for a, b in data.segments[:, :2]:
        s = slice(int(a) * ny, int(b) * ny)
        S = J.S[s] * problem.ranges
        A = S.T @ S + 1e-9 * np.eye(S.shape[1]) * (np.trace(S.T @ S) + 1e-12)
        G[s] -= S @ np.linalg.solve(A, S.T @ G[s])
    H = G.T @ G
    prior = np.concatenate([1 / np.log1p(model.settings.tolerance), np.zeros(model.nz)])
    H[np.diag_indices_from(H)] += prior**2 + 1e-10 * (1 + np.diag(H))
    inverse = np.linalg.pinv(H)
    meat = np.zeros_like(H)
    per = max(1, blocks // len(data.recordings))
    for a, b in data.recordings:
        edges = np.linspace(a, b, per + 1).astype(int) * ny
        for i, j in itertools.pairwise(edges):
            g = G[i:j].T @ r[i:j]
            meat += np.outer(g, g)
    white = inverse * float(r @ r) / max(len(r) - len(H), 1)
    robust = inverse @ meat @ inverse * blocks / max(blocks - len(H), 1)
    scale = np.sqrt(np.maximum(np.diag(white), 0) / np.maximum(np.diag(robust), 1e-300))
    scale = np.maximum(scale, 1.0)
    return robust * np.outer(scale, scale)


def feedback_widening(problem: Problem, fit: Fit) -> float:
    """Factor on the intervals' half-width for recordings in closed loop; 1 in open loop.

    In closed loop an error bends later inputs, and with them the sensitivities g that the fit leans on. With c the
    correlation of errors and later inputs and rho that of neighbouring errors, g and r may correlate by about c rho
    where a fit in open loop has 1/sqrt(N): a bias of up to c rho sqrt(N) standard deviations, added in squares.
    White errors (rho = 0) bend nothing.
    """
    if not problem.settings.feedback:
        return 1.0
    data = problem.train
    r = data.Y - fit.Y
    rho = max([0.0] + [float(e[1:] @ e[:-1] / max(e @ e, 1e-300)) for e in (r - r.mean(0)).T])
    return float(np.sqrt(1.0 + len(r) * (leads_input(data, r) * rho) ** 2))


def parameter_intervals(problem: Problem, fit: Fit, level: float = 0.9):
    """Low and high of every global parameter on the fitted axis, and the correlation matrix."""
    C = covariance(problem, fit)
    width = student.ppf(0.5 + level / 2, 20) * np.sqrt(np.maximum(np.diag(C), 0))
    width = width * feedback_widening(problem, fit)
    d = np.sqrt(np.maximum(np.diag(C), 1e-300))
    return fit.theta - width, fit.theta + width, C / np.outer(d, d)
