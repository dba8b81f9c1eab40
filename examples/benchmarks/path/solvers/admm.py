"""The papers' ADMM as pwaid has it."""

from path.objective import Answer
from pwaid.admm import solve_admm

NAME = "ADMM"


def solve(problem, lam, tol, state=None):
    s = solve_admm(problem, lam, tol=tol, warm_start=state)
    return Answer(s.values, s.nu, s.iterations, s.state)
