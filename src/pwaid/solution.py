"""What every solver returns, and what a λ path keeps."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np

from pwaid.errors import InputError, SolverError
from pwaid.problem import HingeProblem
from pwaid.pwa_map import PWAMap

__all__ = ["Path", "Solution", "Status", "affine_solution"]


class Status(Enum):
    """How a solve ended; the text advises."""

    SOLVED = "the certified gap is within the tolerance"
    MAX_ITERATIONS = (
        "max_iterations was reached before the tolerance; the gap reported is what is certified: "
        "raise max_iterations, start from a neighbouring λ (warm_start), or try method='clarabel'"
    )
    STALLED = (
        "rounding stopped the progress before the tolerance; the gap reported is what is certified: "
        "ask for a larger tol, or normalise the inputs (scaling=)"
    )
    FAILED = "the solver broke down; see the message, and try another method or a blue-noise mesh"

    @property
    def ok(self) -> bool:
        """Whether the tolerance was met."""
        return self is Status.SOLVED


@dataclass(frozen=True, eq=False)
class Solution:
    """One solution of the hinge problem.

    Attributes
    ----------
    values : ndarray, shape (n_points,)
        ŷ at the mesh vertices.
    lam : float
        λ.
    objective : float
        ½‖y − Aŷ‖² + λ‖Fŷ‖₁ at `values`.
    gap : float
        Certified relative gap (P − D)/P of `values`.
    status : Status
        How the solve ended.
    iterations : int
        Of the method.
    seconds : float
        Wall time, assembly excluded.
    method : str
        Which solver.
    nu : ndarray, shape (n_hinges,)
        The dual vector ν with Aᵀr = Fᵀν that carries the certificate.
    n_broken : int
        Number of broken hinges.
    state : object
        What `warm_start` takes; its content belongs to the method.
    map : PWAMap, optional
        The map, when the mesh is known.
    message : str
        Detail from the solver, if any.
    """

    values: np.ndarray
    lam: float
    objective: float
    gap: float
    status: Status
    iterations: int
    seconds: float
    method: str
    nu: np.ndarray
    n_broken: int
    state: Any = None
    map: PWAMap | None = None
    message: str = ""

    def __post_init__(self) -> None:
        self.values.setflags(write=False)
        self.nu.setflags(write=False)

    def on(self, mesh: Any) -> Solution:
        """A copy that carries its map on the mesh."""
        return replace(self, map=PWAMap(mesh, self.values))

    def require_ok(self) -> Solution:
        """Itself, or `SolverError` when the tolerance was not met."""
        if not self.status.ok:
            raise SolverError(f"{self.method} at λ = {self.lam:.4g} ended with gap {self.gap:.1e}: {self.status.value}")
        return self


def affine_solution(problem: HingeProblem, lam: float, seconds: float = 0.0) -> Solution:
    """The affine fit where it is best at every λ."""
    values = problem.affine_values.copy()
    return Solution(
        values=values,
        lam=lam,
        objective=problem.objective(values, lam),
        gap=0.0,
        status=Status.SOLVED,
        iterations=0,
        seconds=seconds,
        method="affine",
        nu=np.zeros(problem.n_hinges),
        n_broken=0,
        message="y is affine to rounding" if problem.is_exact else "no hinge lowers the error",
    )


@dataclass(frozen=True, eq=False)
class Path:
    """Solutions over a decreasing grid of λ.

    Attributes
    ----------
    lambdas : ndarray, shape (n,)
        Decreasing.
    solutions : tuple of Solution
        One a λ, failed ones included (their `status` says so).
    lambda_max : float
        The smallest λ with a flat solution; NaN for an explicit grid.
    validation_rmse : ndarray, shape (n,), optional
        RMSE on held-out data, in the unit of y; NaN where a solve failed.
    validation_se : ndarray, shape (n,), optional
        Its standard error, when it was estimated.
    rule : {"min", "1se"}
        How `best` is chosen: the smallest error, or the largest λ within one standard error of it.
    """

    lambdas: np.ndarray
    solutions: tuple[Solution, ...]
    lambda_max: float
    validation_rmse: np.ndarray | None = None
    validation_se: np.ndarray | None = None
    rule: str = "min"
    warnings: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.solutions)

    @property
    def gaps(self) -> np.ndarray:
        """Certified gaps, shape (n,)."""
        return np.array([s.gap for s in self.solutions])

    @property
    def n_broken(self) -> np.ndarray:
        """Numbers of broken hinges, shape (n,)."""
        return np.array([s.n_broken for s in self.solutions])

    @property
    def seconds(self) -> float:
        """Total solve time."""
        return float(sum(s.seconds for s in self.solutions))

    @cached_property
    def best_index(self) -> int:
        """Position of the chosen λ.

        Raises
        ------
        InputError
            The path was computed without held-out data.
        """
        rmse = self.validation_rmse
        if rmse is None or np.all(np.isnan(rmse)):
            raise InputError("this path has no validation error; pass X_val and y_val, or use cross_validate")
        least = int(np.nanargmin(rmse))
        if self.rule == "1se" and self.validation_se is not None:
            within = np.flatnonzero(rmse <= rmse[least] + self.validation_se[least])
            return int(within[0])
        return least

    @property
    def best(self) -> Solution:
        """The solution at the chosen λ."""
        return self.solutions[self.best_index]

    def __str__(self) -> str:
        head = f"{'λ/λmax':>10}  {'broken':>7}  {'gap':>8}  {'s':>6}"
        chosen = -1
        if self.validation_rmse is not None:
            head += f"  {'held-out RMSE':>13}"
            chosen = self.best_index
        rows = [head]
        for i, s in enumerate(self.solutions):
            row = f"{s.lam / self.lambda_max if self.lambda_max else np.nan:10.3e}  {s.n_broken:7d}"
            row += f"  {s.gap:8.1e}  {s.seconds:6.2f}"
            if self.validation_rmse is not None:
                row += f"  {self.validation_rmse[i]:13.5g}" + ("  ← best" if i == chosen else "")
            rows.append(row)
        return "\n".join(rows)
