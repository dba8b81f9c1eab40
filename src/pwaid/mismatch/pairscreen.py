"""The signature screen for two effects at once.

Where two effects are missing, the best single one is often neither: it bends to do the work of both, and what is built
on it is wrong. Their signatures together, at the refitted null, explain more of the residual than any other two; that
is a least-squares problem in two columns for every pair of sizes, and costs no simulation beyond those of the screen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pwaid.mismatch.fit import Fit
from pwaid.mismatch.model import Located
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.screen import run_jobs
from pwaid.mismatch.signatures import Signatures, mirrored, one_signed

__all__ = ["PairScreened", "screen_pairs"]

SIZES = 12  # signatures kept of a candidate
ALIKE = 0.95  # two signatures with a larger cosine are one: their difference fits noise
LEAST_SHARE = 1e-4  # a signature of which less is left than this is a parameter in disguise


@dataclass(frozen=True)
class PairScreened:
    """Two candidates, the share of the residual that they explain together, and their starts on the fitted axes."""

    located: tuple[Located, Located]
    score: float
    starts: tuple[np.ndarray, np.ndarray]


def screen_pairs(problem: Problem, fit: Fit, located: Sequence[Located], count: int, jobs: int = 1,
                 allowed=lambda a, b: True) -> list[PairScreened]:
    """The `count` best pairs of different ids and places on top of `fit`, a fit to `problem.coarse`, best first.

    `allowed` tells whether two candidates may be a pair.
    """
    signatures = Signatures(problem, fit)

    def best_of(candidate):
        found = [s for s in signatures.of(candidate) if s.seen and s.share > LEAST_SHARE]
        many = len(found) if candidate.effect.id == "position_ripple" else SIZES  # its sizes are different laws
        return [(candidate, s) for s in sorted(found, key=lambda s: -abs(s.dot))[:many]]

    entries = [entry for found in run_jobs(best_of, located, jobs) for entry in found]
    if len(entries) < 2 or not signatures.power > 0.0:
        return []
    share, weights = _together(np.array([s.direction for _, s in entries]), signatures.residual,
                               np.array([one_signed(c) for c, _ in entries]))
    found: dict[frozenset, PairScreened] = {}
    for k in np.argsort(-share, axis=None):
        i, j = divmod(int(k), len(entries))
        if share[i, j] <= 0.0 or len(found) == count:
            break
        (a, one), (b, other) = entries[i], entries[j]
        key = frozenset((e.effect.id, e.place.signal) for e in (a, b))
        if i < j and len(key) == 2 and key not in found and allowed(a, b):
            starts = tuple(s.start if w > 0.0 else mirrored(s.start)
                           for s, w in ((one, weights[i, j]), (other, weights[j, i])))
            found[key] = PairScreened((a, b), float(share[i, j] / signatures.power), starts)
    return list(found.values())


def _together(S, e, signed) -> tuple[np.ndarray, np.ndarray]:
    """For every two rows of S (n, N), of length one: the square of e (N,) that both explain, and the first's weight.

    Zero where a weight would be negative though `signed` (n,) says that it cannot, or where the rows are alike.
    """
    alone, cosine = S @ e, S @ S.T
    alike = np.abs(cosine) > ALIKE
    weights = (alone[:, None] - cosine * alone) / np.where(alike, 1.0, 1.0 - cosine**2)
    share = weights * alone[:, None] + weights.T * alone
    against = signed[:, None] & (weights < 0.0)
    share[alike | against | against.T] = 0.0
    return share, weights
