"""Fit single effects by simulation error, and measure each on held-out recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit, fit_model, fit_starts
from pwaid.mismatch.model import Located, Model
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.scout import part_of
from pwaid.mismatch.screen import Screened, other_laws, run_jobs, screen
from pwaid.mismatch.startscan import best_starts

__all__ = ["Hypothesis", "fit_screened", "fit_shortlist", "floor_square", "hypothesis_of", "inner_laws", "joined",
           "kept_on_whole", "mean_square", "null_hypothesis", "on_whole", "share", "without"]

TORN = 0.3  # times the error on whole recordings: below it, segments fit far better than what they are joined to
IDLE = 0.1  # share of the error that a second law must remove in a few steps to be fitted at all
BENT = 2.0  # tolerances by which a parameter of the null moved far
AT_FLOOR = 1.1  # times the floor's mean square: a fit below it has lost no start state


@dataclass(frozen=True)
class Hypothesis:
    """A fitted set of effects with its errors on training and held-out recordings (weighted mean squares).

    `coarse` is its fit on the segments of `Problem.coarse`, on which further effects are screened.
    """

    located: tuple[Located, ...]
    fit: Fit
    test: Fit
    train_error: float
    test_error: float
    share: float
    score: float = 0.0
    coarse: Fit | None = None

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(e.effect.id for e in self.located)

    @property
    def families(self) -> tuple[str, ...]:
        return tuple(e.effect.family for e in self.located)

    @property
    def label(self) -> str:
        return " + ".join(e.label for e in self.located) if self.located else "parameters only"

    def values(self) -> list[np.ndarray]:
        """Parameters of each effect in their units."""
        return self.fit.model.parts(self.fit.theta)


def mean_square(problem: Problem, fit: Fit, data) -> float:
    """Weighted mean square of the simulation error."""
    return float(np.mean(np.clip((data.Y - fit.Y) / problem.sigma, -1e3, 1e3) ** 2))


def floor_square(problem: Problem) -> float:
    """The floor in the same measure."""
    return float(np.mean((problem.floor.level / problem.sigma) ** 2))


def share(problem: Problem, error: float, before: float | None = None) -> float:
    """Share of the explainable held-out error that is removed, from `before` (the refitted null by default)."""
    start = mean_square(problem, problem.null_test, problem.test) if before is None else before
    explainable = start - floor_square(problem)
    return float((start - error) / explainable) if explainable > 1e-12 else 0.0


def hypothesis_of(problem: Problem, fit: Fit, score: float, coarse: Fit | None = None) -> Hypothesis:
    """The fit with its errors on training and held-out recordings."""
    test = problem.heldout(fit)
    train_error = mean_square(problem, fit, problem.train)
    test_error = mean_square(problem, test, problem.test)
    return Hypothesis(fit.model.located, fit, test, train_error, test_error, share(problem, test_error),
                      score, coarse or fit)


def null_hypothesis(problem: Problem) -> Hypothesis:
    """The refitted simulator without any effect."""
    return hypothesis_of(problem, problem.null, 0.0, problem.null_coarse)


def _window(problem: Problem, base: Fit, samples: int = 600) -> tuple[Dataset, np.ndarray]:
    """The quarter of each recording where the residual is largest, with the start states simulated there."""
    data, spans = problem.coarse, []
    energy = np.sum(((data.Y - base.Y) / problem.sigma) ** 2, axis=1)
    for a, b in data.recordings:
        n = int(min(b - a, max(samples, (b - a) // 4)))
        running = np.cumsum(np.concatenate([[0.0], energy[a:b]]))
        first = a + int(np.argmax(running[n:] - running[:-n]))
        spans.append((first, first + n))
    part, index = data.windows(spans)
    return part, part_of(base, part, index).X0


def _trials(problem: Problem, base: Fit, candidate: Screened) -> list[Fit]:
    """A few steps from each of the screen's best starts on the richest quarter of the data, best first.

    Some return to the nominal parameters: the null may have bent them to absorb the effect.
    """
    model = Model(problem.settings, (*base.model.located, candidate.located))
    starts = candidate.starts or (np.zeros(candidate.located.size),)
    data, X0 = _window(problem, base) if _seen_in_part(problem, model) else (problem.coarse, base.X0)
    before, n = base.theta, base.model.np
    options = [np.concatenate([before, z]) for z in starts[:2 if candidate.located.size < 2 else 3]]
    far = starts[0], max(starts, key=lambda z: np.linalg.norm(z - starts[0]))
    options += [np.concatenate([np.zeros(n), before[n:], z]) for z in far[:1 if len(starts) < 2 else 2]]
    trials = [fit_model(model, data, problem.sigma, theta, _begun(problem, model, theta, data, X0), problem.ranges, 5,
                        1e-3) for theta in options]
    return sorted(trials, key=lambda f: f.cost)


def _begun(problem: Problem, model: Model, theta, data: Dataset, X0) -> np.ndarray:
    """Start states of a trial: those given, or where the null bent a parameter far, and on stretches from the middle of
    recordings, in every segment the better of them and of what its first samples show: a null that is bent so has put
    what nothing measures anywhere, and one that errs has led the rest astray before a stretch begins."""
    null = problem.null_coarse
    bent = np.abs(null.theta[:null.model.np]) > BENT * np.log1p(null.model.settings.tolerance)
    if problem.plant.rhs is None or not (problem.stretches or np.any(bent)):
        return X0
    given = fit_starts(model, data, problem.sigma, theta, X0, problem.ranges)
    other = problem.opening_starts(given, data) if problem.stretches else problem.measured(data)
    return best_starts(problem, given, given, [other], data).X0


def _seen_in_part(problem: Problem, model: Model) -> bool:
    """Whether a part of the recordings is enough to try a model on: not for what grows with time."""
    return problem.plant.black_box is None and not any(e.effect.family == "time" for e in model.located)


def _worthwhile(problem: Problem, base: Fit, tried: Sequence[tuple]) -> list[tuple]:
    """The tried partners of the laws in `base`, those left out that remove less than IDLE of the error on the richest
    quarter, where the laws without a partner were fitted as long; the best one always."""
    if not base.model.located or not _seen_in_part(problem, base.model):
        return list(tried)
    data, X0 = _window(problem, base)
    alone = fit_model(base.model, data, problem.sigma, base.theta, X0, problem.ranges, 5, 1e-3)
    return [t for k, t in enumerate(tried) if k == 0 or t[0][0].cost < (1.0 - IDLE) * alone.cost
            or not _seen_in_part(problem, t[0][0].model)]


def _finish(problem: Problem, base: Fit, trials: Sequence[Fit], iterations: int = 20) -> tuple[Fit, Fit]:
    """All data from the best trial, and from the second where it is about as good: on segments, then as a whole."""
    ends = []
    for trial in trials[:2]:
        distinct = not ends or np.max(np.abs(trial.theta - trials[0].theta), initial=0.0) > 0.05
        if ends and (trial.cost > 3 * trials[0].cost or not distinct):
            break
        X0 = _begun(problem, trial.model, trial.theta, problem.coarse, base.X0)
        ends.append(fit_model(trial.model, problem.coarse, problem.sigma, trial.theta, X0, problem.ranges, 5, 1e-3))
    best = problem.rescanned(min(ends, key=lambda f: f.cost))
    model = _resolved(problem, best)
    coarse = fit_model(model, problem.coarse, problem.sigma, best.theta, best.X0, problem.ranges, iterations, 3e-4)
    fit = on_whole(problem, coarse, iterations)
    return fit, fit if _is_whole(problem) else coarse


def on_whole(problem: Problem, coarse: Fit, iterations: int = 20) -> Fit:
    """The fit on the training recordings as they are judged, from the one on segments.

    Where it is not at the floor, a start state may have been lost on the way: other starts are tried, and segments that
    grow longer step by step where they fit far better than the whole.
    """
    whole = _is_whole(problem)
    if whole and not problem.stretches:
        return coarse
    fit = coarse if whole else fit_model(coarse.model, problem.train, problem.sigma, coarse.theta,
                                         _begun_whole(problem, coarse), problem.ranges, iterations, 3e-4)
    if mean_square(problem, fit, problem.train) < AT_FLOOR * floor_square(problem):
        return fit
    again = problem.restarted(fit)
    if again is not fit:
        fit = fit_model(again.model, problem.train, problem.sigma, again.theta, again.X0, problem.ranges, iterations,
                        3e-4)
    if whole or mean_square(problem, coarse, problem.coarse) > TORN * mean_square(problem, fit, problem.train):
        return fit
    return min(fit, joined(problem, coarse, problem.coarse, problem.train, iterations), key=lambda f: f.cost)


def _is_whole(problem: Problem) -> bool:
    """Whether the segments on which laws are first fitted are those on which they are judged."""
    return problem.coarse.segments.shape == problem.train.segments.shape


def _begun_whole(problem: Problem, coarse: Fit) -> np.ndarray:
    """Start states on the training recordings: those of the segments with which they begin."""
    return coarse.X0[problem.coarse.heads(problem.train)]


def kept_on_whole(problem: Problem, coarse: Fit) -> Fit:
    """The fit on the training recordings as they are judged with the parameters of the one on segments."""
    if _is_whole(problem):
        return coarse
    return fit_starts(coarse.model, problem.train, problem.sigma, coarse.theta, _begun_whole(problem, coarse),
                      problem.ranges)


def joined(problem: Problem, fit: Fit, data: Dataset, target: Dataset, iterations: int) -> Fit:
    """The fit on `target` from one on its segments, by way of segments that grow threefold, each started where the last
    one is."""
    length = int(np.max(np.diff(data.segments[:, :2])))
    while True:
        length *= 3
        longer = target.cut(length)
        whole = len(longer.segments) <= len(target.segments)
        data = target if whole else longer
        X0 = fit.X[data.segments[:, 0], :fit.model.nx]
        fit = fit_model(fit.model, data, problem.sigma, fit.theta, X0, problem.ranges, iterations if whole else 8, 3e-4)
        if whole:
            return fit


def _resolved(problem: Problem, fit: Fit, most: int = 8) -> Model:
    """The model with as many substeps as make halving them invisible beside what is left to explain."""
    model, Y = fit.model, fit.Y
    if problem.plant.dt:
        return model
    left = np.sqrt(np.mean((problem.coarse.Y - Y) ** 2, axis=0))
    allowed = np.maximum(0.15 * left, 0.3 * problem.floor.level)
    while model.substeps < most:
        finer = Model(problem.settings, model.located, 2 * model.substeps)
        Yf, _ = finer.simulate(fit.theta, fit.X0, problem.coarse)
        if np.all(np.sqrt(np.mean((Yf - Y) ** 2, axis=0)) < allowed):
            break
        model, Y = finer, Yf
    return model


def fit_shortlist(problem: Problem, candidates: Sequence[Screened], jobs: int = 1, base: Fit | None = None,
                  keep: int = 5) -> list[Hypothesis]:
    """Try every candidate on top of `base`, a fit on segments (the null by default); fit the `keep` best, best first.

    A partner of laws in `base` that does next to nothing is not fitted.
    Laws contained in one that is kept, ties within a factor of two, and the best of another law of an effect that is
    kept, are kept too.
    """
    base = problem.null_coarse if base is None else base

    tried = sorted(_in_time(problem, lambda c: (_trials(problem, base, c), c), candidates, jobs),
                   key=lambda t: t[0][0].cost)
    tried = _worthwhile(problem, base, tried)
    ids = {e for _, c in tried[:keep] for e in c.located.effect.contains}
    limit = 2 * tried[0][0][0].cost if tried else 0.0
    kept = [t for k, t in enumerate(tried) if (k < keep and t[0][0].cost < 50 * tried[0][0][0].cost)
            or t[1].located.effect.id in ids or (t[0][0].cost < limit and k < 2 * keep)]
    kept += other_laws(kept, tried, lambda t: t[1].located)

    def finish(item):
        trials, candidate = item
        fit, coarse = _finish(problem, base, trials)
        return hypothesis_of(problem, fit, candidate.score, coarse)

    return sorted(_in_time(problem, finish, kept, jobs), key=lambda h: h.train_error)


def _in_time(problem: Problem, function, items: Sequence, jobs: int) -> list:
    """The function of the first item, and of those whose turn comes before the problem's deadline."""
    return [found for found in run_jobs(lambda item: function(item) if item is items[0] or not problem.late else None,
                                        items, jobs) if found is not None]


