"""λmax as a linear programme by HiGHS's interior point method, as SciPy ships it."""

from __future__ import annotations

import time

import numpy as np
from scipy import sparse
from scipy.optimize import linprog

__all__ = ["lambda_max"]


def lambda_max(problem, time_limit: float) -> tuple[float, float]:
    """λmax (NaN when the time ran out) and CPU seconds, for min t subject to Fᵀz = c, −t ≤ z ≤ t."""
    m = problem.n_hinges
    F, c = problem.F, problem.c
    eye, ones = sparse.eye_array(m), -np.ones((m, 1))
    cost = np.append(np.zeros(m), 1.0)
    G = sparse.block_array([[eye, ones], [-eye, ones]])
    E = sparse.hstack([F.T, sparse.csc_matrix((F.shape[1], 1))])
    began = time.process_time()
    options = {"time_limit": time_limit}
    bounds = [(None, None)] * m + [(0, None)]
    r = linprog(cost, G, np.zeros(2 * m), E, c, bounds=bounds, method="highs-ipm", options=options)
    return (float(r.fun) if r.fun is not None else np.nan), time.process_time() - began
