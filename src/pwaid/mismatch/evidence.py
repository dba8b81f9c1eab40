"""The evidence a verdict rests on: every hypothesis worth fitting, fitted.

    screen -> fit -> pairs
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pwaid.mismatch.adequacy import stretched
from pwaid.mismatch.decide import at_floor
from pwaid.mismatch.effects.base import Effect
from pwaid.mismatch.fit import fit_model, fit_starts
from pwaid.mismatch.floor import Floor
from pwaid.mismatch.hypotheses import (
    Hypothesis,
    fit_shortlist,
    floor_square,
    hypothesis_of,
    kept_on_whole,
    null_hypothesis,
    on_whole,
)
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.pairs import fit_inner, fit_joint, fit_members, fit_pairs, fit_reversed, fit_swaps
from pwaid.mismatch.scout import scouted
from pwaid.mismatch.screen import Screened, locate_effects, overlooked, run_jobs, screen, shortlist
from pwaid.mismatch.secondlooks import (
    fit_by_segments,
    fit_contained,
    fit_lookalikes,
    fit_partners_by_segments,
    fit_rates,
)
from pwaid.mismatch.thresholds import Thresholds
from pwaid.mismatch.vetoes import veto

__all__ = ["Evidence", "gather"]

KEPT = 2.0  # times the noise floor
# Times the floor's mean square: above MATERIAL the null errs; a law that leaves at most REACHED of it in training, and
# CARRIED on held-out recordings, leaves nothing to look for.
MATERIAL, REACHED, CARRIED = 1.25, 1.2, 2.0
# What other small effects of a machine leave, of the null's mean square; unless it is five times the noise.
TRIFLE, SEEN = 0.002, 25.0
LED, STRANDED = 3, 0.7  # singles whose parameters the null is tried at, and times its cost that shows it was stranded
# Singles, and pairs, of a search on stretches that are promoted to all recordings; those that err DISTANT times as much
# there (root mean square) as the best of all keep their parameters: they are no rivals, and such fits take long.
PROMOTED, DISTANT = 8, 3.0
BELOW = 0.8  # of the floor by repeats: no noise can be undercut so on recordings that were not fitted
BEATEN = ("the repeated recordings differ by more than a fitted law leaves of others that it was not fitted to: the "
          "noise floor is what it leaves")
# The step of a law of rounding is that of the readings to this share; it must leave this share of the floor.
SAME_STEP, FINER = 0.02, 0.7
ROUNDED = "the readings of {} are multiples of {:.4g}: the noise floor is what a law of that rounding leaves"
STOPPED = ("the time given was over before every law and pair had been tried: what is named may have rivals that were "
           "not; give more minutes to look on")


@dataclass(frozen=True)
class Evidence:
    """The refitted null, the screen, and the fitted single effects and pairs of one problem, best first.

    `tried` counts hypotheses, `notes` holds what hygiene found, `loop` the controller's loop where it is known;
    `lower` are nominal parameters (n_free,) at which the null errs far less than where its refit ended.
    """

    problem: Problem
    null: Hypothesis
    screened: tuple[Screened, ...]
    singles: tuple[Hypothesis, ...]
    pairs: tuple[Hypothesis, ...]
    tried: int
    notes: tuple[str, ...] = ()
    loop: object = None
    lower: np.ndarray | None = None


def gather(problem: Problem, notes: Sequence[str], catalogue: Sequence[Effect], jobs: int = 1,
           progress: Callable | None = None, settled: bool = False) -> Evidence:
    """Screen the catalogue at every place this simulator offers, fit the best, and pairs where they may matter.

    Long recordings are searched on stretches first; what is found there is fitted to all of them. A search that finds
    the null stranded stops with `Evidence.lower`, unless that is `settled`.
    """
    say = progress or (lambda fraction, text: None)
    small = scouted(problem)
    found = _search(small or problem, catalogue, jobs, say, settled)
    problem = found.problem if small is None else replace(problem, floor=found.problem.floor)
    if problem.floor.beaten:
        notes = (*notes, problem.floor.beaten)
    singles, pairs = found.singles, found.pairs
    if small is not None and found.lower is None:
        say(0.75, f"fitting what {len(small.train.U)} samples show to all {len(problem.train.U)}")
        rival = DISTANT**2 * min((h.train_error for h in (*singles, *pairs)), default=0.0)
        singles, pairs = (_promoted(problem, fitted, rival, jobs) for fitted in (singles, pairs))
        if problem.whole is not None and singles and _keeps_whole(problem, singles[0]):
            problem = problem.uncut()
            singles, pairs = (_judged(problem, fitted, jobs) for fitted in (singles, pairs))
        found = replace(found, problem=problem, null=null_hypothesis(problem))
        notes = (*notes, f"candidates were looked for on {len(small.train.U)} of {len(problem.train.U)} training "
                         "samples, and the best were fitted to all")
    if problem.late:
        notes = (*notes, STOPPED)
    return replace(found, singles=tuple(singles), pairs=tuple(pairs), notes=tuple(notes))


def _lower_floor(problem: Problem, singles: Sequence[Hypothesis]) -> Floor | None:
    """The floor put down to what a law leaves that stays below it where it was not fitted: repeats were disturbed more
    than the other recordings, or readings are rounded, as a law of rounding with their step shows."""
    floor = problem.floor
    if floor.beaten:
        return None
    if floor.repeated:
        of_all = np.ones(len(floor.level), dtype=bool)
        return _beaten(problem, singles, of_all, BELOW, 1.0, BEATEN)
    for k in np.flatnonzero(floor.rounding) if floor.rounding is not None else ():
        name, step = problem.plant.output_names[k], floor.rounding[k]
        laws = [h for h in singles if _rounds(problem, h.located[0]) and h.located[0].place.ii[7] == k
                and abs(h.values()[0][0] / step - 1.0) < SAME_STEP]
        lower = _beaten(problem, laws, np.arange(len(floor.level)) == k, FINER, FINER, ROUNDED.format(name, step))
        if lower is not None:
            return lower
    return None


def _rounds(problem: Problem, located) -> bool:
    """Whether this is a law of rounding at an output whose floor may be that of its rounding."""
    steps = problem.floor.rounding
    return steps is not None and located.effect.id == "sensor_quantization" and steps[located.place.ii[7]] > 0.0


def _beaten(problem: Problem, laws: Sequence[Hypothesis], outputs, held_out: float, trained: float,
            why: str) -> Floor | None:
    """The floor with the level of these outputs (ny,) put down to what the best of the laws leaves; None where that is
    more than the given shares of it, on held-out recordings or in training."""
    level = problem.floor.level
    best = min(laws, key=lambda h: h.test_error, default=None)
    if best is None:
        return None
    left, kept = (np.sqrt(np.mean((data.Y - fit.Y) ** 2, axis=0)) for data, fit in (
        (problem.test, best.test), (problem.train, best.fit)))
    if np.any((left > held_out * level)[outputs]) or np.any((kept > trained * level)[outputs]):
        return None
    return replace(problem.floor, level=np.where(outputs, np.maximum(kept, left), level), trusted=False, beaten=why)


def _promoted(problem: Problem, fitted: Sequence[Hypothesis], rival: float, jobs: int) -> list[Hypothesis]:
    """The best of what was fitted to stretches, fitted to everything, best first; above the error `rival` there, with
    the parameters found there."""

    def refit(h):
        begun = h.coarse.model, problem.coarse, problem.sigma, h.coarse.theta, problem.null_coarse.X0, problem.ranges
        if h.train_error > rival:
            coarse = fit_starts(*begun)
            return hypothesis_of(problem, kept_on_whole(problem, coarse), h.score, coarse)
        return _judged_one(problem, replace(h, coarse=problem.rescanned(fit_model(*begun, 20, 3e-4))))

    return _sorted(run_jobs(refit, fitted[:PROMOTED], jobs))


def _judged(problem: Problem, fitted: Sequence[Hypothesis], jobs: int) -> list[Hypothesis]:
    """Hypotheses with their fits on the problem's recordings from those on its segments, best first."""
    return _sorted(run_jobs(lambda h: _judged_one(problem, h), fitted, jobs))


