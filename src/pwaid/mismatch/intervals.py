"""Confidence intervals: a block sandwich for coloured residuals, and what residuals cannot show added to it."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.stats import t as student

from pwaid.mismatch.discrepancy import discrepancy
from pwaid.mismatch.fit import Fit
from pwaid.mismatch.hygiene import leads_input
from pwaid.mismatch.normal import NormalEquations, normal_equations
from pwaid.mismatch.nullfit import Problem

__all__ = ["covariance", "feedback_widening", "parameter_intervals"]

IDLE = 1e-12  # of the sum of squares of the weighted outputs, per unit of the fitted axis: nothing
WIDEST = 50.0  # on the fitted axis: e^50 times the scale means unknown


def covariance(problem: Problem, normal: NormalEquations, blocks: int = 40) -> np.ndarray:
    """Covariance (n, n) of the global parameters on the fitted axis, from the residuals and the prior.

    H⁻¹ (Σ_b g_b g_bᵀ + P) H⁻¹ with H = GᵀG + P and the gradient g summed over blocks of time, so that neighbouring
    errors may be correlated; never smaller than the white-noise formula. P stands in the middle too: a direction that
    only the prior holds is as uncertain as the tolerances say.
    """
    data, G, r, inverse = problem.train, normal.G, normal.r, normal.inverse
    ny, n = data.Y.shape[1], len(inverse)
    meat = np.zeros_like(inverse)
    per = max(1, blocks // len(data.recordings))
    for a, b in data.recordings:
        edges = np.linspace(a, b, per + 1).astype(int) * ny
        for i, j in itertools.pairwise(edges):
            g = G[i:j].T @ r[i:j]
            meat += np.outer(g, g)
    white = inverse * float(r @ r) / max(len(r) - n, 1)
    robust = inverse @ (meat * blocks / max(blocks - n, 1) + np.diag(normal.prior**2)) @ inverse
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
    """Low and high of every global parameter on the fitted axis, and the correlation matrix of the covariance.

    The variance is that of `covariance`, widened in closed loop, plus the second moment of the bias by small effects
    left out (`pwaid.mismatch.discrepancy`), which is not noise and has no part in the correlations. A parameter that
    does nothing to the outputs may be anything within its bounds.
    """
    normal = normal_equations(problem, fit)
    C = covariance(problem, normal)
    variance = np.diag(C) * feedback_widening(problem, fit) ** 2 + np.diag(discrepancy(problem, fit, normal))
    width = np.minimum(student.ppf(0.5 + level / 2, 20) * np.sqrt(np.maximum(variance, 0)), WIDEST)
    d = np.sqrt(np.maximum(np.diag(C), 1e-300))
    idle = np.sum(normal.G**2, axis=0) + normal.prior**2 < IDLE
    low, high = (np.where(idle, bound, end) for bound, end in zip(
        fit.model.bounds(problem.train.sample_time), (fit.theta - width, fit.theta + width), strict=True))
    return low, high, C / np.outer(d, d)
