"""Simulation focus: refit a NARX model so that its free run, not its one-step prediction, meets the recordings.

    minimise over (ŷ, w)   ½ Σ_k (y(k) − y_sim(k; ŷ, w))² + λ ‖F ŷ‖₁

y_sim is the free run, so the problem is no longer convex. It is solved by Gauss–Newton steps from the one-step
solution: with S the derivative of the free run (`free_run.run_sensitivity`), each step is the hinge problem again,
with A replaced by S. A step is shortened until the objective falls, so the objective never rises. Free runs
may start afresh from measured outputs every `horizon` samples; a short horizon is easier, the whole recording is the
aim.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from pwaid.admm import solve_admm
from pwaid.dynamics import free_run
from pwaid.dynamics.narx import NARXProblem
from pwaid.dynamics.narx_model import NARXModel
from pwaid.dynamics.regressors import as_recordings
from pwaid.errors import InputError
from pwaid.problem import HingeProblem
from pwaid.recording import Recording
from pwaid.solve import check_lambda

__all__ = ["Refined", "free_run_scale", "refine", "refine_path"]

# A free run whose derivative grows beyond this is unstable over the stretch; no step can be computed from it.
STEEPEST = 1e6
# Levenberg's damping, as a fraction of the mean diagonal of SᵀS: vertices that no free run touches stay put.
DAMPING = 1e-5
SHORTEN = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01)


@dataclass(frozen=True, eq=False)
class Refined:
    """A refined model and how it came about.

    Attributes
    ----------
    model : NARXModel
    unknowns : ndarray, shape (n_points + n_w,)
        [ŷ, w], to start a neighbouring λ from.
    objective : tuple of float
        After each accepted step; decreasing.
    n_broken : int
        Broken hinges of the last step's convex problem.
    """

    model: NARXModel
    unknowns: np.ndarray
    objective: tuple[float, ...]
    n_broken: int


def _segments(recordings: Sequence[Recording], first: int, horizon: int | None) -> list[tuple[np.ndarray, np.ndarray]]:
    """Stretches (inputs, outputs) of at most first + horizon samples that start from measured outputs."""
    pieces = []
    for r in recordings:
        step = len(r) if horizon is None else horizon
        for k in range(first, len(r), step):
            pieces.append((r.inputs[k - first : k + step], r.outputs[k - first : k + step]))
    return pieces


def _simulate(model: NARXModel, complement: np.ndarray, pieces, rule: int, derivative: bool):
    """Residuals of all pieces, and S (or None); residuals are None when a free run diverged."""
    first = model.first
    lags = (model.lags.outputs, model.lags.inputs, int(model.lags.direct))
    residuals, parts = [], []
    for u, measured in pieces:
        y = np.zeros_like(measured)
        y[:first] = measured[:first]
        if derivative:
            S = np.zeros((len(y), model.mesh.n_points + complement.shape[1]))
            state = free_run.run_sensitivity(model.tables, y, u, lags, rule, model.limit, complement, S)[0]
            parts.append(S[first:])
        else:
            state = free_run.run(model.tables, y, u, lags, rule, model.limit)[0]
        if state != free_run.COMPLETE:
            return None, None
        residuals.append(measured[first:, 0] - y[first:, 0])
    return np.concatenate(residuals), np.vstack(parts) if derivative else None


def _linearised(residual, S, x, F, points) -> HingeProblem:
    """The hinge problem of one step: ½‖residual − S(ŷ − x)‖² + ½μ‖ŷ − x‖² beside λ‖Fŷ‖₁."""
    target = residual + S @ x
    H = S.T @ S
    mu = DAMPING * float(np.trace(H)) / len(x)
    H[np.diag_indices(len(x))] += mu
    yty = float(target @ target) + mu * float(x @ x)
    return HingeProblem.from_statistics(
        sparse.csc_matrix(H), S.T @ target + mu * x, yty, F, target.size + len(x), points=points
    )


def _descend(objective, x, move, value) -> tuple[np.ndarray, float] | None:
    """The longest of the shortened steps that lowers the objective below `value`, and to what; None if none does."""
    for t in SHORTEN:
        lowered = objective(x + t * move)
        if lowered < value:
            return x + t * move, lowered
    return None


def refine(
    problem: NARXProblem,
    unknowns: np.ndarray,
    recordings: Recording | Sequence[Recording],
    lam: float,
    *,
    horizon: int | None = None,
    steps: int = 15,
    tol: float = 1e-3,
    outside: str = "affine",
) -> Refined:
    """Gauss–Newton from `unknowns` towards the least free-run error.

    Parameters
    ----------
    problem : NARXProblem
        One output. Its mesh, C, W and F are used; keep n_points below about 1000: S is dense, (N, n_points).
    unknowns : ndarray, shape (n_points + n_w,)
        Where to start: the `values` of a one-step solution, or `Refined.unknowns`.
    recordings : Recording or sequence of Recording
        Estimation data.
    lam : float
        λ > 0 of the free-run problem; its scale differs from the one-step problem's.
    horizon : int, optional
        Samples between fresh starts; the whole recording by default.
    steps : int
        At most this many Gauss–Newton steps.
    tol : float
        Stop when a step lowers the objective by less than this fraction.

    Raises
    ------
    InputError
        λ ≤ 0, more than one output, or a starting model whose free run diverges.
    """
    lam = check_lambda(lam)
    if len(problem.problems) != 1:
        raise InputError(f"the model has {len(problem.problems)} outputs; refine takes one: refine each output alone")
    pieces = _segments(as_recordings(recordings), problem.lags.first, horizon)
    rule = free_run.RULES.index(outside)
    F, points = problem.problems[0].F, problem.problems[0]._points
    W = problem.complement
    x = np.array(unknowns, dtype=float)

    def evaluate(x, derivative):
        residual, S = _simulate(problem.model(x[:, None]), W, pieces, rule, derivative)
        if residual is None or (derivative and not np.abs(S).max() <= STEEPEST):
            return np.inf, None, None
        return 0.5 * float(residual @ residual) + lam * float(np.abs(F @ x).sum()), residual, S

    value, residual, S = evaluate(x, True)
    if residual is None:
        raise InputError("the free run of the starting model diverges; start from a larger λ, or set a short horizon")
    history, n_broken, warm = [value], 0, None
    for _ in range(steps):
        linear = _linearised(residual, S, x, F, points)
        try:
            solution = solve_admm(linear, lam, tol=1e-3, warm_start=warm, max_iterations=1000)
        except (ArithmeticError, RuntimeError):  # the derivative is too steep to factorise: keep what we have
            break
        warm, n_broken = solution.state, solution.n_broken
        shorter = _descend(lambda z: evaluate(z, False)[0], x, solution.values - x, value)
        if shorter is None:
            break
        x, lowered = shorter
        value, residual, S = evaluate(x, True)
        history.append(lowered)
        if residual is None or history[-2] - value < tol * history[-2]:
            break
    return Refined(problem.model(x[:, None]), x, tuple(history), n_broken)


def refine_path(
    problem: NARXProblem,
    start: np.ndarray,
    recordings: Recording | Sequence[Recording],
    ratios: Sequence[float],
    validation: Recording | Sequence[Recording],
    *,
    horizon: int | None = None,
    steps: int = 15,
    outside: str = "affine",
) -> tuple[list[Refined], np.ndarray]:
    """`refine` over decreasing λ, each from the one before, judged by free run on validation recordings.

    Parameters
    ----------
    start : ndarray, shape (n_points + n_w,)
        A one-step solution.
    ratios : sequence of float
        λ as multiples of (free-run loss / ‖Fŷ‖₁) at the start, which balances both terms at 1.

    Returns
    -------
    refined : list of Refined
        One a ratio.
    validation_rmse : ndarray, shape (len(ratios),)
        Infinite where the free run diverged.
    """
    recordings, validation = as_recordings(recordings), as_recordings(validation)
    scale = free_run_scale(problem, start, recordings, horizon=horizon, outside=outside)
    refined, errors, x = [], [], start
    for ratio in sorted(ratios, reverse=True):
        step = refine(problem, x, recordings, ratio * scale, horizon=horizon, steps=steps, outside=outside)
        refined.append(step)
        errors.append(step.model.free_run_rmse(validation, outside=outside))
        x = step.unknowns
    return refined, np.array(errors)


def free_run_scale(
    problem: NARXProblem,
    unknowns: np.ndarray,
    recordings: Recording | Sequence[Recording],
    *,
    horizon: int | None = None,
    outside: str = "affine",
) -> float:
    """The λ at which free-run loss and λ‖Fŷ‖₁ are equal."""
    pieces = _segments(as_recordings(recordings), problem.lags.first, horizon)
    model = problem.model(np.asarray(unknowns)[:, None])
    residual, _ = _simulate(model, problem.complement, pieces, free_run.RULES.index(outside), False)
    penalty = float(np.abs(problem.problems[0].F @ unknowns).sum())
    if residual is None:
        raise InputError("the free run of the starting model diverges; start from a larger λ, or set a short horizon")
    if penalty == 0.0:
        raise InputError("the starting model is affine; start from a solution with broken hinges")
    return 0.5 * float(residual @ residual) / penalty