def _judged_one(problem: Problem, h: Hypothesis) -> Hypothesis:
    """One of them."""
    return hypothesis_of(problem, on_whole(problem, h.coarse), h.score, h.coarse)


def _search(problem: Problem, catalogue: Sequence[Effect], jobs: int, say: Callable, settled: bool) -> Evidence:
    """The search on the problem as it is."""
    located = locate_effects(catalogue, problem.structure)
    say(0.15, f"screening {len(located)} candidates")
    null = null_hypothesis(problem)
    screened = screen(problem, problem.null_coarse, located, jobs)
    chosen = shortlist(screened)
    if at_floor(problem, Thresholds()):
        # nothing to explain: the best few are fitted so that the report can show them, and whatever rounds readings
        chosen = chosen[:3] + [s for s in screened if s not in chosen[:3] and _rounds(problem, s.located)]
    say(0.3, f"fitting {len(chosen)} candidates")
    singles = fit_shortlist(problem, chosen, jobs)
    lower = _lower_floor(problem, singles)
    if lower is not None:
        return _search(replace(problem, floor=lower), catalogue, jobs, say, settled)
    errs = bool(singles) and _errs(problem, null)
    if errs and not problem.late and problem.plant.rhs is not None and _above_floor(problem, singles):
        say(0.45, "fitting effects that the screen does not see")
        singles += fit_shortlist(problem, overlooked(screened, chosen), jobs, keep=2)
    singles = fit_contained(problem, _sorted(singles), located, jobs)
    if errs and not problem.late:
        singles = fit_lookalikes(problem, singles, located, jobs)
        if problem.plant.rhs is not None and _short_of_floor(problem, null, singles):
            singles = fit_by_segments(problem, singles, located, jobs)
    if problem.whole is not None and singles and _keeps_whole(problem, singles[0]):
        problem = problem.uncut()
        null, singles = null_hypothesis(problem), _judged(problem, singles, jobs)
    if problem.late or not singles or not _errs(problem, null):
        return Evidence(problem, null, tuple(screened), tuple(singles), (), len(located))
    lower, pairs = None if settled else _lower_valley(problem, singles), []
    if lower is None and _short_of_floor(problem, null, singles):
        say(0.6, "fitting pairs")
        singles, pairs = _pairs(problem, null, singles, located, jobs)
        if problem.plant.rhs is not None and not problem.late and _short_of_floor(problem, null, pairs or singles):
            singles, pairs = (fit_rates(problem, fitted) for fitted in (singles, pairs))
    return Evidence(problem, null, tuple(screened), tuple(singles), tuple(pairs), len(located) + len(pairs),
                    lower=lower)


