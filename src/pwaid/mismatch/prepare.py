"""The null hypothesis fitted: nothing is missing, only nominal parameters and start states are off."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pwaid.errors import InputError
from pwaid.mismatch.accelerometers import rates_shown
from pwaid.mismatch.beginnings import usable_starts
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit, fit_model, fit_starts
from pwaid.mismatch.floor import Floor, estimate_floor
from pwaid.mismatch.model import LIMIT, Model, Settings
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.pace import UNSTABLE, eigenvalues, segment_length, sliding_substeps, substeps_of
from pwaid.mismatch.plant import Plant
from pwaid.mismatch.probing import find_structure
from pwaid.mismatch.sensitive import LOST, steadied
from pwaid.mismatch.structure import Structure

__all__ = ["prepare"]

DEFAULT_TOLERANCE = 0.3


@dataclass(frozen=True)
class _Ground:
    """What the fits of the null share: the model without any law, the spread of the outputs (ny,), ranges of the start
    states (nx,), and how outputs show states."""

    model: Model
    scale: np.ndarray
    ranges: np.ndarray
    mapping: object

    def starts(self, theta, data: Dataset) -> np.ndarray:
        """Start states that the outputs show, (segments, nx)."""
        return usable_starts(self.model, theta, data, self.mapping)

    def fit_starts(self, data: Dataset, theta, X0, sigma=None) -> Fit:
        """Start states fitted; in units of the spread unless `sigma` is given."""
        return fit_starts(self.model, data, self.scale if sigma is None else sigma, theta, X0, self.ranges, 12)

    def fit(self, data: Dataset, theta, X0, iterations: int, *more, sigma=None) -> Fit:
        """Parameters fitted too."""
        return fit_model(self.model, data, self.scale if sigma is None else sigma, theta, X0, self.ranges, iterations,
                         *more)


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
    rough = _rough_structure(plant, train, input_units, output_units, free)
    settings = Settings(plant, rough.partner, rough.ratio, free, tolerances(plant, free, tolerance),
                        first_order_hold=first_order_hold, share=rough.share, empty=rough.empty)
    growth, fastest = eigenvalues(plant, _state_cloud(plant, rough, train), train.U)
    longest = int(np.max(np.diff(train.recordings)))
    samples = segment_length(growth, longest, train.sample_time, rough.time_scale)
    coarse = train.cut(samples)
    ground, X0, diverging = _ground(settings, rough, train, coarse, fastest)
    notes += diverging
    theta = np.zeros(ground.model.size)
    nominal = ground.fit_starts(coarse, theta, X0)
    first = null = _null(ground, coarse, nominal, rough.time_scale, start)
    whole = None
    if samples < longest:
        stable = growth * longest * train.sample_time <= UNSTABLE
        kept = stable and _on_whole(ground, train, first, coarse)
        if kept:
            null, nominal = kept, ground.fit_starts(train, theta, ground.starts(theta, train))
        else:
            whole = (train, test) if stable else None
            train, test = coarse, test.cut(samples)
            notes += (f"the simulator is integrating or unstable: {len(train.segments)} segments of about "
                      f"{samples * train.sample_time:.3g} s, each with free start states",)
    in_segments = train.segments.shape == coarse.segments.shape
    floor = _floor(ground, null, train, noise_floor, [g.cut(samples if in_segments else longest) for g in repeats])
    rms = _clipped_rms(null, train)
    sigma = np.sqrt(np.maximum(floor.level, 1e-5 * ground.scale) ** 2 + (0.1 * rms) ** 2)
    null = ground.fit(train, null.theta, null.X0, 20, sigma=sigma)
    null_coarse = null if in_segments else ground.fit(coarse, first.theta, first.X0, 20, sigma=sigma)
    X0t = ground.starts(null.theta, test)
    if plant.black_box is not None:  # outputs do not tell its start: come near it before errors are weighted finely
        X0t = ground.fit_starts(test, theta, X0t).X0
    nominal_test, null_test = (ground.fit_starts(test, values, X0t, sigma) for values in (theta, null.theta))
    length = float(np.max(np.diff(train.recordings)) * train.sample_time)
    structure = find_structure(plant, null.X[:, :plant.sizes[0]], train.U, train.Y, input_units, output_units,
                               train.sample_time, length, free)
    if not np.all(np.isfinite(null.cost)):
        warnings.warn("the nominal simulation could not be fitted", stacklevel=2)
    settings = replace(ground.model.settings, rates_shown=rates_shown(structure))
    problem = Problem(plant, settings, train, test, coarse, sigma, floor, structure, ground.ranges, nominal, null,
                      null_coarse, nominal_test, null_test, notes, whole)
    if plant.rhs is None:
        return problem
    steady = steadied(problem) if samples >= longest else problem
    return problem.kept() if steady is problem else steady  # where it parts, no start state is a lost one


def _ground(settings: Settings, rough: Structure, train: Dataset, coarse: Dataset,
            fastest: float) -> tuple[_Ground, np.ndarray, tuple[str, ...]]:
    """The model with as many substeps as it needs and the ranges of its states as the nominal simulation of the
    segments `coarse` visits them; its start states there, and a note where it diverges."""
    plant, model = settings.plant, Model(settings)
    theta = np.zeros(model.size)
    X0 = usable_starts(model, theta, coarse, rough.start_map)
    model = Model(replace(settings, substeps=substeps_of(model, theta, X0, coarse),
                          sliding=sliding_substeps(plant, fastest, train.sample_time)))
    Y, X = model.simulate(theta, X0, coarse)
    notes = _diverging(Y)
    ranges = np.minimum(np.maximum(np.quantile(np.abs(X[np.all(np.isfinite(X), axis=1)]), 0.99, axis=0), 1e-9), 1e6)
    ranges = np.maximum(ranges, plant.start_sizes)
    for k, i in enumerate(rough.output_state):
        if i >= 0:
            ranges[i] = np.max(np.abs(rough.shown.state_of(k, train.Y[:, k]))) + 1e-9
    return _Ground(model, np.std(train.Y, axis=0) + 1e-12, ranges, rough.start_map), X0, notes


def _on_whole(ground: _Ground, train: Dataset, first: Fit, coarse: Dataset) -> Fit | None:
    """The null on whole recordings, from its fit on segments and the better of two start states; None where that loses
    an output.

    Every start state that a segment brings can absorb part of what is to be explained, so recordings are judged
    whole unless the refitted simulation cannot be kept on them: an error above LOST of an output's spread.
    """
    starts = ground.starts(first.theta, train), first.X0[coarse.heads(train)]
    fit = min((ground.fit(train, first.theta, X0, 12, 1e-3) for X0 in starts), key=lambda f: f.cost)
    error = np.sqrt(np.mean(fit.residual(train) ** 2, axis=0))
    return fit if np.all(error < LOST * ground.scale) else None


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


def _floor(ground: _Ground, null: Fit, train: Dataset, given, repeats: Sequence[Dataset]) -> Floor:
    """The noise floor from what the null leaves, what is given, and recordings under one input."""
    left = [_left_of_repeats(ground, null.theta, group) for group in repeats]
    names = ground.model.settings.plant.output_names
    return estimate_floor(null.residual(train), train.Y, train.segments, names, given, left)


def _left_of_repeats(ground: _Ground, theta, group: Dataset) -> list[np.ndarray]:
    """What the simulator, refitted to them, leaves of recordings under one input: repeats that begin differently differ
    by more than noise. A black box begins as it does."""
    left = group.Y
    if ground.model.settings.plant.black_box is None:
        near = ground.fit_starts(group, theta, ground.starts(theta, group))
        sigma = _clipped_rms(near, group) + 1e-5 * ground.scale  # fine enough that data outweigh tolerances
        left = ground.fit(group, theta, near.X0, 20, sigma=sigma).residual(group)
    return [left[a:b] for a, b in group.recordings]


def _clipped_rms(fit: Fit, data: Dataset) -> np.ndarray:
    """Root mean square of what a fit leaves, (ny,), whatever runs away held at 1e6."""
    return np.sqrt(np.mean(np.clip(fit.residual(data), -1e6, 1e6) ** 2, axis=0))


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


def _null(ground: _Ground, train: Dataset, nominal: Fit, time_scale: float, start=None) -> Fit:
    """Short segments first, so that a wrong frequency does not strand the fit, then the whole recordings; and from
    `start` where it is given."""
    best = ground.fit(train, nominal.theta, nominal.X0, 25)
    whole = int(np.median(np.diff(train.segments[:, :2])))
    short = int(max(40, 6 * time_scale / train.sample_time))
    if short < whole / 3:
        cut = train.cut(short)
        starts = nominal.X[cut.segments[:, 0], :ground.model.nx]
        starts[~(np.abs(starts) <= 1e6)] = 0.0
        pre = ground.fit(cut, nominal.theta, starts, 15)
        best = min(best, ground.fit(train, pre.theta, nominal.X0, 25), key=lambda f: f.cost)
    if start is not None:
        there = ground.fit_starts(train, start, nominal.X0)
        best = min(best, ground.fit(train, start, there.X0, 25), key=lambda f: f.cost)
    return best
