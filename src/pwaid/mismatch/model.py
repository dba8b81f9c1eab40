"""One hypothesis: the user's plant with effects injected, simulated over a data set for given parameters."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property

import numpy as np

from pwaid.mismatch.blackbox_engine import simulate_black_box
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.effects.base import Effect, Place, scale_of, unit_of
from pwaid.mismatch.engine import idle, simulate_segments, simulate_variants, still
from pwaid.mismatch.plant import Plant
from pwaid.mismatch.slow_engine import Variant, simulate_columns

__all__ = ["Located", "Model", "Settings", "acting_order"]

LIMIT = 1e9
REACH = 3.0  # tolerances (on the logarithmic axis) that a nominal parameter may move: it may have been tuned bent
_CONTACTS = {"stiffness": 0.8, "contact_frequency": 0.8}


def _onward(segments) -> np.ndarray:
    """Which segments (n, 4) go on where the one before them ends, (n,)."""
    onward = np.zeros(len(segments), dtype=bool)
    onward[1:] = (segments[1:, 0] == segments[:-1, 1]) & (segments[1:, 2] == segments[:-1, 2])
    return onward


@dataclass(frozen=True)
class Located:
    """An effect at a place, with its parameters on the axis they are fitted on."""

    effect: Effect
    place: Place

    @property
    def label(self) -> str:
        notes = ", ".join(filter(None, (self.effect.variant, self.place.note)))
        return f"{self.effect.id} at {self.place.channel}{f' ({notes})' if notes else ''}"

    @property
    def key(self) -> tuple:
        """What tells two candidates apart, variants of a law included."""
        return self.effect.id, self.effect.law, self.place.channel, self.place.ii

    @property
    def size(self) -> int:
        return len(self.effect.quantities)

    @cached_property
    def scales(self) -> np.ndarray:
        return np.array([scale_of(q.size, self.place) for q in self.effect.quantities])

    @cached_property
    def origins(self) -> np.ndarray:
        return np.array([self.place.levels[q.size.removesuffix("_level")][0]
                         if q.size.endswith("_level") else 0.0
                         for q in self.effect.quantities])

    @cached_property
    def spans(self) -> np.ndarray:
        return np.array([self.place.levels[q.size.removesuffix("_level")][1]
                         if q.size.endswith("_level") else s
                         for q, s in zip(self.effect.quantities, self.scales, strict=True)])

    def units(self) -> list[str]:
        return [unit_of(q.size, self.place) for q in self.effect.quantities]

    def physical(self, z) -> np.ndarray:
        """Parameters in their units from the fitted axis (log of the multiple, or the multiple)."""
        return np.array([o + s * (np.exp(v) if q.log else v) for v, q, s, o in
                         zip(z, self.effect.quantities, self.spans, self.origins, strict=True)])

    def internal(self, multiples) -> np.ndarray:
        """The fitted axis from multiples of the scales."""
        return np.array([np.log(max(m, 1e-12)) if q.log else m
                         for m, q in zip(multiples, self.effect.quantities, strict=True)])

    def from_physical(self, values) -> np.ndarray:
        return self.internal([(v - o) / s for v, s, o in zip(values, self.spans, self.origins, strict=True)])

    def bounds(self, h: float) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on the fitted axis; contact stiffness stays within what the substep h resolves."""
        low, high = [], []
        for q, s in zip(self.effect.quantities, self.spans, strict=True):
            a, b = q.low, q.high
            if q.name == "stiffness" and self.effect.id in ("end_stop", "presliding_friction"):
                b = min(b, 0.5 / h**2 * self.place.scales.get("inertia", 1.0) / s)
            elif q.name == "contact_frequency":
                b = min(b, 0.7 / h / s)
            elif q.name == "yield_displacement":
                a = max(a, 1.5 * h * self.place.scales["speed"] / s)
            elif q.size == "time":
                a = max(a, 0.02 * h / s)
            a, b = min(a, 0.5 * b) if q.log else a, b
            low.append(np.log(a) if q.log else a)
            high.append(np.log(b) if q.log else b)
        return np.array(low), np.array(high)


