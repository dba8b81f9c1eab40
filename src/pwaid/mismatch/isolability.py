"""Which fitted hypotheses these recordings can tell apart.

For every ordered pair: the outputs that X would have produced are what X fitted simulates; Y is refitted to them
from its own fit. What Y cannot reproduce, in units of the noise floor, is the excess e; with the noise on top the
best fit of Y would err by sqrt(1 + e²) times the floor. Below 1.5 in both directions the two cannot be told apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.hypotheses import Hypothesis
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.refit import Refitter, noise_of, times_noise
from pwaid.mismatch.screen import run_jobs

__all__ = ["ALIKE", "Isolability", "inside", "isolability", "leading", "nested", "window"]

ALIKE = 1.5
MOST = 7
SAMPLES = 8000  # samples times substeps that every simulation of the comparison may take
SLOW_SAMPLES = 400  # ... of a simulator that runs in the plain Python loop


@dataclass(frozen=True)
class Isolability:
    """`matrix` (n, n): row X, column Y: error of Y refitted to what X simulates, in units of the noise floor."""

    hypotheses: tuple[Hypothesis, ...]
    matrix: np.ndarray

    @property
    def labels(self) -> list[str]:
        return [h.label for h in self.hypotheses]

    def alike(self) -> list[tuple[int, int]]:
        """Pairs that cannot be told apart, laws that contain each other left out."""
        n, hs = len(self.hypotheses), self.hypotheses
        return [(i, j) for i in range(n) for j in range(i + 1, n)
                if max(self.matrix[i, j], self.matrix[j, i]) < ALIKE and not nested(hs[i], hs[j])]

    def table(self) -> dict:
        """What report.json holds."""
        return {"labels": self.labels, "matrix": self.matrix.tolist(), "cannot_tell_apart_below": ALIKE,
                "alike": [[self.labels[i], self.labels[j]] for i, j in self.alike()]}


def _laws(h: Hypothesis) -> set[tuple[str, str]]:
    return {(e.effect.id, e.place.channel) for e in h.located}


def inside(small: Hypothesis, large: Hypothesis) -> bool:
    """Whether `large` is `small` plus something: more laws, or a wider law at the same place."""
    wider = _laws(large) | {(i, e.place.channel) for e in large.located for i in e.effect.contains}
    return _laws(small) <= wider


def nested(a: Hypothesis, b: Hypothesis) -> bool:
    """Whether one hypothesis is the other plus something."""
    return inside(a, b) or inside(b, a)


def _adds_to(large: Hypothesis, small: Hypothesis) -> bool:
    """Whether `large` is `small` with more laws, each of which can be turned down until it vanishes."""
    more = [e for e in large.located if (e.effect.id, e.place.channel) not in _laws(small)]
    return _laws(small) < _laws(large) and all(e.effect.quantities for e in more)


def leading(null: Hypothesis, members: Sequence[Hypothesis], others: Sequence[Hypothesis],
            most: int = MOST) -> tuple[Hypothesis, ...]:
    """The null, the named ones, then the best of the others, one per set of laws."""
    chosen = [null]
    for h in [*members, *sorted(others, key=lambda h: h.train_error + h.test_error)]:
        same = any(_laws(h) == _laws(c) for c in chosen)
        if not same and len(chosen) < most and np.all(np.isfinite(h.fit.Y)):
            chosen.append(h)
    return tuple(chosen)


def window(problem: Problem, hypotheses: Sequence[Hypothesis]) -> tuple[Dataset, np.ndarray]:
    """The training data cut so that a simulation stays below a few milliseconds, and the rows kept.

    What is too long is shortened to the head of every segment.
    """
    data = problem.train
    fast = problem.plant.rhs is not None
    samples = SAMPLES // max(h.fit.model.substeps for h in hypotheses) if fast else SLOW_SAMPLES
    if len(data.U) <= samples:
        return data, np.arange(len(data.U))
    each = max(20, samples // len(data.segments))
    keep, rows, new = [], [], 0
    for a, b in data.segments[:max(1, samples // each), :2]:
        n = int(min(b - a, each))
        keep.append(np.arange(a, a + n))
        rows.append((new, new + n, new, new + n))
        new += n
    index = np.concatenate(keep)
    return replace(data, U=np.ascontiguousarray(data.U[index]), Y=np.ascontiguousarray(data.Y[index]),
                   segments=np.array(rows, dtype=np.int64)), index


def isolability(problem: Problem, hypotheses: Sequence[Hypothesis], jobs: int = 1) -> Isolability:
    """Compare every hypothesis with what every other one simulates, on the data of `window`."""
    noise = noise_of(problem)
    data, _ = window(problem, hypotheses)
    segments = len(data.segments)
    refitters = run_jobs(lambda h: Refitter(h, data, h.fit.X0[:segments], noise, problem.ranges), hypotheses, jobs)

    def error(x: Refitter, y: Refitter) -> float:
        if y is x or _adds_to(y.hypothesis, x.hypothesis):
            return 1.0
        return float(np.hypot(1.0, times_noise(x.Y, y.refit(x.Y), noise)))

    def row(x: Refitter) -> list[float]:
        return [error(x, y) for y in refitters]

    return Isolability(tuple(hypotheses), np.array(run_jobs(row, refitters, jobs)))
