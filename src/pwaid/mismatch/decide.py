"""From fitted hypotheses to one of five verdicts.

The verdict rests on held-out recordings: what share of the explainable error an effect removes,
whether every recording improves, how far the runner-up is, how often the winner wins under a block
bootstrap. An information criterion alone always names something, so it only breaks ties between
nested laws.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pwaid.mismatch.adequacy import (
    floor_or_trifle,
    inadequate,
    likelihood_gain,
    nothing_found,
    over_floor,
    predicted_rest,
    still_explained,
)
from pwaid.mismatch.hypotheses import Hypothesis, floor_square, mean_square
from pwaid.mismatch.leftover import leftover
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.predictability import predictability
from pwaid.mismatch.thresholds import Thresholds
from pwaid.mismatch.vetoes import YIELDS, outside, veto

__all__ = ["TOGETHER", "Decision", "at_floor", "decide", "errors_by_recording", "white_bic"]

TOGETHER = "refitted to all recordings at once"


@dataclass(frozen=True)
class Decision:
    """The verdict, the hypothesis behind it, the set that could not be separated, and reasons in words."""

    verdict: str
    chosen: Hypothesis | None
    members: tuple[Hypothesis, ...]
    passed: tuple[Hypothesis, ...]
    reasons: tuple[str, ...]


def errors_by_recording(problem: Problem, Y, data) -> np.ndarray:
    """Weighted mean-square error of each recording."""
    r = np.clip((data.Y - Y) / problem.sigma, -1e3, 1e3) ** 2
    return np.array([r[a:b].mean() for a, b in data.recordings])


def _blocks(problem: Problem, Y, data, count: int = 24):
    r = np.sum(np.clip((data.Y - Y) / problem.sigma, -1e3, 1e3) ** 2, axis=1)
    parts = []
    for a, b in data.recordings:
        edges = np.linspace(a, b, max(4, count // len(data.recordings)) + 1).astype(int)
        parts += [r[i:j].sum() for i, j in itertools.pairwise(edges)]
    return np.array(parts)


def wins(problem: Problem, winner: Hypothesis, rival: Hypothesis, rng, draws: int = 400) -> float:
    """Share of block bootstraps, training and held-out blocks together, in which `winner` errs less."""
    d = np.concatenate([
        _blocks(problem, rival.fit.Y, problem.train) - _blocks(problem, winner.fit.Y, problem.train),
        _blocks(problem, rival.test.Y, problem.test) - _blocks(problem, winner.test.Y, problem.test)])
    picks = rng.integers(0, len(d), (draws, len(d)))
    return float(np.mean(d[picks].sum(axis=1) > 0))


def effective_samples(residual) -> float:
    """N(1 - rho)/(1 + rho) from the lag-one correlation of a residual (N, ny), summed over outputs."""
    total = 0.0
    for k in range(residual.shape[1]):
        r = residual[:, k] - residual[:, k].mean()
        power = r @ r
        rho = float(r[1:] @ r[:-1] / power) if power > 0 else 0.0
        rho = min(max(rho, 0.0), 0.999)
        total += len(r) * (1 - rho) / (1 + rho)
    return max(total, 4.0)


def criterion(problem: Problem, h: Hypothesis, rival: Hypothesis) -> float:
    """BIC of h less that of a rival on the training recordings, with the smaller of their effective sample sizes."""
    n = min(effective_samples((problem.train.Y - f.fit.Y) / problem.sigma) for f in (h, rival))
    ratio = max(h.train_error, 1e-300) / max(rival.train_error, 1e-300)
    return n * np.log(ratio) + (h.fit.model.size - rival.fit.model.size) * np.log(n)


def white_bic(problem: Problem, h: Hypothesis) -> float:
    """BIC on the training recordings as if residuals were white: the baseline of docs/proof.md, used nowhere here."""
    mean = np.mean((problem.train.Y - h.fit.Y) ** 2, axis=0)
    n = len(problem.train.Y)
    return float(n * np.sum(np.log(np.maximum(mean, 1e-300))) + h.fit.model.size * np.log(n * len(mean)))


def decide(problem: Problem, null: Hypothesis, singles: Sequence[Hypothesis], pairs: Sequence[Hypothesis],
           thresholds: Thresholds | None = None, seed: int = 0) -> Decision:
    """The verdict.

    Parameters
    ----------
    null : the refitted simulator. singles, pairs : fitted hypotheses.
    """
    t = thresholds or Thresholds()
    rng = np.random.default_rng(seed)
    floor = floor_square(problem)
    reasons: list[str] = []
    share = t.share if problem.floor.trusted else t.share_tentative
    if at_floor(problem, t):
        if _is_floor(problem, problem.test, problem.null_test.Y, t):
            reasons.append("what the refitted simulator misses on the held-out recordings is less than their noise")
            return Decision(_agreement_or_parameters(problem, t), null, (), (), tuple(reasons))
        reasons.append(f"{TOGETHER}, the simulator misses less than the noise on each: the training recordings alone "
                       "do not determine its parameters")
        return Decision("parameters_only", null, (), (), tuple(reasons))
    passed, refused = _judge(problem, _passing(problem, null, singles, share, t), t, reasons)
    passed_pairs, more = _judge(problem, _passing_pairs(problem, null, singles, pairs, share, t), t, reasons)
    passed = _not_outdone(problem, passed, [*refused, *more], t, reasons)
    passed_pairs = sorted(_not_outdone(problem, passed_pairs, [*refused, *more], t, reasons), key=_score)
    best = min(passed, key=_score, default=None)
    if best is not None:
        best = _prefer_smaller(problem, best, passed, (), t)
        pair = _better_pair(problem, best, passed_pairs, floor, t)
        if pair is not None:
            pair = _prefer_smaller(problem, pair, passed_pairs, singles, t)
            return _name(problem, pair, passed_pairs, t, rng, reasons)
        return _name(problem, best, passed, t, rng, reasons)
    if not passed_pairs:
        found, again = _judge(problem, _disturbed_pairs(problem, null, singles, pairs, share, t), t, reasons)
        passed_pairs = sorted(_not_outdone(problem, found, [*refused, *more, *again], t, reasons), key=_score)
    if passed_pairs:
        pair = _prefer_smaller(problem, passed_pairs[0], passed_pairs, singles, t)
        return _name(problem, pair, passed_pairs, t, rng, reasons)
    if _unrelated(problem, t) and not _unjudged(problem, t) and not outside(null, t.reach) and not still_explained(
            problem, null, t, leftover(problem, null.fit, null.test)):
        reasons.append("what is left is small and past inputs do not predict it: a disturbance, not physics left out")
        return Decision(_agreement_or_parameters(problem, t), null, (), (), tuple(reasons))
    reasons.append("no effect removed enough of the held-out error")
    return Decision("unexplained", null, (), (), tuple(reasons))


def _score(h: Hypothesis) -> float:
    return 0.5 * (h.train_error + h.test_error)


def _passing(problem, null, singles, share, t) -> list[Hypothesis]:
    """The single effects that remove enough; and those inside one of them that all but do, so that no hair's breadth
    of a threshold decides between a law and a wider one."""
    enough = [h for h in singles if _passes(problem, h, null, share)]
    return [h for h in singles if _passes(
        problem, h, null, t.inner * share if any(_inside(h, w) for w in enough) else share)]


def _passes(problem, h: Hypothesis, null: Hypothesis, share: float) -> bool:
    floor = floor_square(problem)
    if h.share < share or null.train_error - h.train_error < share * (null.train_error - floor):
        return False
    before = errors_by_recording(problem, null.test.Y, problem.test)
    after = errors_by_recording(problem, h.test.Y, problem.test)
    before_t = errors_by_recording(problem, null.fit.Y, problem.train)
    after_t = errors_by_recording(problem, h.fit.Y, problem.train)
    return bool(np.all(after < before) and np.all(after_t < before_t))


def _judge(problem, passed, t, reasons):
    """Those that physics and what they leave do not speak against, and those that what they leave speaks against."""
    kept, refused = [], []
    for h in passed:
        reason = veto(problem, h)
        if not reason or (reason == YIELDS and h.share >= t.pair_share and nothing_found(problem, h, t)):
            reason = inadequate(problem, h, t)
            (refused if reason else kept).append(h)
        if reason:
            reasons.append(f"{h.label}: {reason}")
    return kept, refused


def _not_outdone(problem, kept, refused, t, reasons):
    """Those of which no refused hypothesis explains most of the rest: that rest is physics, not a disturbance.

    Where noise is small beside the rest, one that adds a law to theirs says that more is missing, not that they are
    wrong.
    """
    left = []
    for h in kept:
        quiet = np.all(over_floor(problem, h.test.Y, t) >= t.quiet)
        better = [r for r in refused if r.train_error < t.outdone * h.train_error
                  and r.test_error < t.outdone * h.test_error and not (quiet and _adds(r, h))]
        if better:
            reasons.append(f"{h.label}: {better[0].label}, itself refused, leaves less than {100 * t.outdone:.0f} % of "
                           "what it leaves")
        else:
            left.append(h)
    return left


def _adds(large: Hypothesis, small: Hypothesis) -> bool:
    """Whether `large` has more laws, and every law of `small`, or one that contains it, at its place."""
    return len(large.located) > len(small.located) and all(
        any(e.place.signal == f.place.signal and (e.effect.id == f.effect.id or e.effect.id in f.effect.contains)
            for f in large.located) for e in small.located)


def at_floor(problem, t) -> bool:
    """Nothing material: every output's error is at the floor, or a trifle of the output itself, in training too.

    Where training is there and the held-out recordings are not, parameters that training hardly determines may be off:
    then it counts whether parameters fitted to all recordings at once leave no more than the floor in either part.
    """
    if not _is_floor(problem, problem.train, problem.null.Y, t):
        return False
    return _is_floor(problem, problem.test, problem.null_test.Y, t) or _together_at_floor(problem, t)


def _together_at_floor(problem, t) -> bool:
    both, n = problem.together.Y, len(problem.train.Y)
    return _is_floor(problem, problem.train, both[:n], t) and _is_floor(problem, problem.test, both[n:], t)


def _is_floor(problem, data, Y, t) -> bool:
    return bool(np.all(np.mean((data.Y - Y) ** 2, axis=0) < t.material * floor_or_trifle(problem, t) ** 2))


def _unrelated(problem, t) -> bool:
    """A small residual that the inputs do not predict: a disturbance, not physics left out."""
    r = problem.test.Y - problem.null_test.Y
    small = np.sqrt(np.mean(r**2, axis=0)) < t.small * np.std(problem.test.Y, axis=0)
    return bool(np.all(small) and np.all(null_predictability(problem) < t.predicted))


def _unjudged(problem, t) -> bool:
    """Whether a black box leaves far more than the noise: no maps of its states can say that nothing is behind it."""
    return problem.plant.black_box is not None and bool(
        np.any(over_floor(problem, problem.null_test.Y, t) >= t.left))


def null_predictability(problem) -> np.ndarray:
    """Share of the refitted null's held-out residual that follows from the inputs, per output."""
    return predictability(problem.train, problem.null, problem.test, problem.null_test, problem.structure.time_scale)