@dataclass(frozen=True)
class Settings:
    """What every hypothesis of one problem shares."""

    plant: Plant
    partner: np.ndarray
    ratio: np.ndarray
    free: tuple[str, ...]
    tolerance: np.ndarray
    _: KW_ONLY
    substeps: int = 1
    sliding: int = 1  # substeps that dry friction needs at least
    first_order_hold: bool = False
    feedback: bool = False  # the recordings come from a closed loop
    rates_shown: tuple[tuple[int, int, float], ...] = ()  # output, state and gain of outputs that show a state's rate
    share: float = 0.5  # of the change of a speed within a step that the position sees
    empty: np.ndarray | None = None  # (nx,) lowest start states: levels at which a store holds nothing, -inf for others

    @property
    def averaged(self) -> bool:
        """Whether what laws do at both ends of a discrete simulator's step is averaged: where it steps exactly. Euler's
        methods hold every force over the step, and the laws' too."""
        return bool(self.plant.dt) and self.share == 0.5

    @property
    def carried(self) -> list[tuple[int, int, float]]:
        """Of a discrete simulator: position, speed, and what the one moves per change of the other within a step, per
        second."""
        step = self.share * (self.plant.dt or 0.0)
        return [(i, int(j), step * float(self.ratio[i])) for i, j in enumerate(self.partner) if step and j >= 0]


def acting_order(located) -> list[int]:
    """The order in which laws act: those at an input before forces, which may enter through the same input, and those
    that change what a force accelerates after the forces; as found otherwise."""
    return sorted(range(len(located)), key=lambda k: (located[k].effect.reshapes, located[k].place.kind != "input"))


