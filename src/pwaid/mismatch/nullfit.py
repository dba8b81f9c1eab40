"""The null hypothesis: nothing is missing, only nominal parameters and start states are off."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pwaid.errors import InputError
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit, fit_model, fit_starts
from pwaid.mismatch.floor import Floor, estimate_floor, white_level
from pwaid.mismatch.model import LIMIT, Model, Settings
from pwaid.mismatch.plant import Plant
from pwaid.mismatch.probing import find_structure
from pwaid.mismatch.structure import Structure

__all__ = ["Problem", "first_states", "prepare"]

DEFAULT_TOLERANCE = 0.3


@dataclass(frozen=True)
class Problem:
    """Everything the hypotheses share: data, weights, floor, structure, and the nominal and null fits."""

    plant: Plant
    settings: Settings
    train: Dataset
    test: Dataset
    sigma: np.ndarray
    floor: Floor
    structure: Structure
    ranges: np.ndarray
    nominal: Fit
    null: Fit
    nominal_test: Fit
    null_test: Fit
    notes: tuple[str, ...] = ()

    def heldout(self, fit: Fit, start: np.ndarray | None = None) -> Fit:
        """The fitted model on the held-out recordings, its start states fitted there."""
        X0 = self.null_test.X0 if start is None else start
        fitted = fit_starts(fit.model, self.test, self.sigma, fit.theta, X0, self.ranges)
        s = self.structure  # the null may have bent its start states to absorb the effect: try the measured ones
        measured = first_states(self.plant, (s.output_state, s.partner, s.ratio, s.state_units), self.test)
        other = fit_starts(fit.model, self.test, self.sigma, fit.theta, measured, self.ranges)
        better = self._by_segment(other) < self._by_segment(fitted)
        if not better.any():
            return fitted
        mixed = np.where(better[:, None], other.X0, fitted.X0)
        return fit_starts(fit.model, self.test, self.sigma, fit.theta, mixed, self.ranges)

    def _by_segment(self, fit: Fit) -> np.ndarray:
        """Weighted sum of squares of every held-out segment; infinite where the simulation diverged."""
        e = np.sum(((self.test.Y - fit.Y) / self.sigma) ** 2, axis=1)
        sums = np.array([np.sum(e[a:b]) for a, b in self.test.segments[:, :2]])
        return np.where(np.isfinite(sums), sums, np.inf)


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
        free = [n for n, v in plant.parameters.items() if v not in (0.0, 1.0, -1.0)] if plant.linear else list(
            plant.parameters)
        if plant.linear and len(free) > 12:
            free = [n for n in free if n[0] in "BD"]
    unknown = [n for n in free if n not in plant.parameters]
    if unknown:
        raise InputError(f"free parameter {unknown[0]!r} is not a parameter of the simulator; it has "
                         f"{', '.join(plant.parameters) or 'none'}")
    zero = [n for n in free if plant.parameters[n] == 0.0]
    notes = tuple(f"parameter {n} is 0 in the simulator and has no relative tolerance: kept" for n in zero)
    return tuple(n for n in free if n not in zero), notes


def first_states(plant: Plant, structure_map, data: Dataset) -> np.ndarray:
    """Start states from the outputs: measured states from the first samples, speeds from their slope."""
    output_state, partner, ratio, units = structure_map
    nx = plant.sizes[0]
    X0 = np.zeros((len(data.segments), nx))
    for g, (a, b, _, _) in enumerate(data.segments):
        m = int(min(b - a, 12))
        tt = np.arange(m) * data.sample_time
        for k, i in enumerate(output_state):
            if i < 0:
                continue
            slope, level = np.polyfit(tt, data.Y[a:a + m, k], 1) if m > 2 else (0.0, data.Y[a, k])
            X0[g, i] = level
            j = partner[i]
            if j >= 0 and j not in output_state:
                X0[g, j] = slope / ratio[i]
        for i in range(nx):  # an unmeasured position starts with the first measured one of its unit
            if partner[i] >= 0 and i not in output_state:
                alike = [k for k, s in enumerate(output_state) if s >= 0 and partner[s] >= 0 and units[s] == units[i]]
                X0[g, i] = data.Y[a, alike[0]] if alike else 0.0
    return X0


def _positive_start(plant, X0, data):
    """Stores that start at zero sit at a corner of a square root: lift them to the mean output."""
    lifted = X0.copy()
    for i in range(X0.shape[1]):
        if np.all(lifted[:, i] == 0.0):
            lifted[:, i] = np.mean(np.abs(data.Y[0])) if data.Y.size else 0.0
    return lifted


def _growth(plant: Plant, states, inputs) -> float:
    """Largest real part of the linearisation's eigenvalues (per second), median over visited points."""
    found = []
    rng = np.random.default_rng(0)
    for k in rng.integers(0, len(states), 8):
        x, u = states[k], inputs[k]
        n = len(x)
        J = np.empty((n, n))
        for i in range(n):
            d = 1e-5 * max(np.max(np.abs(states[:, i])), 1e-6)
            up, dn = x.copy(), x.copy()
            up[i] += d
            dn[i] -= d
            J[:, i] = (plant.derivative(up, u) - plant.derivative(dn, u)) / (2 * d)
        if not np.all(np.isfinite(J)):
            continue
        eigenvalues = np.linalg.eigvals(J)
        if plant.dt:
            eigenvalues = np.log(np.maximum(np.abs(eigenvalues), 1e-12)) / plant.dt
        found.append(np.max(eigenvalues.real))
    return float(np.median(found)) if found else 0.0