def _passing_pairs(problem, null, singles, pairs, share, t):
    by_key = {h.located[0].key: h for h in singles}
    found = []
    for h in pairs:
        if not _passes(problem, h, null, share):
            continue
        loud = np.all(over_floor(problem, h.test.Y, t) < t.quiet)
        if h.share < (t.pair_share if loud else t.pair_share_quiet):
            continue
        parts = [by_key.get(e.key) for e in h.located]
        better = [p for p in parts if p is not None]
        if any(_gain(problem, p, h) < t.second_share or not _material(problem, p, h, t) for p in better):
            continue
        found.append(h)
    return found


def _disturbed_pairs(problem, null, singles, pairs, share, t, most: int = 3):
    """Pairs that remove less, the best few, where maps find nothing in what they leave: a disturbance."""
    less = replace(t, pair_share=t.pair_share_quiet)
    found = sorted(_passing_pairs(problem, null, singles, pairs, share, less), key=_score)[:most]
    return [h for h in found if nothing_found(problem, h, t)]


def _gain(problem, single: Hypothesis, pair: Hypothesis) -> float:
    """Share of what the single effect left above the floor that the pair removes, held out."""
    floor = floor_square(problem)
    left = single.test_error - floor
    return (single.test_error - pair.test_error) / left if left > 0.05 * floor else 0.0


