"""The null hypothesis: nothing is missing, only nominal parameters and start states are off."""

from __future__ import annotations

import math
import time as clock
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pwaid.errors import InputError
from pwaid.mismatch.accelerometers import rates_shown
from pwaid.mismatch.beginnings import OPENING, first_states, usable_starts
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit, fit_model, fit_starts
from pwaid.mismatch.floor import Floor, estimate_floor
from pwaid.mismatch.model import LIMIT, Model, Settings
from pwaid.mismatch.pace import UNSTABLE, eigenvalues, segment_length, sliding_substeps, substeps_of
from pwaid.mismatch.plant import Plant
from pwaid.mismatch.probing import find_structure
from pwaid.mismatch.sensitive import LOST, SHORTEST, follows, steadied
from pwaid.mismatch.startscan import best_starts, scans, unseen_directions, visited
from pwaid.mismatch.structure import Structure

__all__ = ["Problem", "prepare"]

DEFAULT_TOLERANCE = 0.3


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


def tolerances(plant: Plant, free: Sequence[str], given: Mapping[str, float] | None) -> np.ndarray:
    """Relative tolerance of every free parameter; 30 % unless given."""
    return np.array([float((given or {}).get(n, DEFAULT_TOLERANCE)) for n in free])


def free_names(plant: Plant, free: Sequence[str] | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the parameters to refit, and notes on those left out.

    Raises
    ------
    InputError
        For a name the simulator does not have.
    """
    if free is None:
        entries = plant.linear and not plant.arguments
        free = [n for n, v in plant.parameters.items() if v not in (0.0, 1.0, -1.0)] if entries else list(
            plant.parameters)
        if entries and len(free) > 12:
            free = [n for n in free if n[0] in "BD"]
    unknown = [n for n in free if n not in plant.parameters]
    if unknown:
        raise InputError(f"free parameter {unknown[0]!r} is not a parameter of the simulator; it has "
                         f"{', '.join(plant.parameters) or 'none'}")
    zero = [n for n in free if plant.parameters[n] == 0.0]
    notes = tuple(f"parameter {n} is 0 in the simulator and has no relative tolerance: kept" for n in zero)
    return tuple(n for n in free if n not in zero), notes


def prepare(plant: Plant, train: Dataset, test: Dataset, input_units, output_units, free=None, tolerance=None,
            noise_floor=None, repeats=(), first_order_hold: bool = False, start=None) -> Problem:
    """Refit the nominal simulator and gather what the hypotheses need.

    `start` : parameters on the fitted axis (n_free,) from which the refit is tried too.

    Raises
    ------
    InputError
        When the simulation diverges whatever the start state, or an output never changes.
    """
    for k, name in enumerate(plant.output_names):
        if np.ptp(train.Y[:, k]) == 0:
            raise InputError(f"output {name!r} is constant ({train.Y[0, k]:g}) in every training recording; "
                             "remove it or record while it moves")
    free, notes = free_names(plant, free)
    zero = np.zeros(plant.sizes[0], dtype=np.int64) - 1
    settings = Settings(plant, zero, np.zeros(plant.sizes[0]), free, tolerances(plant, free, tolerance),
                        first_order_hold=first_order_hold)
    rough = _rough_structure(plant, train, input_units, output_units, free)
    settings = replace(settings, partner=rough.partner, ratio=rough.ratio)
    model = Model(settings)
    mapping = rough.start_map
    theta = np.zeros(model.size)
    scale = np.std(train.Y, axis=0) + 1e-12

    growth, fastest = eigenvalues(plant, _state_cloud(plant, rough, train), train.U)
    longest = int(np.max(np.diff(train.recordings)))
    samples = segment_length(growth, longest, train.sample_time, rough.time_scale)
    coarse = train.cut(samples)
    X0 = usable_starts(model, theta, coarse, mapping)
    sliding = sliding_substeps(plant, fastest, train.sample_time)
    model = Model(replace(settings, substeps=substeps_of(model, theta, X0, coarse), sliding=sliding))
    Y, X = model.simulate(theta, X0, coarse)
    notes += _diverging(Y)
    ranges = np.minimum(np.maximum(np.quantile(np.abs(X[np.all(np.isfinite(X), axis=1)]), 0.99, axis=0), 1e-9), 1e6)
    ranges = np.maximum(ranges, plant.start_sizes)
    for k, i in enumerate(rough.output_state):
        if i >= 0:
            ranges[i] = np.max(np.abs(rough.shown.state_of(k, train.Y[:, k]))) + 1e-9
    nominal = fit_starts(model, coarse, scale, theta, X0, ranges, 12)
    first = _null(model, coarse, scale, nominal, ranges, rough.time_scale, start)
    fits, whole = (first, nominal), None
    if samples < longest:
        stable = growth * longest * train.sample_time <= UNSTABLE
        starts = usable_starts(model, first.theta, train, mapping), first.X0[coarse.heads(train)]
        kept = stable and _on_whole(model, train, scale, first.theta, starts, ranges)
        if kept:
            fits = kept, fit_starts(model, train, scale, theta, usable_starts(model, theta, train, mapping), ranges, 12)
        else:
            whole = (train, test) if stable else None
            train, test = coarse, test.cut(samples)
            notes += (f"the simulator is integrating or unstable: {len(train.segments)} segments of about "
                      f"{samples * train.sample_time:.3g} s, each with free start states",)
    null, nominal = fits
    residual = null.residual(train)
    samples = samples if train.segments.shape == coarse.segments.shape else longest
    left = [_left_of_repeats(model, null.theta, group.cut(samples), scale, ranges, mapping) for group in repeats]
    floor = estimate_floor(residual, train.Y, train.segments, plant.output_names, noise_floor, left)
    rms = np.sqrt(np.mean(np.clip(residual, -1e6, 1e6) ** 2, axis=0))
    sigma = np.sqrt(np.maximum(floor.level, 1e-5 * scale) ** 2 + (0.1 * rms) ** 2)
    null = fit_model(model, train, sigma, null.theta, null.X0, ranges, 20)
    null_coarse = null if train.segments.shape == coarse.segments.shape else fit_model(
        model, coarse, sigma, first.theta, first.X0, ranges, 20)
    X0t = usable_starts(model, null.theta, test, mapping)
    if plant.black_box is not None:  # outputs do not tell its start: come near it before errors are weighted finely
        X0t = fit_starts(model, test, scale, theta, X0t, ranges, 12).X0
    nominal_test = fit_starts(model, test, sigma, theta, X0t, ranges, 12)
    null_test = fit_starts(model, test, sigma, null.theta, X0t, ranges, 12)
    length = float(np.max(np.diff(train.recordings)) * train.sample_time)
    structure = find_structure(plant, null.X[:, :plant.sizes[0]], train.U, train.Y, input_units, output_units,
                               train.sample_time, length, free)
    if not np.all(np.isfinite(null.cost)):
        warnings.warn("the nominal simulation could not be fitted", stacklevel=2)
    settings = replace(model.settings, rates_shown=rates_shown(structure))
    problem = Problem(plant, settings, train, test, coarse, sigma, floor, structure, ranges, nominal, null, null_coarse,
                      nominal_test, null_test, notes, whole)
    if plant.rhs is None:
        return problem
    steady = steadied(problem) if samples >= longest else problem
    return problem.kept() if steady is problem else steady  # where it parts, no start state is a lost one


def _on_whole(model, train, scale, theta, starts, ranges) -> Fit | None:
    """The null on whole recordings, from its fit on segments and the better of several start states; None where that
    loses an output.

    Every start state that a segment brings can absorb part of what is to be explained, so recordings are judged
    whole unless the refitted simulation cannot be kept on them: an error above LOST of an output's spread.
    """
    fit = min((fit_model(model, train, scale, theta, X0, ranges, 12, 1e-3) for X0 in starts), key=lambda f: f.cost)
    error = np.sqrt(np.mean(fit.residual(train) ** 2, axis=0))
    return fit if np.all(error < LOST * scale) else None


def _diverging(Y) -> tuple[str, ...]:
    """A note on samples that the nominal simulation loses.

    Raises
    ------
    InputError
        When it loses nearly all.
    """
    share = np.mean(np.any(~(np.abs(Y) < LIMIT), axis=1))
    if share > 0.9:
        raise InputError("the simulation diverges from every start state; check signs and units of the simulator, and "
                         "whether a sensor or a force has a constant offset that the simulator knows nothing of")
    return (f"the nominal simulation diverges on {100 * share:.0f} % of the samples before refitting",) if share else ()


def _left_of_repeats(model, theta, group: Dataset, scale, ranges, mapping) -> list[np.ndarray]:
    """What the simulator, refitted to them, leaves of recordings under one input: repeats that begin differently differ
    by more than noise. A black box begins as it does."""
    left = group.Y
    if model.settings.plant.black_box is None:
        X0 = usable_starts(model, theta, group, mapping)
        near = fit_starts(model, group, scale, theta, X0, ranges, 12)
        rms = np.sqrt(np.mean(np.clip(near.residual(group), -1e6, 1e6) ** 2, axis=0))
        sigma = rms + 1e-5 * scale  # fine enough that data outweigh tolerances
        left = fit_model(model, group, sigma, theta, near.X0, ranges, 20).residual(group)
    return [left[a:b] for a, b in group.recordings]


def _rough_structure(plant, train, input_units, output_units, free):
    """Structure probed before any simulation, on states scaled by the outputs."""
    nx = plant.sizes[0]
    reach = float(np.max(np.abs(train.Y))) or 1.0
    rng = np.random.default_rng(0)
    states = rng.uniform(0.05, 1.0, (64, nx)) * reach
    length = float(np.max(np.diff(train.recordings)) * train.sample_time)
    return find_structure(plant, states, train.U, train.Y, input_units, output_units, train.sample_time,
                          length, free)


def _state_cloud(plant, rough, train):
    states = np.zeros((len(train.U), plant.sizes[0]))
    for k, i in enumerate(rough.output_state):
        if i >= 0:
            states[:, i] = rough.shown.state_of(k, train.Y[:, k])
    return states


def _null(model, train, scale, nominal, ranges, time_scale, start=None):
    """Short segments first, so that a wrong frequency does not strand the fit, then the whole recordings; and from
    `start` where it is given."""
    best = fit_model(model, train, scale, nominal.theta, nominal.X0, ranges, 25)
    whole = int(np.median(np.diff(train.segments[:, :2])))
    short = int(max(40, 6 * time_scale / train.sample_time))
    if short < whole / 3:
        cut = train.cut(short)
        starts = nominal.X[cut.segments[:, 0], :model.nx]
        for i in range(model.nx):
            starts[~np.isfinite(starts[:, i]) | (np.abs(starts[:, i]) > 1e6), i] = 0.0
        pre = fit_model(model, cut, scale, nominal.theta, starts, ranges, 15)
        other = fit_model(model, train, scale, pre.theta, nominal.X0, ranges, 25)
        best = min(best, other, key=lambda f: f.cost)
    if start is not None:
        there = fit_starts(model, train, scale, start, nominal.X0, ranges, 12)
        other = fit_model(model, train, scale, start, there.X0, ranges, 25)
        best = min(best, other, key=lambda f: f.cost)
    return best
