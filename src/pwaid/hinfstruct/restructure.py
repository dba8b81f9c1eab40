"""Restructuring: from a black-box model to the structure physics gives, min || G(s, theta) - target(s) ||_inf
(6).

`restructure` treats one operating point, `restructure_path` several along a scheduling variable, each helping
its neighbours. Stages: starts -> Levenberg-Marquardt on a frequency grid -> the best stable one -> (L-BFGS)
-> a nonsmooth method, unless the certified lower bound is met already.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import control
import numpy as np

from pwaid.errors import InputError, SolverError
from pwaid.hinfstruct.balance import balance
from pwaid.hinfstruct.nonsmooth import NonsmoothRun, proximity_bundle
from pwaid.hinfstruct.norm import HinfNorm, hinf_norm
from pwaid.hinfstruct.problem import MatchingProblem
from pwaid.hinfstruct.proxlinear import prox_linear
from pwaid.hinfstruct.smooth import lbfgs, levenberg_marquardt, parameter_scale
from pwaid.hinfstruct.starts import null_space_start
from pwaid.hinfstruct.statespace import Matrices, as_matrices, difference, freeze
from pwaid.hinfstruct.structured import StructuredModel

__all__ = ["METHODS", "Restructured", "restructure", "restructure_path"]

METHODS = ("lm", "lbfgs", "bundle", "prox-linear")


@dataclass(frozen=True)
class Restructured:
    """A structured model fitted to a black box, with what certifies it.

    Attributes
    ----------
    theta : array, shape (size,)
    model : StructuredModel
    target : Matrices
        What was approximated.
    norm : HinfNorm
        Of G(theta) - target, recomputed from the returned model.
    lower_bound : float
        No theta of this structure does better (0 when the structure fixes no response); see ``bound_reason``.
    bound_reason : str
    stationarity : float
        Shortest convex combination of active gradients relative to the value, per relative parameter change;
        0 at a stationary point.
    converged : bool
        The lower bound is met within 0.1 %, or the nonsmooth method ended with no decrease left in its local
        model.
    predicted_decrease : float
        That remaining relative decrease, of the local model with its proximity term; ``stationarity`` is
        the measure without one.
    start : str
        Which start led here.
    starts : tuple of (name, value)
        The H-infinity error after Levenberg-Marquardt from each start (inf: unstable).
    trace : array
        Value per iteration of the last stage.
    """

    theta: np.ndarray
    model: StructuredModel
    target: Matrices
    norm: HinfNorm
    lower_bound: float
    bound_reason: str
    stationarity: float
    converged: bool
    predicted_decrease: float
    start: str
    starts: tuple[tuple[str, float], ...]
    trace: np.ndarray = field(repr=False)

    def __post_init__(self):
        freeze(self)

    @property
    def value(self) -> float:
        """The achieved H-infinity distance (unsquared)."""
        return self.norm.value

    @property
    def at_bound(self) -> bool:
        """The structure allows no smaller error (within 0.1 %):

        Theta is then not unique, see `identifiability`.
        """
        return self.value <= 1.001 * self.lower_bound

    @property
    def system(self) -> control.StateSpace:
        return self.model.statespace(self.theta)

    @property
    def parameters(self) -> dict[str, float]:
        return dict(zip(self.model.names, map(float, self.theta), strict=True))


@dataclass(frozen=True)
class _Candidate:
    name: str
    theta: np.ndarray
    value: float


def restructure(
    model: StructuredModel,
    target,
    *,
    start=None,
    method: str = "prox-linear",
    restarts: int = 0,
    perturbation: float = 0.3,
    max_iterations: int | None = None,
    match_static_gain: bool = False,
    rng=None,
) -> Restructured:
    """Fit a structured model to a black-box model of any order in the H-infinity norm.

    Parameters
    ----------
    model : StructuredModel
    target : control.StateSpace or tuple (A, B, C, D)
        Continuous, stable.
    start : array or sequence of arrays, optional
        Starting theta, tried besides the automatic ones: the nominal values, and for affine patterns
        `null_space_start` on the target, reduced by balanced truncation to the structure's order.
    method : "lm", "lbfgs", "bundle" or "prox-linear"
        The last stage. "bundle" is the paper's (L-BFGS, then proximity-control bundle); "prox-linear" keeps
        the spectral norm exact and is usually faster and no worse.
    restarts : int
        Further starts: the best theta so far with every entry changed by up to ``perturbation``, relative. Where every
        start ended in an unstable model, up to six new null-space starts and then six of these are tried unasked.
    max_iterations : int, optional
        Of the nonsmooth stage (default 300 bundle, 80 prox-linear).
    match_static_gain : bool
        Where the structure fixes G(0), fit target(s) target(0)^-1 G(0) instead, which removes a static error
        that no theta can follow and makes theta unique again; ``norm`` still refers to the given target.
    rng : optional

    Returns
    -------
    Restructured

    Raises
    ------
    InputError
        Bad target, start or option.
    SolverError
        Every start ended in an unstable model.
    """
    _check_method(method)
    given = as_matrices(target, "target")
    problem, fitted = _problem(model, given, match_static_gain)
    rng = np.random.default_rng(rng)
    candidates = _descend(fitted, _starts(model, fitted.targets[0], start, rng))
    best = min(candidates, key=lambda c: c.value)
    for _ in range(RESCUES):
        if np.isfinite(best.value):
            break
        candidates += _descend(fitted, _drawn(model, fitted.targets[0], rng))
        best = min(candidates, key=lambda c: c.value)
    if not np.isfinite(best.value):
        best, restarts = candidates[0], max(restarts, RESCUES)
    if restarts:
        shaken = [
            (
                f"restart {k + 1}", best.theta * (1 + perturbation * rng.uniform(-1, 1, model.size))
            ) for k in range(restarts)
        ]
        candidates += _descend(fitted, shaken)
    return _finish(problem, fitted, candidates, method, max_iterations)


def restructure_path(
    models: StructuredModel | Sequence[StructuredModel],
    targets: Sequence,
    *,
    starts: Sequence | None = None,
    method: str = "prox-linear",
    max_iterations: int | None = None,
    match_static_gain: bool = False,
    rng=None,
) -> list[Restructured]:
    """Restructure along a scheduling variable; the targets come in its order.

    Each point is solved from its own starts; then the neighbours' theta, and its extrapolation from two
    neighbours, serve as starts in sweeps back and forth until no point improves. Parameters as in
    `restructure`; ``starts`` holds one start (or list of starts) per point.

    Raises
    ------
    InputError
        Numbers of models, targets and starts differ.
    SolverError
        A point stayed unstable from every start.
    """
    _check_method(method)
    targets = [as_matrices(t, f"target {i}") for i, t in enumerate(targets)]
    models = [models] * len(targets) if isinstance(models, StructuredModel) else list(models)
    starts = [None] * len(targets) if starts is None else list(starts)
    if not targets or not len(models) == len(targets) == len(starts):
        raise InputError(
            f"{len(models)} models, {len(targets)} targets, {len(starts)} starts; expected one each per point"
        )
    rng = np.random.default_rng(rng)
    problems = [_problem(m, t, match_static_gain) for m, t in zip(models, targets, strict=True)]
    found = [
        _descend(fitted, _starts(m, fitted.targets[0], s, rng))
        for (_, fitted), m, s in zip(problems, models, starts, strict=True)
    ]
    _exchange(problems, found)
    results = [
        _finish(p, f, c, method, max_iterations, i)
        for i, ((p, f), c) in enumerate(zip(problems, found, strict=True))
    ]
    if method == "lm":
        return results
    # What the nonsmooth stage found may lead a neighbour into a better basin, too.
    for i, result in enumerate(results):
        nearby = [
            (
                f"final of point {j}", results[j].theta
            ) for j in (i - 1, i + 1) if 0 <= j < len(results) and not result.at_bound
        ]
        fresh = _descend(problems[i][1], nearby)
        best = min(fresh, key=lambda c: c.value, default=None)
        if best is not None and best.value < 0.98 * result.value:
            results[i] = _finish(*problems[i], found[i] + fresh, method, max_iterations, i)
    return results


RESCUES = 6  # new random starts, then restarts, that are tried unasked where every start ends in an unstable model


def _check_method(method: str) -> None:
    if method not in METHODS:
        raise InputError(f"method = {method!r}; expected one of {METHODS}")


def _problem(
    model: StructuredModel, target: Matrices, match_static_gain: bool
) -> tuple[MatchingProblem, MatchingProblem]:
    """The problem as given and the one to be fitted."""
    problem = MatchingProblem.build(model, target)
    if not match_static_gain:
        return problem, problem
    fixed = problem.static_gains()[0]
    if fixed is None:
        raise InputError(
            "match_static_gain needs a structure whose G(0) does not depend on theta; leave it False"
        )
    right = np.linalg.lstsq(problem.targets[0].at_zero(), fixed, rcond=None)[0]
    m = problem.targets[0]
    return problem, MatchingProblem.build(model, Matrices(m.A, m.B @ right, m.C, m.D @ right))


def _starts(model: StructuredModel, target: Matrices, start, rng) -> list[tuple[str, np.ndarray]]:
    chosen = []
    if start is not None:
        listed = [start] if all(np.ndim(s) == 0 for s in start) else list(start)
        low, high = model.bounds
        for k, theta in enumerate(listed):
            theta = model.check(theta)
            outside = [n for n, t, a, b in zip(model.names, theta, low, high, strict=True) if not a <= t <= b]
            if outside:
                raise InputError(
                    f"start {k + 1} violates the bounds of {outside}; move it inside, or widen the bounds"
                )
            chosen.append((f"given {k + 1}", theta))
    if np.isfinite(model.nominal).all():
        chosen.append(("nominal", model.nominal))
    chosen += _drawn(model, target, rng)
    if not chosen:
        raise InputError(
            "no start: give start=, or nominal values to the parameters (no automatic start applies here)"
        )
    return chosen


def _drawn(model: StructuredModel, target: Matrices, rng) -> list[tuple[str, np.ndarray]]:
    """The random start of an affine pattern, where it applies and comes to an end."""
    order = model.matrices(np.zeros(model.size)).order if model.affine else np.inf
    if target.order < order:
        return []
    try:
        reduced = balance(target, order=order).system
        return [("null space", null_space_start(model, reduced, rng=rng))]
    except (InputError, SolverError, np.linalg.LinAlgError):
        return []  # this start is an offer; the others stand


def _descend(problem: MatchingProblem, starts) -> list[_Candidate]:
    """Levenberg-Marquardt from each start; the better one of start and end counts."""
    out = []
    for name, theta in starts:
        theta = np.clip(theta, *problem.bounds)
        end = levenberg_marquardt(problem, theta)
        options = [(problem.value(t), t) for t in (end, theta)]
        value, best = min(options, key=lambda o: o[0])
        out.append(_Candidate(name, best if np.isfinite(value) else end, value))
    return out


def _exchange(problems, found: list[list[_Candidate]], sweeps: int = 3) -> None:
    """Continuation:

    Neighbours' theta as starts, back and forth, until nothing improves. Extends ``found`` in place.
    """
    n = len(problems)
    bounds = [fitted.lower_bound()[0] for _, fitted in problems]
    tried: list[set] = [set() for _ in range(n)]

    def best(i: int) -> _Candidate:
        return min(found[i], key=lambda c: c.value)

    for _ in range(sweeps):
        improved = False
        for step in (1, -1):
            for i in range(n)[::step]:
                j, k = i - step, i - 2 * step
                if not 0 <= j < n or not np.isfinite(best(j).value) or best(i).value <= 1.001 * bounds[i]:
                    continue
                offers = [(f"neighbour {j}", best(j).theta)]
                if 0 <= k < n and np.isfinite(best(k).value):
                    offers.append((f"extrapolated from {k}, {j}", 2 * best(j).theta - best(k).theta))
                offers = [o for o in offers if o[1].tobytes() not in tried[i]]
                tried[i].update(o[1].tobytes() for o in offers)
                fresh = _descend(problems[i][1], offers)
                improved |= min((c.value for c in fresh), default=np.inf) < 0.98 * best(i).value
                found[i].extend(fresh)
        if not improved:
            return


def _finish(problem, fitted, candidates, method, max_iterations, point: int | None = None) -> Restructured:
    """The last stage from the best candidate, and the certificates."""
    best = min(candidates, key=lambda c: c.value)
    if not np.isfinite(best.value):
        where = "" if point is None else f"point {point}: "
        raise SolverError(
            f"{where}every start ended in an unstable model ({', '.join(c.name for c in candidates)}); "
            "give a start= near the physical values, or raise restarts"
        )
    bound = fitted.lower_bound()[0]
    run = _last_stage(fitted, best, method, max_iterations, bound)
    model, target = problem.models[0], problem.targets[0]
    norm = hinf_norm(difference(as_matrices(model.statespace(run.theta)), target))
    lower, reason = problem.lower_bound()
    return Restructured(
        theta=run.theta,
        model=model,
        target=target,
        norm=norm,
        lower_bound=lower,
        bound_reason=reason,
        stationarity=fitted.stationarity(run.theta, parameter_scale(run.theta)),
        converged=run.converged,
        predicted_decrease=run.predicted,
        start=best.name,
        starts=tuple((c.name, c.value) for c in candidates),
        trace=run.trace,
    )


def _last_stage(
    problem: MatchingProblem, best: _Candidate, method: str, max_iterations, bound: float
) -> NonsmoothRun:
    bound = max(bound, 1e-9 * max(hinf_norm(t).value for t in problem.targets))  # below that it is rounding
    met = best.value <= 1.001 * bound
    if met or method == "lm":
        return NonsmoothRun(best.theta, best.value, 0.0 if met else np.nan, met, np.array([best.value]))
    if method == "prox-linear":
        return prox_linear(problem, best.theta, target=bound, max_iterations=max_iterations or 80)
    theta = lbfgs(problem, best.theta)
    if method == "lbfgs":
        value = problem.value(theta)
        met = value <= 1.001 * bound
        return NonsmoothRun(theta, value, 0.0 if met else np.nan, met, np.array([best.value, value]))
    return proximity_bundle(problem, theta, target=bound, max_iterations=max_iterations or 300)
