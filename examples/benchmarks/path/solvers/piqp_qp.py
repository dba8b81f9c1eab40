"""PIQP, an interior point method with a proximal term."""

import numpy as np
import piqp

from path.objective import Answer
from path.solvers import qp

NAME = "PIQP"


def solve(problem, lam, tol, state=None):
    P, G = qp.matrices(problem)
    n, m = problem.n_points, problem.n_hinges
    solver = piqp.SparseSolver()
    solver.settings.verbose = False
    solver.settings.eps_abs = solver.settings.eps_rel = tol
    solver.setup(P, qp.linear(problem, lam), None, None, G, np.full(2 * m, -np.inf), np.zeros(2 * m))
    solver.solve()
    r = solver.result
    z = np.asarray(r.z_u)
    return Answer(np.asarray(r.x)[:n] + problem.affine_values, z[:m] - z[m:], r.info.iter)
