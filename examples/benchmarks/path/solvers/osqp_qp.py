"""OSQP, warm-started along the path as it offers."""

import numpy as np
import osqp

from path.objective import Answer
from path.solvers import qp

NAME = "OSQP"
TIME_LIMIT = 60.0


def solve(problem, lam, tol, state=None):
    P, G = qp.matrices(problem)
    n, m = problem.n_points, problem.n_hinges
    solver = osqp.OSQP()
    solver.setup(
        P, qp.linear(problem, lam), G, np.full(2 * m, -np.inf), np.zeros(2 * m), verbose=False, eps_abs=tol,
        eps_rel=tol, max_iter=200_000, time_limit=TIME_LIMIT,
    )  # fmt: skip
    if state is not None:
        solver.warm_start(x=state[0], y=state[1])
    r = solver.solve()
    y = np.asarray(r.y)
    return Answer(np.asarray(r.x)[:n] + problem.affine_values, y[:m] - y[m:], r.info.iter, (r.x, r.y))