def fit_screened(problem: Problem, base: Fit, located: Sequence[Located], jobs: int = 1,
                 outer: Located | None = None, values=()) -> list[Hypothesis]:
    """Those of these laws that the screen sees on top of `base`, a fit on segments, tried and fitted on it.

    With the law that contains them, `outer`, and its fitted values, each is first tried at its part of them.
    """
    seen = [s for s in screen(problem, base, located, jobs) if s.score > 0]
    if outer is not None:
        seen = [replace(s, starts=(*_inherited(outer, values, s.located), *s.starts)) for s in seen]
    return fit_shortlist(problem, seen, jobs, base=base)


def _inherited(outer: Located, values, inner: Located) -> list[np.ndarray]:
    """A start for a contained law: what `outer` says of it, or each parameter the mean of those of `outer` that its
    name begins; none where one has no such."""
    if inner.effect.id in outer.effect.inherit:
        return [inner.from_physical(outer.effect.inherit[inner.effect.id](*values))]
    found = [[v for o, v in zip(outer.effect.quantities, values, strict=True) if o.name.startswith(q.name)]
             for q in inner.effect.quantities]
    return [inner.from_physical([float(np.mean(v)) for v in found])] if all(found) else []


def without(fit: Fit, dropped: Located, data: Dataset) -> Fit:
    """A fit with one of its laws taken out and everything else as it was, simulated on its data."""
    model = fit.model
    ends = np.cumsum([model.np, *(e.size for e in model.located)])
    k = model.located.index(dropped)
    theta = np.delete(fit.theta, np.s_[ends[k]:ends[k + 1]])
    rest = Model(model.settings, model.located[:k] + model.located[k + 1:], model.substeps)
    return Fit(rest, theta, fit.X0, np.inf, *rest.simulate(theta, fit.X0, data), 0)


def inner_laws(outer: Located, located: Sequence[Located]) -> list[Located]:
    """The laws that a law contains, or becomes at the ends of its parameters, at the same place."""
    ids = outer.effect.contains + outer.effect.becomes
    return [c for c in located if c.effect.id in ids and c.place.signal == outer.place.signal]
