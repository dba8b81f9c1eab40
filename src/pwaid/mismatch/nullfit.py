"""What all hypotheses share: data, weights, and the fits of the null, that only parameters and start states are off."""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pwaid.mismatch.beginnings import OPENING, first_states, usable_starts
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit, fit_model, fit_starts
from pwaid.mismatch.floor import Floor
from pwaid.mismatch.model import Settings
from pwaid.mismatch.plant import Plant
from pwaid.mismatch.sensitive import SHORTEST, follows
from pwaid.mismatch.startscan import best_starts, scans, unseen_directions, visited
from pwaid.mismatch.structure import Structure

__all__ = ["Problem"]


@dataclass(frozen=True)
class Problem:
    """Everything the hypotheses share: data, weights, floor, structure, and the nominal and null fits.

    `coarse` is `train` cut into segments that any start of the parameters can follow; candidates are screened and
    first fitted there, then on `train`. `whole` holds the recordings uncut where only the null loses them. `brief` says
    that `coarse` holds segments so short that every motion is kept, `stretches` that the data are parts of recordings.
    From `deadline` on, seconds of the monotonic clock, nothing further is looked for.
    """

    plant: Plant
    settings: Settings
    train: Dataset
    test: Dataset
    coarse: Dataset
    sigma: np.ndarray
    floor: Floor
    structure: Structure
    ranges: np.ndarray
    nominal: Fit
    null: Fit
    null_coarse: Fit
    nominal_test: Fit
    null_test: Fit
    notes: tuple[str, ...] = ()
    whole: tuple[Dataset, Dataset] | None = None
    brief: bool = False
    stretches: bool = False
    deadline: float = math.inf

    @property
    def late(self) -> bool:
        """Whether the deadline is over."""
        return clock.monotonic() > self.deadline

    def measured(self, data: Dataset) -> np.ndarray:
        """Start states as the first samples show them, (segments, nx)."""
        return first_states(self.plant, self.structure.start_map, data)

    def heldout(self, fit: Fit) -> Fit:
        """The fitted model on the held-out recordings, its start states fitted there, segment by segment the best of
        several starts: the null's, which may be bent to absorb the effect; the measured ones; for states that the
        null does not see, a scan of the range they visit; states visited in training; and what the first seconds alone
        show."""
        best = fit_starts(fit.model, self.test, self.sigma, fit.theta, self.null_test.X0, self.ranges)
        options = [self.measured(self.test), *scans(self, fit, best.X0, self.test)]
        best = best_starts(self, fit, best, options, self.test)
        if self.plant.rhs is None or follows(self, best, self.test):
            return best
        return self._opened(best_starts(self, fit, best, [visited(self, fit, self.test)], self.test), self.test)

    def _opened(self, fit: Fit, data: Dataset) -> Fit:
        """The fit with start states that fit the first seconds of a segment, where they lead to less: in a motion that
        is sensitive, those of the whole segment end in the wrong valley."""
        if self.plant.rhs is None or follows(self, fit, data):
            return fit
        return best_starts(self, fit, fit, [self.opening_starts(fit, data)], data)

    def opening_starts(self, fit: Fit, data: Dataset) -> np.ndarray:
        """Start states (segments, nx) that fit the first seconds of each segment, from the measured ones; on stretches,
        where those of the null are no help, also from ones that fit its first samples, and then three and nine times
        as long, since the valleys grow narrow with the length."""
        length = max(SHORTEST, int(6 * self.structure.time_scale / data.sample_time))
        first = data.openings(length)
        near = self._from_measured(fit, first)
        if not self.stretches:
            return near.X0
        X0 = best_starts(self, fit, near, [self._from_measured(fit, data.openings(OPENING)).X0], first).X0
        longest = int(np.max(np.diff(data.segments[:, :2])))
        for longer in (n for n in (3 * length, 9 * length) if n < longest):
            X0 = fit_starts(fit.model, data.openings(longer), self.sigma, fit.theta, X0, self.ranges).X0
        return X0

    def _from_measured(self, fit: Fit, data: Dataset) -> Fit:
        """The fit's parameters with start states fitted from the measured ones."""
        return fit_starts(fit.model, data, self.sigma, fit.theta, self.measured(data), self.ranges, 12)

    def rescanned(self, fit: Fit) -> Fit:
        """A fit to `coarse`, with start states that the null does not see looked for over their range.

        As it came where simulations are slow.
        """
        if self.plant.rhs is None:
            return fit
        return best_starts(self, fit, fit, scans(self, fit, fit.X0, self.coarse), self.coarse)

    def restarted(self, fit: Fit) -> Fit:
        """A fit to `train`, with better start states where another start of theirs leads to some: the null's, the
        measured ones, a scan of those that the null does not see, and what the first seconds show. As it came where
        simulations are slow."""
        if self.plant.rhs is None:
            return fit
        options = [self.null.X0] if len(self.null.X0) == len(fit.X0) else []
        options.append(self.measured(self.train))
        options += scans(self, fit, fit.X0, self.train)
        return self._opened(best_starts(self, fit, fit, options, self.train), self.train)

    def kept(self) -> Problem:
        """The problem with start states of the null looked for again, on training and held-out recordings, where it is
        not at the floor: one that was lost would pass for physics left out."""
        again, null = self.restarted(self.null), self.null
        if again is not null:
            found = fit_model(again.model, self.train, self.sigma, again.theta, again.X0, self.ranges, 20)
            null = min(null, found, key=lambda f: f.cost)
        same = self.null_coarse is self.null
        problem = replace(self, null=null, null_coarse=null if same else self.null_coarse)
        return replace(problem, null_test=problem.heldout(null))

    @cached_property
    def together(self) -> Fit:
        """The null refitted to the training and the held-out recordings at once, the latter behind the former."""
        both, X0 = self.train.and_also(self.test), np.vstack([self.null.X0, self.null_test.X0])
        return fit_model(self.null.model, both, self.sigma, self.null.theta, X0, self.ranges, 20)

    @cached_property
    def unseen(self) -> list[tuple[int, np.ndarray]]:
        """Directions of the start state that the null's outputs do not depend on."""
        return unseen_directions(self)

    def uncut(self) -> Problem:
        """The same problem judged on whole recordings, for hypotheses that keep them where the null does not."""
        train, test = self.whole
        s, model, theta = self.structure, self.null.model, self.null_coarse.theta
        mapping = s.start_map

        def fitted(data, values, fit=fit_starts, **more):
            X0 = usable_starts(model, values, data, mapping)
            return fit(model, data, self.sigma, values, X0, self.ranges, 20, **more)

        null = fitted(train, theta, fit_model)
        return replace(self, train=train, test=test, whole=None, nominal=fitted(train, 0 * theta), null=null,
                       nominal_test=fitted(test, 0 * theta), null_test=fitted(test, null.theta))
