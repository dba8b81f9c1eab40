"""Clarabel, one thread, with the backend named in BACKEND."""

import clarabel
import numpy as np
from scipy import sparse

from path.objective import Answer
from path.solvers import qp

NAME = "Clarabel"
BACKEND = "auto"


def solve(problem, lam, tol, state=None):
    P, G = qp.matrices(problem)
    n, m = problem.n_points, problem.n_hinges
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.direct_solve_method = BACKEND
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tol
    cones = [clarabel.NonnegativeConeT(2 * m)]
    b = np.zeros(2 * m)
    r = clarabel.DefaultSolver(sparse.triu(P).tocsc(), qp.linear(problem, lam), G, b, cones, settings).solve()
    z = np.asarray(r.z)
    return Answer(np.asarray(r.x)[:n] + problem.affine_values, z[:m] - z[m:], r.iterations)
