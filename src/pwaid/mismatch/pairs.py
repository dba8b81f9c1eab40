"""Pairs of laws: those that two signatures together suggest, on top of the best single ones, with laws exchanged, and
with the laws that their laws contain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pwaid.mismatch.fit import Fit, fit_model
from pwaid.mismatch.hypotheses import (
    Hypothesis,
    fit_screened,
    fit_shortlist,
    hypothesis_of,
    inner_laws,
    on_whole,
    without,
)
from pwaid.mismatch.model import Located, Model
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.pairscreen import screen_pairs
from pwaid.mismatch.screen import Screened, run_jobs, screen

__all__ = ["fit_inner", "fit_joint", "fit_members", "fit_pairs", "fit_reversed", "fit_swaps"]

TIED = 1.1  # times the best training error: a single effect that may as well be the first of a pair
STRANDED = 3.0  # times the training error of the best pair


def fit_joint(problem: Problem, located: Sequence[Located], jobs: int = 1, count: int = 4) -> list[Hypothesis]:
    """The pairs whose signatures together explain most of what the null leaves, each fitted from both."""
    null, found = problem.null_coarse, []

    def allowed(a, b):
        return not _same_knob(a, b)

    for pair in screen_pairs(problem, null, located, count, jobs, allowed):
        (first, second), (z, start) = pair.located, pair.starts
        model = Model(problem.settings, (*null.model.located, first))
        theta = np.concatenate([null.theta, z])
        base = Fit(model, theta, null.X0, np.inf, *model.simulate(theta, null.X0, problem.coarse), 0)
        found += fit_shortlist(problem, [Screened(second, pair.score, (start,), 1.0)], jobs, base=base)
    return found


def fit_pairs(problem: Problem, singles: Sequence[Hypothesis], sound: Sequence[Hypothesis],
              located: Sequence[Located], jobs: int = 1, beam: int = 2, width: int = 2) -> list[Hypothesis]:
    """On top of the best singles, and of the best of those that physics does not forbid (`sound`), screen again and
    fit the best seconds; then the best pair with other laws of the same ids and with the laws its laws contain."""
    pairs: list[Hypothesis] = []
    seen: set[frozenset] = set()
    for h in _distinct([*_leading(singles, beam), *_leading(sound, beam)], 2 * beam):
        others = [c for c in located if not _same_knob(c, h.located[0])]
        again = screen(problem, h.coarse, others, jobs)
        chosen = []
        for s in again:
            key = frozenset(((h.ids[0], h.located[0].place.signal),
                             (s.located.effect.id, s.located.place.signal)))
            if s.score > 0 and key not in seen and len(chosen) < width:
                seen.add(key)
                chosen.append(s)
        pairs += fit_shortlist(problem, chosen, jobs, base=h.coarse)
    pairs.sort(key=lambda h: h.train_error)
    for best in _distinct(pairs, 1):
        pairs += _variants(problem, best, singles, located, jobs)
    return sorted(pairs, key=lambda h: h.train_error)


def fit_swaps(problem: Problem, pairs: Sequence[Hypothesis], located: Sequence[Located], jobs: int = 1,
              width: int = 3, rounds: int = 2) -> list[Hypothesis]:
    """The best pair with each of its laws in turn replaced, and again while that helps: what its other law and its
    parameters leave is screened again. A wrong partner bends a right law less than the null bends either. Pairs that
    leave far more than the best one may have been stranded, so they are tried again from there."""
    best, found = pairs[0], []
    seen = _settled(pairs)
    for _ in range(rounds):
        new = [h for e in best.located for h in _partners(problem, best, e, located, seen, jobs, width)]
        found += new
        better = min(new, key=lambda h: h.train_error, default=best)
        if better.train_error > 0.8 * best.train_error:
            break
        best = better
    return found


def _settled(pairs: Sequence[Hypothesis]) -> set[frozenset]:
    """Keys of the pairs, best first, whose fits were not stranded far above the best one's."""
    return {frozenset(e.key for e in h.located) for h in pairs if h.train_error < STRANDED * pairs[0].train_error}


def _partners(problem, pair, kept, located, seen, jobs, width):
    """Fits of `kept`, a law of the pair, with the best other partners that were not `seen`."""
    base = _alone(problem, pair, kept)
    others = [c for c in located if not _same_knob(c, kept) and frozenset((c.key, kept.key)) not in seen]
    alive = _untied([s for s in screen(problem, base, others, jobs) if s.score > 0])
    inner = [c.key for s in alive[:width] for c in inner_laws(s.located, others)]
    chosen = alive[:width] + [s for s in alive[width:] if s.located.key in inner]
    seen |= {frozenset((s.located.key, kept.key)) for s in chosen}
    return fit_shortlist(problem, chosen, jobs, base=base) if chosen else []


def _untied(screened: Sequence[Screened], apart: float = 1e-3) -> list[Screened]:
    """One of those that the screen cannot tell apart, best first."""
    return [s for k, s in enumerate(screened) if k == 0 or screened[k - 1].score - s.score > apart * s.score]


def _alone(problem: Problem, pair: Hypothesis, kept: Located) -> Fit:
    """One law of a fitted pair without the other, everything else as the pair left it."""
    return without(pair.coarse, next(e for e in pair.located if e.key != kept.key), problem.coarse)


