"""The evidence a verdict rests on: every hypothesis worth fitting, fitted.

    screen -> fit -> pairs
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pwaid.mismatch.decide import at_floor
from pwaid.mismatch.effects.base import Effect
from pwaid.mismatch.hypotheses import (
    Hypothesis,
    fit_contained,
    fit_inner,
    fit_members,
    fit_pairs,
    fit_shortlist,
    fit_swaps,
    floor_square,
    hypothesis_of,
    null_hypothesis,
    on_whole,
)
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.screen import Screened, locate_effects, overlooked, run_jobs, screen, shortlist
from pwaid.mismatch.thresholds import Thresholds

__all__ = ["Evidence", "gather"]

KEPT = 2.0  # times the noise floor
MATERIAL, REACHED = 1.25, 1.2  # times the floor's mean square: above it the null errs; below it a law leaves nothing


@dataclass(frozen=True)
class Evidence:
    """The refitted null, the screen, and the fitted single effects and pairs of one problem, best first.

    `tried` counts hypotheses, `notes` holds what hygiene found, `loop` the controller's loop where it is known.
    """

    problem: Problem
    null: Hypothesis
    screened: tuple[Screened, ...]
    singles: tuple[Hypothesis, ...]
    pairs: tuple[Hypothesis, ...]
    tried: int
    notes: tuple[str, ...] = ()
    loop: object = None


def gather(problem: Problem, catalogue: Sequence[Effect], notes: Sequence[str] = (), jobs: int = 1,
           progress: Callable | None = None) -> Evidence:
    """Screen the catalogue at every place this simulator offers, fit the best, and pairs where they may matter."""
    say = progress or (lambda fraction, text: None)
    located = locate_effects(catalogue, problem.structure)
    say(0.15, f"screening {len(located)} candidates")
    null = null_hypothesis(problem)
    screened = screen(problem, problem.null_coarse, located, jobs)
    chosen = shortlist(screened)
    if at_floor(problem, Thresholds()):
        chosen = chosen[:3]  # nothing to explain: the best few are fitted so that the report can show them
    say(0.3, f"fitting {len(chosen)} candidates")
    singles = fit_shortlist(problem, chosen, jobs)
    if singles and problem.plant.rhs is not None and null.test_error >= MATERIAL * floor_square(problem) \
            and _above_floor(problem, singles):
        say(0.45, "fitting effects that the screen does not see")
        more = fit_shortlist(problem, overlooked(screened, chosen), jobs, keep=2)
        singles = sorted([*singles, *more], key=lambda h: h.train_error)
    singles = fit_contained(problem, singles, located, jobs)
    if problem.whole is not None and singles and _keeps_whole(problem, singles[0]):
        problem = problem.uncut()
        null = null_hypothesis(problem)
        singles = sorted(run_jobs(lambda h: hypothesis_of(problem, on_whole(problem, h.coarse), h.score, h.coarse),
                                  singles, jobs), key=lambda h: h.train_error)
    pairs = []
    if singles and _worth_pairs(problem, null, singles):
        say(0.6, "fitting pairs")
        cheap = len(problem.train.U) * problem.settings.substeps < 5000
        pairs = fit_pairs(problem, singles, located, jobs, width=4 if cheap else 2)
        if pairs and _short_of_floor(problem, null, pairs):
            pairs = sorted([*pairs, *fit_swaps(problem, pairs, located, jobs)], key=lambda h: h.train_error)
        singles = fit_members(problem, pairs, singles, jobs)
        pairs = sorted([*pairs, *fit_inner(problem, pairs, singles, located, jobs)], key=lambda h: h.train_error)
    return Evidence(problem, null, tuple(screened), tuple(singles), tuple(pairs), len(located) + len(pairs),
                    tuple(notes))


def _keeps_whole(problem, best: Hypothesis) -> bool:
    """Whether the best hypothesis stays within KEPT times the floor on the uncut training recordings.

    Then they tell laws apart that segments with their free start states do not. Short of the floor, an error of the
    force piles up over a whole recording until it says nothing about the law.
    """
    train, _ = problem.whole
    fit = on_whole(replace(problem, train=train), best.coarse)
    error = np.sqrt(np.mean(fit.residual(train) ** 2, axis=0))
    return bool(np.all(error < KEPT * problem.floor.level))


def _worth_pairs(problem, null, singles) -> bool:
    """Pairs are searched unless the best single law already reaches the floor, or there is nothing to explain."""
    return null.test_error >= MATERIAL * floor_square(problem) and _short_of_floor(problem, null, singles)


def _above_floor(problem, fitted) -> bool:
    """Whether even the best of the fitted leaves more than the floor."""
    return min(h.train_error for h in fitted) > REACHED * floor_square(problem)


def _short_of_floor(problem, null, fitted) -> bool:
    """The same, and more than a trifle of the null's error."""
    return _above_floor(problem, fitted) and min(h.train_error for h in fitted) > 0.002 * null.train_error
