"""pwaid's engine."""

from path.objective import Answer
from pwaid.engine import solve_engine

NAME = "engine"


def solve(problem, lam, tol, state=None):
    s = solve_engine(problem, lam, tol=tol, warm_start=state)
    return Answer(s.values, s.nu, s.iterations, s.state)