class Model:
    """The plant with `located` effects (at most three), ready to simulate.

    `acting` are the effects in the order in which they act; `kernels`, `II`, `proximal` and the rows of Q follow it,
    parameters follow `located`.
    """

    def __init__(self, settings: Settings, located: tuple[Located, ...] = (), substeps: int | None = None):
        self.settings, self.located = settings, tuple(located)
        plant = settings.plant
        self.nx = plant.sizes[0]
        self.substeps = substeps or max(
            [settings.substeps] + [max(4, settings.substeps) for e in located if e.effect.id in
                                   ("end_stop", "backlash", "presliding_friction", "overflow")]
            + [max(2, settings.substeps, settings.sliding) for e in located if e.effect.proximal])
        self.positions = np.array([list(plant.parameters).index(n) for n in settings.free], dtype=int)
        self.np, self.nz = len(self.positions), sum(e.size for e in self.located)
        self.extra = sum(e.effect.extra_states for e in self.located)
        self.order = acting_order(self.located)
        self.acting = tuple(self.located[k] for k in self.order)
        self.kernels = [e.effect.compiled() for e in self.acting] + [idle] * (3 - len(self.acting))
        rows, offset = [], self.nx
        for e in self.acting:
            ii = list(e.place.ii)
            ii[0] = offset
            offset += e.effect.extra_states
            rows.append(ii)
        self.II = np.array(rows + [[0] * 12] * (3 - len(rows)), dtype=np.int64)
        self.stores = [(int(self.II[k, 0]), int(self.II[k, 4]) if e.effect.start == "stored" else -1)
                       for k, e in enumerate(self.acting) if e.effect.start in ("stored", "free")]
        self.chained = len(rows) > 1 and min(rows[0][8], rows[1][8]) >= 0
        self.width = max([len(e.effect.quantities) + len(e.place.constants) for e in self.acting] + [1])
        self.proximal = np.array([int(e.effect.proximal) for e in self.acting] + [0] * (3 - len(self.acting)))
        self.shown, self.gain = np.full(len(plant.output_names), -1, dtype=np.int64), np.zeros(len(plant.output_names))
        for k, state, gain in settings.rates_shown:
            self.shown[k], self.gain[k] = state, gain
        delayed = [int(e.place.ii[8]) for e in self.located if e.effect.delays]
        self.delayed = delayed[0] if delayed else -1

    @property
    def size(self) -> int:
        """Number of global parameters: free nominal ones, then those of the effects."""
        return self.np + self.nz

    def parts(self, theta) -> list[np.ndarray]:
        """The effects' parameters in their units, one array each."""
        out, k = [], self.np
        for e in self.located:
            out.append(e.physical(theta[k:k + e.size]))
            k += e.size
        return out

    def parameters(self, theta) -> np.ndarray:
        """All plant parameters by position."""
        p = self.settings.plant.vector()
        for k, i in enumerate(self.positions):
            p[i] *= np.exp(theta[k])
        return p

    def bounds(self, sample_time: float) -> tuple[np.ndarray, np.ndarray]:
        wide = np.log1p(self.settings.tolerance) * REACH
        low, high = [-wide], [wide]
        for e in self.located:
            a, b = e.bounds(sample_time / self.substeps)
            low.append(a)
            high.append(b)
        return np.concatenate(low), np.concatenate(high)

    def simulate(self, theta, X0, data: Dataset) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (N, ny) and states (N, nx + extra); LIMIT fills what ran away."""
        return self.simulate_with(self.parameters(theta), self.parts(theta), X0, data)

    def simulate_with(self, p, parts, X0, data: Dataset):
        """The same for plant parameters p and the effects' parameters in their units."""
        Q, delay = self.laws(parts, data.U.shape[1])
        if self.settings.plant.black_box is not None:
            return simulate_black_box(self, p, Q, delay, X0, data, LIMIT)
        Y = np.empty((len(data.U), data.Y.shape[1]))
        X = np.empty((len(data.U), self.nx + self.extra))
        self.run(p, Q, delay, self.start(X0, data.U, data.segments), data.segments, data.U, data.sample_time, X, Y)
        return Y, X

    def laws(self, parts, n_inputs: int) -> tuple[np.ndarray, np.ndarray]:
        """Parameters and constants of the effects (3, width), and the delay of every input in seconds."""
        Q, delay = np.zeros((3, self.width)), np.zeros(n_inputs)
        for k, (e, values) in enumerate(zip(self.acting, [parts[i] for i in self.order], strict=True)):
            row = np.concatenate([values, e.place.constants])
            Q[k, :row.size] = row
            if e.effect.delays:
                delay[e.place.ii[8]] += values[0]
        return Q, delay

    def opened(self, X0) -> np.ndarray:
        """Start states (n_segments, nx + hidden ones): of a hidden store, unless they hold it, that of the plant's
        store which it hangs on; of a hidden strain, none."""
        X0 = self.filled(np.asarray(X0, dtype=float))
        if X0.shape[1] == self.nx + len(self.stores):
            return X0
        return np.column_stack([X0[:, :self.nx], *(X0[:, i] if i >= 0 else np.zeros(len(X0)) for _, i in self.stores)])

    def filled(self, X0) -> np.ndarray:
        """Start states with no store less than empty: a fit would hide an error of the inflow there."""
        if self.settings.empty is None:
            return X0
        lowest = np.concatenate([self.settings.empty, np.full(X0.shape[1] - self.nx, -np.inf)])
        return np.maximum(X0, lowest)

    def start_ranges(self, ranges) -> np.ndarray:
        """Magnitudes of the start states, those of hidden ones behind the plant's (nx,); a strain yields at one."""
        return np.concatenate([ranges[:self.nx], [ranges[i] if i >= 0 else 1.0 for _, i in self.stores]])

    def start(self, X0, U, segments) -> np.ndarray:
        """(n_segments, nx + extra) start states, the effects' memory included.

        What an input has been through does not depend on the state: NaN where its memory goes on from the segment
        before.
        """
        start = np.zeros((len(X0), self.nx + self.extra))
        X0 = self.opened(X0)
        start[:, :self.nx] = X0[:, :self.nx]
        start[:, [o for o, _ in self.stores]] = X0[:, self.nx:]
        for k, e in enumerate(self.acting):
            o = self.II[k, 0]
            if e.effect.start == "input":
                first = np.where(_onward(segments), np.nan, U[segments[:, 0], self.II[k, 8]])
                start[:, o:o + e.effect.extra_states] = first[:, None]
        return start

    def run(self, p, Q, delay, start, segments, U, sample_time: float, X, Y) -> None:
        """Simulate every segment from its start (n_segments, nx + extra) into X and Y."""
        plant = self.settings.plant
        if plant.rhs is None:
            variant = self._remembered(Variant(p, Q, delay, start), segments, U, sample_time)
            found = simulate_columns(self, [variant], segments, U, sample_time, LIMIT)
            for a, b in segments[:, :2]:
                X[a:b], Y[a:b] = found[0][0, a:b], found[1][0, a:b]
            return
        self._compiled(simulate_segments, start, segments, U, delay, sample_time, p, Q, X, Y)

    def _remembered(self, variant: Variant, segments, U, sample_time: float) -> Variant:
        """The variant with the memories that go on from a segment to the next, for segments that run side by side."""
        if not np.isnan(variant.start).any():
            return variant
        first = np.flatnonzero(~_onward(segments))
        joined = segments[first].copy()
        joined[:, 1] = segments[np.append(first[1:] - 1, len(segments) - 1), 1]
        start, X = variant.start[first], np.zeros((len(U), self.nx + self.extra))
        start[:, :self.nx] = 0.0
        self._compiled(simulate_segments, start, joined, U, variant.delay, sample_time, variant.p, variant.Q, X,
                       np.empty((len(U), len(self.settings.plant.output_names))))
        return replace(variant, start=np.where(np.isnan(variant.start), X[segments[:, 0]], variant.start))

    def _compiled(self, simulate, start, segments, U, delay, sample_time: float, p, Q, *filled) -> None:
        """Call one of the engine's functions, which fill X and Y, or the Y of several variants; states rest where the
        right-hand side is not compiled."""
        plant, s = self.settings.plant, self.settings
        simulate(plant.rhs or still, plant.out or still, *self.kernels, len(self.located), self.nx, start, segments, U,
                 delay, sample_time, 1 if plant.dt else self.substeps, float(s.first_order_hold),
                 int(plant.dt > 0) + s.averaged, plant.full(p), self.II, Q, self.proximal, s.partner,
                 2 * s.share * s.ratio, self.shown, self.gain, *filled, LIMIT)

    def simulate_many(self, asked, data: Dataset) -> list[np.ndarray]:
        """Outputs (N, ny) for several (theta, X0), in one call."""
        plant = self.settings.plant
        if plant.black_box is not None or not asked:
            return [self.simulate(theta, X0, data)[0] for theta, X0 in asked]
        variants = []
        for theta, X0 in asked:
            Q, delay = self.laws(self.parts(theta), data.U.shape[1])
            variants.append(Variant(self.parameters(theta), Q, delay, self.start(X0, data.U, data.segments)))
        if plant.rhs is None:
            variants = [self._remembered(v, data.segments, data.U, data.sample_time) for v in variants]
            return list(simulate_columns(self, variants, data.segments, data.U, data.sample_time, LIMIT)[1])
        Y = np.empty((len(asked), *data.Y.shape))
        starts, delays, ps, Qs = (np.array([getattr(v, name) for v in variants]) for name in
                                  ("start", "delay", "p", "Q"))
        self._compiled(simulate_variants, starts, data.segments, data.U, delays, data.sample_time, ps, Qs, Y)
        return list(Y)
