"""What every solver is judged by: its time, and the certified gap of the point it returns."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from pwaid.problem import HingeProblem

__all__ = ["Answer", "Judged", "judge", "run"]


@dataclass(frozen=True)
class Answer:
    """What a solver hands in: ŷ, a multiplier ν (need not be feasible), and what it wants back for the next λ."""

    values: np.ndarray
    nu: np.ndarray
    iterations: int
    state: Any = None


@dataclass(frozen=True)
class Judged:
    """An answer, its times in seconds, and its certified gap."""

    answer: Answer
    wall: float
    cpu: float
    objective: float
    gap: float


def judge(problem: HingeProblem, lam: float, values: np.ndarray, nu: np.ndarray) -> tuple[float, float]:
    """Objective and certified relative gap.

    The multiplier is made to fulfil the dual equation by one solve, twice: with equal weights, and with weights
    that move it least where it is near its bound. The better bound counts.
    """
    slack = np.maximum(1e-3, 1.0 - np.minimum(np.abs(nu) / lam, 1.0))
    gaps = []
    for weights in (1.0 / problem.row_norms**2, slack / problem.row_norms**2):
        certificate = problem.certify(values, nu, lam, weights=weights)[0]
        gaps.append(certificate.gap)
    return certificate.primal, min(gaps)


def run(solver: Any, problem: HingeProblem, lam: float, tol: float, state: Any = None) -> Judged:
    """Time one solve (assembly excluded) and judge it."""
    wall, cpu = time.perf_counter(), time.process_time()
    answer = solver.solve(problem, lam, tol, state)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return Judged(answer, wall, cpu, *judge(problem, lam, answer.values, answer.nu))