def _substeps(model: Model, theta, X0, data: Dataset) -> int:
    """Substeps per sample for which halving the step changes the outputs by less than the noise."""
    if model.settings.plant.dt:
        return 1
    span = np.ptp(data.Y, axis=0) + 1e-12
    noise = np.array([white_level(data.Y[:, k], 4) for k in range(data.Y.shape[1])])
    allowed = np.clip(0.05 * noise, 2e-5 * span, 5e-4 * span)
    short = replace(data, segments=data.segments.copy())
    S, previous = 1, None
    while S <= 32:
        Y, _ = Model(model.settings, model.located, S).simulate(theta, X0, short)
        same = previous is not None and np.all(np.sqrt(np.mean((Y - previous) ** 2, axis=0)) < allowed)
        if same and np.all(np.abs(Y) < LIMIT):
            return S // 2
        previous = Y
        S *= 2
    return 8


def segment_length(plant: Plant, growth: float, samples: int, sample_time: float, time_scale: float) -> int:
    """Samples per segment: whole recordings when stable, a few time constants otherwise."""
    length = samples * sample_time
    if growth * length > 4.0:
        return int(max(30, 2.5 / growth / sample_time))
    if growth * length > -0.7:  # integrating: errors pile up over the whole recording
        return int(max(200, min(samples, 12 * time_scale / sample_time)))
    return samples


def prepare(plant: Plant, train: Dataset, test: Dataset, input_units, output_units, free=None, tolerance=None,
            noise_floor=None, repeats=(), first_order_hold: bool = False) -> Problem:
    """Refit the nominal simulator and gather what the hypotheses need.

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
                        1, first_order_hold)
    rough = _rough_structure(plant, train, input_units, output_units, free)
    settings = replace(settings, partner=rough.partner, ratio=rough.ratio)
    model = Model(settings)
    mapping = (rough.output_state, rough.partner, rough.ratio, rough.state_units)
    theta = np.zeros(model.size)
    scale = np.std(train.Y, axis=0) + 1e-12

    growth = _growth(plant, _state_cloud(plant, rough, train), train.U)
    samples = segment_length(plant, growth, int(np.max(np.diff(train.recordings))), train.sample_time,
                             rough.time_scale)
    train, test = train.cut(samples), test.cut(samples)
    if samples < np.max(np.diff(train.recordings)):
        notes += (f"the simulator is integrating or unstable: {len(train.segments)} segments of about "
                  f"{samples * train.sample_time:.3g} s, each with free start states",)
    X0 = first_states(plant, mapping, train)
    if not plant.linear:
        X0 = _usable_start(model, theta, X0, train)
    substeps = _substeps(model, theta, X0, train)
    settings = replace(settings, substeps=substeps)
    model = Model(settings)
    Y, X = model.simulate(theta, X0, train)
    if not np.all(np.abs(Y) < LIMIT):
        share = np.mean(np.any(np.abs(Y) >= LIMIT, axis=1))
        notes += (f"the nominal simulation diverges on {100 * share:.0f} % of the samples before refitting",)
        if share > 0.9:
            raise InputError("the simulation diverges from every start state; check signs and units of the simulator")
    ranges = np.maximum(np.quantile(np.abs(X[np.all(np.isfinite(X), axis=1)]), 0.99, axis=0), 1e-9)
    ranges = np.minimum(ranges, 1e6)
    for k, i in enumerate(rough.output_state):
        if i >= 0:
            ranges[i] = np.max(np.abs(train.Y[:, k])) + 1e-9
    nominal = fit_starts(model, train, scale, theta, X0, ranges, 12)
    null = _null(model, train, scale, nominal, ranges, rough.time_scale)
    residual = null.residual(train)
    floor = estimate_floor(residual, train.Y, train.segments, plant.output_names, noise_floor, repeats)
    rms = np.sqrt(np.mean(np.clip(residual, -1e6, 1e6) ** 2, axis=0))
    sigma = np.sqrt(np.maximum(floor.level, 1e-5 * scale) ** 2 + (0.1 * rms) ** 2)
    null = fit_model(model, train, sigma, null.theta, null.X0, ranges, 20)
    X0t = first_states(plant, mapping, test)
    if not plant.linear:
        X0t = _usable_start(model, null.theta, X0t, test)
    nominal_test = fit_starts(model, test, sigma, theta, X0t, ranges, 12)
    null_test = fit_starts(model, test, sigma, null.theta, X0t, ranges, 12)
    length = float(np.max(np.diff(train.recordings)) * train.sample_time)
    structure = find_structure(plant, null.X[:, :plant.sizes[0]], train.U, train.Y, input_units, output_units,
                               train.sample_time, length, free)
    if not np.all(np.isfinite(null.cost)):
        warnings.warn("the nominal simulation could not be fitted", stacklevel=2)
    return Problem(plant, settings, train, test, sigma, floor, structure, ranges, nominal, null, nominal_test,
                   null_test, notes)


def _usable_start(model, theta, X0, data):
    Y, _ = model.simulate(theta, X0, data)
    if np.all(np.isfinite(Y)) and np.all(np.abs(Y) < LIMIT):
        return X0
    lifted = _positive_start(model.settings.plant, X0, data)
    return lifted


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
            states[:, i] = train.Y[:, k]
    return states


def _null(model, train, scale, nominal, ranges, time_scale):
    """Short segments first, so that a wrong frequency does not strand the fit, then the whole recordings."""
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
        if other.cost < best.cost:
            best = other
    return best