def _material(problem, single: Hypothesis, pair: Hypothesis, t) -> bool:
    """Whether the second law removes as much of some output's error as makes a mismatch count: small other effects are
    in every machine, and what is less than the noise is not named."""
    return bool(np.any(over_floor(problem, single.test.Y, t) - over_floor(problem, pair.test.Y, t) > t.material - 1.0))


def _better_pair(problem, best, pairs, floor, t):
    """The first pair that leaves much less than the best single law, by a second law that likelihoods see: a slow wave
    of a disturbance, which any law bends to, counts once."""
    for h in pairs:
        left = best.test_error - floor
        if _material(problem, best, h, t) and (best.test_error - h.test_error) > t.second_share * left and (
                h.train_error < best.train_error) and likelihood_gain(problem, h, best) >= t.evidence:
            return h
    return None


def _inside(small: Hypothesis, large: Hypothesis) -> bool:
    """Whether `small` is `large` with one law replaced by a law it contains or becomes, at the same places."""
    if len(small.located) != len(large.located):
        return False
    left = list(large.located)
    swapped = 0
    for e in small.located:
        same = next((f for f in left if f.effect.id == e.effect.id and f.place.signal == e.place.signal),
                    None)
        wider = next((f for f in left if e.effect.id in (*f.effect.contains, *f.effect.becomes)
                      and f.place.signal == e.place.signal), None)
        if same is None and wider is None:
            return False
        left.remove(same if same is not None else wider)
        swapped += same is None
    return swapped > 0


