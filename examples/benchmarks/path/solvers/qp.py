"""The hinge problem as a quadratic programme in (v, s), v relative to the affine fit.

    minimise ½ vᵀHv − cᵀv + λ Σ s   subject to Fv − s ≤ 0, −Fv − s ≤ 0
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import sparse

__all__ = ["matrices"]


@lru_cache(maxsize=1)
def matrices(problem):
    """P and G of the programme; the same for every λ."""
    m = problem.n_hinges
    eye = sparse.eye_array(m)
    P = sparse.block_diag([problem.H, sparse.csc_matrix((m, m))]).tocsc()
    G = sparse.block_array([[problem.F, -eye], [-problem.F, -eye]]).tocsc()
    return P, G


def linear(problem, lam):
    """The linear term."""
    return np.concatenate([-problem.c, np.full(problem.n_hinges, lam)])
