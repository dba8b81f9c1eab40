"""Long recordings: candidates are looked for on a few stretches, and what is found there is fitted to everything.

Every stage before the verdict simulates all samples some thousand times. On 6 000 of them laws are told from each other
nearly as well as on 100 000, so the search runs on stretches: those where the refitted null errs most, and others
evenly over the ranks of its error, so that laws are seen at small amplitudes too.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit, fit_model, fit_starts

__all__ = ["evenly", "part_of", "scouted"]

SAMPLES = 6000  # of the training, and of the held-out recordings, that a search needs
WORTH = 2  # times as many samples in training: below it, the search runs on everything
STRETCHES = 6  # at least, unless recordings are longer than that
LASTING = 12  # time constants that a stretch lasts at least


def scouted(problem):
    """The problem on stretches of its recordings, or None where they are short enough, or simulations slow."""
    if len(problem.train.U) <= WORTH * SAMPLES or problem.plant.rhs is None:
        return None
    spans = _telling(problem, problem.coarse, problem.null_coarse)
    (train, index), (coarse, _) = problem.train.windows(spans), problem.coarse.windows(spans)
    test, held = problem.test.windows(_telling(problem, problem.test, problem.null_test))

    def refitted(fit, data):
        start = part_of(fit, data, index)
        return fit_model(fit.model, data, problem.sigma, fit.theta, start.X0, problem.ranges, 8)

    null = refitted(problem.null, train)
    segmented = train.segments.shape != coarse.segments.shape
    start = part_of(problem.null_test, test, held).X0
    return replace(problem, train=train, test=test, coarse=coarse if segmented else train, whole=None, stretches=True,
                   null=null, null_coarse=refitted(problem.null_coarse, coarse) if segmented else null,
                   null_test=fit_starts(null.model, test, problem.sigma, null.theta, start, problem.ranges),
                   nominal=part_of(problem.nominal, train, index),
                   nominal_test=part_of(problem.nominal_test, test, held))


def part_of(fit: Fit, data: Dataset, index) -> Fit:
    """A fit on stretches of its data, as it was there; `data` and `index` as `Dataset.windows` gives them."""
    X0 = fit.X[index[data.segments[:, 0]], :fit.model.nx]
    return Fit(fit.model, fit.theta, X0, np.inf, fit.Y[index], fit.X[index], 0)


def evenly(problem, data: Dataset, samples: int = SAMPLES) -> list[tuple[int, int]]:
    """Stretches of a data set, `samples` in all, at even distances."""
    blocks = _blocks(problem, data, samples)
    count = max(1, round(len(blocks) * samples / len(data.U)))
    return [blocks[k] for k in np.unique(np.linspace(0, len(blocks) - 1, count).round().astype(int))]


def _telling(problem, data: Dataset, null: Fit) -> list[tuple[int, int]]:
    """Stretches where the null errs most, and others evenly over the ranks of its error, in order of time."""
    blocks = _blocks(problem, data, SAMPLES)
    count = max(2, round(len(blocks) * SAMPLES / len(data.U)))
    if count >= len(blocks):
        return blocks
    energy = np.sum(np.clip((data.Y - null.Y) / problem.sigma, -1e3, 1e3) ** 2, axis=1)
    ranked = sorted(blocks, key=lambda s: -float(np.mean(energy[s[0]:s[1]])))
    most = (count + 1) // 2
    rest = np.linspace(most, len(blocks) - 1, count - most).round().astype(int)
    return sorted(ranked[k] for k in {*range(most), *rest})


def _blocks(problem, data: Dataset, samples: int) -> list[tuple[int, int]]:
    """Recordings cut into stretches of equal length, along the segments where there are more of them."""
    least = int(LASTING * problem.structure.time_scale / data.sample_time)
    length, found = max(samples // STRETCHES, least), []
    for a, b in data.recordings:
        edges = np.append(data.segments[data.segments[:, 2] == a, 0], b)
        if len(edges) > 2:
            size = (b - a) / (len(edges) - 1)
            edges = [*edges[:-1:max(1, round(length / size))], b]
        else:
            edges = np.linspace(a, b, max(1, round((b - a) / length)) + 1).astype(int)
        found += itertools.pairwise(int(e) for e in edges)
    return found