def _lower_valley(problem: Problem, singles: Sequence[Hypothesis]) -> np.ndarray | None:
    """Nominal parameters at which the null errs far less than where its own refit was stranded, or None.

    A law of hardly any size may lead them there.
    """
    null = problem.null_coarse
    for h in singles[:LED]:
        theta = h.coarse.theta[:null.model.np]
        fit = fit_model(null.model, problem.coarse, problem.sigma, theta, h.coarse.X0, problem.ranges, 8)
        if fit.cost < STRANDED * null.cost:
            return fit.theta
    return None


def _pairs(problem, null, singles, located, jobs):
    """The singles, refitted from good pairs, and the pairs; best first."""
    cheap = len(problem.train.U) * problem.settings.substeps < 5000
    pairs = fit_joint(problem, located, jobs) if problem.plant.rhs is not None else []  # too long in Python
    if not problem.late:
        pairs += fit_pairs(problem, singles, _sound(problem, singles), located, jobs, width=4 if cheap else 2)
    pairs = _sorted(pairs)
    if pairs and not problem.late and _short_of_floor(problem, null, pairs):
        pairs += fit_swaps(problem, _sound(problem, pairs), located, jobs)
    pairs = _sorted(pairs)
    if problem.plant.rhs is not None and not problem.late and _short_of_floor(problem, null, pairs or singles):
        best = _sound(problem, singles)[0]
        others = [c for c in located if c.key != best.located[0].key]
        pairs = _sorted([*pairs, *fit_partners_by_segments(problem, best, others, jobs)])
    pairs = _sorted([*pairs, *fit_reversed(problem, pairs, jobs)])
    singles = fit_members(problem, pairs, singles, jobs)
    if problem.late:
        return singles, pairs
    return singles, _sorted([*pairs, *fit_inner(problem, _sound(problem, pairs), located, jobs)])


def _sorted(fitted) -> list[Hypothesis]:
    return sorted(fitted, key=lambda h: h.train_error)


def _keeps_whole(problem, best: Hypothesis) -> bool:
    """Whether the best hypothesis stays within KEPT times the floor on the uncut training recordings.

    Then they tell laws apart that segments with their free start states do not. Short of the floor, an error of the
    force piles up over a whole recording until it says nothing about the law.
    """
    train, _ = problem.whole
    fit = on_whole(replace(problem, train=train), best.coarse)
    error = np.sqrt(np.mean(fit.residual(train) ** 2, axis=0))
    return bool(np.all(error < KEPT * problem.floor.level))


def _sound(problem, fitted) -> list[Hypothesis]:
    """Those that physics does not forbid, or all where it forbids all: on them others are built."""
    return [h for h in fitted if not veto(problem, h)] or list(fitted)


def _errs(problem, null) -> bool:
    """Whether there is anything to explain on held-out recordings."""
    return not at_floor(problem, Thresholds()) and null.test_error >= MATERIAL * floor_square(problem)


def _above_floor(problem, fitted, trifle: float = 0.0) -> bool:
    """Whether all of the fitted leave more than the floor and a trifle in training, or stand for other physics.

    At the floor in training and far from it on held-out recordings, a law does, and so does one that has a veto, or
    that bends parameters beyond what they may be.
    """
    floor = floor_square(problem)
    reached = [h for h in fitted if h.train_error <= max(REACHED * floor, trifle)]
    return not any(h.test_error <= max(CARRIED * floor, trifle) and not veto(problem, h)
                   and not stretched(problem, h, Thresholds()) for h in reached)


def _short_of_floor(problem, null, fitted) -> bool:
    """The same, where a trifle of the null's error that is hardly seen counts as nothing left."""
    return _above_floor(problem, fitted, min(TRIFLE * null.train_error, SEEN * floor_square(problem)))
