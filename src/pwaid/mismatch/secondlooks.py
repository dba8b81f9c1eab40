"""Second looks: laws that a first pass misses or strands, fitted again from another fit or from short segments."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit, fit_model, fit_starts
from pwaid.mismatch.hypotheses import (
    Hypothesis,
    fit_screened,
    fit_shortlist,
    floor_square,
    hypothesis_of,
    inner_laws,
    joined,
    on_whole,
)
from pwaid.mismatch.model import Located, Model
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.pieces import PARTING, brief_samples
from pwaid.mismatch.screen import Screened, overlooked, run_jobs, screen

__all__ = ["fit_by_segments", "fit_contained", "fit_lookalikes", "fit_partners_by_segments", "fit_rates"]

# Samples on which starts are tried; share of the error above the noise there that is worth going on from.
FIRST, PROMISING = 1200, 0.5
# A limited rate turns where it meets the command, which inputs hold from sample to sample: its error has a hollow every
# few per cent of the rate. How far it is moved from one, on the axis it is fitted on; cost that is lower.
RUGGED = "actuator_rate_limit"
STEPS, LOWER = (-0.6, *np.linspace(-0.24, 0.24, 17), 0.6), 0.97


def fit_contained(problem: Problem, singles: Sequence[Hypothesis], located: Sequence[Located], jobs: int = 1,
                  count: int = 2) -> list[Hypothesis]:
    """The singles, with the laws that the best ones contain fitted again from the nominal parameters found there.

    A simpler law can stall where the null bent those parameters; the larger law has straightened them.
    """
    found = list(singles)
    for outer in singles[:count]:
        inner = inner_laws(outer.located[0], located)
        if inner:
            values = outer.coarse.model.parts(outer.coarse.theta)[0]
            found += fit_screened(problem, _nominal_of(problem, outer), inner, jobs, outer.located[0], values)
    return _best_of_each(found)


def fit_lookalikes(problem: Problem, singles: Sequence[Hypothesis], located: Sequence[Located],
                   jobs: int = 1) -> list[Hypothesis]:
    """The singles, with the effects that the best one is mistaken for, each at its best place, where they are missing.

    Nothing is named before what resembles it has been fitted.
    """
    best, fitted = singles[0], {i for h in singles for i in h.ids}
    alike = [c for c in located if c.effect.id in best.located[0].effect.confused_with and c.effect.id not in fitted]
    if not alike:
        return list(singles)
    base = _nominal_of(problem, best)
    places = overlooked(screen(problem, base, alike, jobs), ())
    return _best_of_each([*singles, *fit_shortlist(problem, places, jobs, base=base)])


def fit_by_segments(problem: Problem, singles: Sequence[Hypothesis], located: Sequence[Located], jobs: int = 1,
                    count: int = 3) -> list[Hypothesis]:
    """The singles, with stops, gaps and ripples fitted again from short segments that grow: those that were
    fitted, and those among the best that short segments show.

    They part motions that start side by side, so over a whole recording the error is rugged and signatures are those
    of another motion; over a few samples they are not.
    """
    fitted = [h.located[0].key for h in singles if h.ids[0] in PARTING]
    return _best_of_each([*singles, *_from_pieces(problem, problem.null_coarse, located, fitted, jobs, count)])


def fit_partners_by_segments(problem: Problem, single: Hypothesis, located: Sequence[Located], jobs: int = 1,
                             count: int = 2) -> list[Hypothesis]:
    """Pairs of a single effect with the stops, gaps and ripples that short segments show on top of it."""
    if single.ids[0] in PARTING:
        return []
    return _from_pieces(problem, single.coarse, located, (), jobs, count)


def fit_rates(problem: Problem, fitted: Sequence[Hypothesis], count: int = 3) -> list[Hypothesis]:
    """The hypotheses, the best that limits a rate among the first `count` of them fitted again from where the limit is
    moved, if that leads to a lower hollow of the error; best first."""
    limit = next((h for h in fitted[:count] if RUGGED in h.ids), None)
    found = [_moved(problem, h) if h is limit else h for h in fitted]
    return sorted(found, key=lambda h: h.train_error)


def _moved(problem: Problem, h: Hypothesis, rounds: int = 4) -> Hypothesis:
    """The hypothesis, or the lower one found from where its limit is moved."""
    best, model = h.coarse, h.coarse.model
    before = next(k for k, e in enumerate(model.located) if e.effect.id == RUGGED)
    place = model.np + sum(e.size for e in model.located[:before])
    for _ in range(rounds):
        trials = []
        for step in STEPS:
            theta = best.theta.copy()
            theta[place] += step
            near = fit_starts(model, problem.coarse, problem.sigma, theta, best.X0, problem.ranges, 4)
            trials.append(fit_model(model, problem.coarse, problem.sigma, theta, near.X0, problem.ranges, 6, 1e-3))
        lowest = min(trials, key=lambda f: f.cost)
        if lowest.cost > LOWER * best.cost:
            break
        best = fit_model(model, problem.coarse, problem.sigma, lowest.theta, lowest.X0, problem.ranges, 20, 3e-4)
    if best is h.coarse:
        return h
    found = hypothesis_of(problem, on_whole(problem, best), h.score, best)
    return found if found.train_error < h.train_error else h


def _from_pieces(problem: Problem, base: Fit, located: Sequence[Located], fitted: Sequence[tuple], jobs: int,
                 count: int) -> list[Hypothesis]:
    """Laws with impacts on top of `base`, grown from short segments: at most `count` of those that were `fitted` and
    those among the best there."""
    if not any(c.effect.id in PARTING for c in located):
        return []
    data = problem.coarse.cut(brief_samples(problem))
    near = fit_starts(base.model, data, problem.sigma, base.theta, problem.measured(data), problem.ranges)
    near = fit_model(base.model, data, problem.sigma, base.theta, near.X0, problem.ranges, 10)
    brief = replace(problem, coarse=data, null_coarse=near, brief=True)
    ranked = screen(brief, near, located, jobs)
    shown = overlooked(ranked, ())[:count]
    asked = [s for s in ranked if s.starts and s.located.effect.id in PARTING
             and (s in shown or s.located.key in fitted)][:count]
    energy = np.sum(((data.Y - near.Y) / problem.sigma) ** 2, axis=1)
    part, index = data.windows(_telling(data, energy))
    noise = floor_square(problem) * part.Y.size
    worth = noise + PROMISING * (float(np.sum(energy[index])) - noise)
    grown = run_jobs(lambda s: _grown(problem, base, data, part, worth, s), asked, jobs)
    return [h for h in grown if h is not None]


def _grown(problem: Problem, base: Fit, data: Dataset, part: Dataset, worth: float,
           candidate: Screened) -> Hypothesis | None:
    """The hypothesis that a fit on short segments, from the best of the screen's starts, grows into; None where it
    costs more than `worth` on `part`, the segments that tell most."""
    model = Model(problem.settings, (*base.model.located, candidate.located))
    X0, trials = problem.measured(part), []
    before = base.theta, np.concatenate([0 * base.theta[:model.np], base.theta[model.np:]])  # nominal ones unbent
    for z, known in itertools.product(candidate.starts, before):
        theta = np.concatenate([known, z])
        near = fit_starts(model, part, problem.sigma, theta, X0, problem.ranges)
        trials.append(fit_model(model, part, problem.sigma, theta, near.X0, problem.ranges, 8, 1e-3))
    best = min(trials, key=lambda f: f.cost)
    if best.cost > worth:
        return None
    near = fit_starts(model, data, problem.sigma, best.theta, problem.measured(data), problem.ranges)
    best = fit_model(model, data, problem.sigma, best.theta, near.X0, problem.ranges)
    coarse = joined(problem, best, data, problem.coarse, 20)
    return hypothesis_of(problem, on_whole(problem, coarse), candidate.score, coarse)


def _telling(data: Dataset, energy) -> list[tuple[int, int]]:
    """The segments with the largest errors, `FIRST` samples in all, in order of time."""
    spans = [(int(a), int(b)) for a, b in data.segments[:, :2]]
    ranked = sorted(spans, key=lambda s: -float(np.sum(energy[s[0]:s[1]])))
    count = int(np.searchsorted(np.cumsum([b - a for a, b in ranked]), FIRST)) + 1
    return sorted(ranked[:count])


def _nominal_of(problem: Problem, h: Hypothesis) -> Fit:
    """The simulator without any law, at the nominal parameters and start states of a fitted hypothesis."""
    model, theta = problem.null_coarse.model, h.coarse.theta[:h.coarse.model.np]
    return Fit(model, theta, h.coarse.X0, np.inf, *model.simulate(theta, h.coarse.X0, problem.coarse), 0)


def _best_of_each(fitted: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The fit of every law at every place that leaves least in training, best first."""
    known: dict = {}
    for h in fitted:
        rival = known.get(h.located[0].key)
        if rival is None or h.train_error < rival.train_error:
            known[h.located[0].key] = h
    return sorted(known.values(), key=lambda h: h.train_error)