def fit_members(problem: Problem, pairs: Sequence[Hypothesis], singles: Sequence[Hypothesis], jobs: int = 1,
                count: int = 3) -> list[Hypothesis]:
    """The singles, each replaced by a fit that starts from its part of a good pair where that ends lower.

    A second effect of no size can lead the first out of a local minimum; what it led to must stand alone.
    """
    known = {h.located[0].key: h for h in singles}
    starts = {}
    for pair in pairs[:count]:
        parts = _parts(pair)
        for e, z in zip(pair.located, parts[1:], strict=True):
            rival = known.get(e.key)
            if rival is None or pair.train_error < 0.8 * rival.train_error:
                starts.setdefault(e.key, (
                    e, np.concatenate([parts[0], z]), pair.coarse.X0, pair.coarse.model.substeps))

    def refit(item):
        e, theta, X0, substeps = item
        score = known[e.key].score if e.key in known else 0.0
        return _refitted(problem, Model(problem.settings, (e,), substeps), theta, X0, score)

    for h in run_jobs(refit, starts.values(), jobs):
        rival = known.get(h.located[0].key)
        if rival is None or h.train_error < rival.train_error:
            known[h.located[0].key] = h
    return sorted(known.values(), key=lambda h: h.train_error)


def fit_inner(problem: Problem, pairs: Sequence[Hypothesis], located: Sequence[Located], jobs: int = 1,
              count: int = 3) -> list[Hypothesis]:
    """The best pairs with either law replaced by those it contains, on top of the other law as the pair left it."""
    seen, found = _settled(pairs), []
    for pair in _distinct(pairs, count):
        parts = pair.coarse.model.parts(pair.coarse.theta)
        for outer, kept, values in zip(pair.located, pair.located[::-1], parts, strict=True):
            inner = [c for c in inner_laws(outer, located)
                     if not _same_knob(c, kept) and frozenset((c.key, kept.key)) not in seen]
            seen |= {frozenset((c.key, kept.key)) for c in inner}
            if inner:
                found += fit_screened(problem, _alone(problem, pair, kept), inner, jobs, outer, values)
    return found


def fit_reversed(problem: Problem, pairs: Sequence[Hypothesis], jobs: int = 1, count: int = 3) -> list[Hypothesis]:
    """The best pairs whose laws act on one signal, one after the other, in the other order: a reading that is clipped
    and then drifts is another than one that drifts and is then clipped."""
    fitted = {tuple(e.key for e in h.located) for h in pairs}
    turned = [h for h in _distinct(pairs, count) if _in_series(*h.located)
              and tuple(e.key for e in h.located[::-1]) not in fitted]

    def refit(pair):
        nominal, first, second = _parts(pair)
        other = Model(problem.settings, pair.located[::-1], pair.coarse.model.substeps)
        return _refitted(problem, other, np.concatenate([nominal, second, first]), pair.coarse.X0, pair.score)

    return run_jobs(refit, turned, jobs)


def _parts(pair: Hypothesis) -> list[np.ndarray]:
    """Nominal parameters, those of the first law, and those of the second, as the pair's fit to segments left them."""
    n = pair.coarse.model.np
    return np.split(pair.coarse.theta, [n, n + pair.located[0].size])


def _refitted(problem: Problem, model: Model, theta, X0, score: float) -> Hypothesis:
    """The hypothesis that a fit from these parameters and start states ends at."""
    coarse = fit_model(model, problem.coarse, problem.sigma, theta, X0, problem.ranges, 20, 3e-4)
    return hypothesis_of(problem, on_whole(problem, coarse), score, coarse)


def _in_series(a: Located, b: Located) -> bool:
    """Whether both laws act on the same input or the same output."""
    return a.place.channel == b.place.channel and a.place.kind != "state"


def _variants(problem, pair, singles, located, jobs):
    """The same two ids under their other laws and places next to these."""
    first, second = pair.located
    base = next((h for h in singles if h.located[0].key == first.key), None)
    if base is None:
        return []
    others = [c for c in located if c.effect.id == second.effect.id and c.key != second.key
              and c.place.kind == second.place.kind][:3]
    others = [c for c in others + inner_laws(second, located) if not _same_knob(c, first)]
    return fit_screened(problem, base.coarse, others, jobs)


def _same_knob(a: Located, b: Located) -> bool:
    """Two laws of one id, or one containing the other, at the same place: not a pair."""
    elsewhere = a.place.ii[:6] != b.place.ii[:6] and a.effect.id != b.effect.id
    if elsewhere or a.place.channel != b.place.channel:
        return False
    return (a.effect.id == b.effect.id or b.effect.id in a.effect.contains
            or a.effect.id in b.effect.contains)


def _leading(hypotheses: Sequence[Hypothesis], count: int) -> list[Hypothesis]:
    """The best `count` of each id and place, and as many more that remove most of the error and are as good but for
    TIED."""
    ranked = _distinct(hypotheses, 2 * count)
    return [h for k, h in enumerate(ranked) if k < count or (
        h.share > 0.5 and h.train_error < TIED * ranked[0].train_error)]


def _distinct(hypotheses: Sequence[Hypothesis], count: int) -> list[Hypothesis]:
    """The best hypothesis of each id and place, in order."""
    seen, chosen = set(), []
    for h in hypotheses:
        key = (h.ids, tuple(e.place.signal for e in h.located))
        if key not in seen:
            seen.add(key)
            chosen.append(h)
    return chosen[:count]