def _prefer_smaller(problem, best, passed, singles, t):
    """A law inside the winner's law, at the same place, wins unless the larger one is material by itself: beside what
    the law at that place removes, the other law of a pair being there."""
    floor = floor_square(problem)
    while True:
        smaller = [h for h in passed if _inside(h, best)]
        if not smaller:
            return best
        inner = min(smaller, key=_score)
        gain_test = (inner.test_error - best.test_error) / max(inner.test_error - 0.9 * floor, 1e-12)
        gain_train = (inner.train_error - best.train_error) / max(inner.train_error - 0.9 * floor, 1e-12)
        more = min(inner.test_error - best.test_error, inner.train_error - best.train_error)
        visible = more > t.nested_floor * min(floor, best.train_error) and (
            inner.test_error - best.test_error > t.nested_share * _beside(problem, inner, best, singles))
        if gain_test > t.nested_gain and gain_train > t.nested_gain and visible and criterion(
                problem, best, inner) < -6:
            return best
        best = inner


def _beside(problem, inner: Hypothesis, best: Hypothesis, singles) -> float:
    """Held-out error of the laws that two nested pairs share, fitted alone; the null's where they share none."""
    shared = {e.key for e in inner.located} & {e.key for e in best.located}
    alone = [h.test_error for h in singles if {e.key for e in h.located} == shared]
    return min([mean_square(problem, problem.null_test, problem.test), *alone])


def _name(problem, best, passed, t, rng, reasons) -> Decision:
    """One name, or the set of those the recordings cannot tell from it, the one with the least BIC first."""
    members = [best]
    rest = predicted_rest(problem, best, over_floor(problem, best.test.Y, t), t)
    if rest.any():
        reasons.append(f"the inputs still predict {100 * float(np.max(rest)):.0f} % of what {best.label} leaves: "
                       "something more is missing")
    for h in sorted(passed, key=_score):
        if len(members) >= 3 or any(sorted(h.ids) == sorted(m.ids) for m in members):
            continue
        if _inside(h, best) or _inside(best, h):
            continue
        if any(_inside(inner, h) and _score(inner) < t.rival * _score(h) for inner in passed):
            continue  # a simpler law does as well as this rival: it is the one to compare with
        ratio = _score(h) / max(_score(best), floor_square(problem), 1e-300)  # below the floor nothing is told apart
        if ratio < t.rival or wins(problem, best, h, rng) < t.wins:
            members.append(h)
    if len(members) > 1:
        members.sort(key=lambda h: criterion(problem, h, best))
        reasons.append("rivals within the margin: " + ", ".join(h.label for h in members[1:]))
        return Decision("one_of", members[0], tuple(members), tuple(passed), tuple(reasons))
    return Decision("named", best, (best,), tuple(passed), tuple(reasons))


def _agreement_or_parameters(problem: Problem, t: Thresholds) -> str:
    """Parameters only when the nominal simulator is worse than the refitted one beyond the noise."""
    before = float(np.mean(np.clip((problem.test.Y - problem.nominal_test.Y) / problem.sigma, -1e3,
                                   1e3) ** 2))
    after = mean_square(problem, problem.null_test, problem.test)
    moved = np.any(np.abs(np.expm1(problem.null.theta[:problem.null.model.np])) > t.moved)
    return "parameters_only" if before > 1.05 * after and moved else "agreement"
