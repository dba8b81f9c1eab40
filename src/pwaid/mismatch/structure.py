"""What the simulator's equations mean, and where the catalogue's effects may enter them.

`pwaid.mismatch.probing` finds the roles of states, inputs and outputs; the methods here turn them
into places: every speed, every position, every command, every sensor, every store.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np

from pwaid.mismatch.effects.base import Place
from pwaid.mismatch.inertia import shown_inertia
from pwaid.mismatch.plant import Plant
from pwaid.mismatch.units import KNOWN, factor_of, parse_unit

__all__ = ["SIDES", "OutputMap", "Structure", "drawn_point", "on_line", "side_span", "two_terms", "weights_of"]


SIDES = ("both sides", "upper", "lower")  # of a range: 0, 1 and -1


def on_line(x, y) -> tuple[float, float] | None:
    """Gain and offset where y = gain * x + offset holds at all samples (n,); None where it does not."""
    if not (np.ptp(x) > 0 and np.ptp(y) > 0):
        return None
    gain = float((y - y.mean()) @ (x - x.mean()) / ((x - x.mean()) @ (x - x.mean())))
    offset = float(y.mean() - gain * x.mean())
    offset = 0.0 if abs(offset) < 1e-9 * np.max(np.abs(y)) else offset
    holds = np.allclose(y, gain * x + offset, rtol=1e-9, atol=1e-12 * np.max(np.abs(y)))
    return (gain, offset) if holds else None


def weights_of(columns, y, trifle: float = 1e-12) -> np.ndarray | None:
    """The weights with which columns (n, k) add up to y at all samples, but for a trifle of its largest; None where
    they do not."""
    weights = np.linalg.lstsq(columns, y, rcond=None)[0]
    holds = np.allclose(columns @ weights, y, rtol=1e-9, atol=trifle * np.max(np.abs(y)))
    return weights if holds else None


def two_terms(columns, rate) -> tuple[np.ndarray, np.ndarray] | None:
    """The two columns, and their weights, whose sum a rate (n,) is at all samples; None where it is not of two."""
    weights = weights_of(columns, rate)
    if weights is None:
        return None
    size = np.max(np.abs(weights * columns), axis=0)
    pair = np.flatnonzero(size > 1e-9 * np.max(size))
    return (pair, weights[pair]) if len(pair) == 2 else None


def side_span(side: int, low: float, high: float) -> tuple[float, float]:
    """Origin and span of the levels of a limit on a range: on both sides of zero (0), above (1) or below (-1)."""
    return {0: (0.0, float(max(abs(low), abs(high), 1e-12))), 1: (low, high - low), -1: (high, low - high)}[side]


def drawn_point(rng, states, input_rms, inputs) -> tuple[np.ndarray, np.ndarray]:
    """A state and an input drawn within ranges (low, high) of both: a load may never be negative."""
    low, high = states
    x, u = low + (high - low) * rng.uniform(size=len(low)), input_rms * rng.normal(size=len(input_rms))
    return x, np.clip(u, *inputs)


@dataclass(frozen=True)
class OutputMap:
    """The state that each output shows alone, y = gain x + offset; -1 where it shows none."""

    state: tuple[int, ...]
    gain: tuple[float, ...]
    offset: tuple[float, ...]

    def state_of(self, k: int, y) -> np.ndarray:
        """The state behind readings y of output k."""
        return (y - self.offset[k]) / self.gain[k]


@dataclass(frozen=True)
class Structure:
    """Roles of states, inputs and outputs, with the ranges met in the recordings; `visited` are some of the states met,
    (n, nx).

    `share` is how much of the change of a speed within a step the position sees: half, and in discrete simulators as
    they do it themselves, 0 or 1 by Euler's methods, which hold every force over the step. `empty` (nx,) are levels
    below which a store holds nothing, -inf for other states.
    """

    plant: Plant
    kinds: tuple[str, ...]
    partner: np.ndarray
    ratio: np.ndarray
    share: float
    entry: dict[int, tuple[int, int, int]]
    force_scale: dict[int, float]
    state_units: tuple[dict, ...]
    force_units: dict[int, dict]
    inertia_units: dict[int, dict]
    low: np.ndarray
    high: np.ndarray
    input_rms: np.ndarray
    input_low: np.ndarray
    input_high: np.ndarray
    input_units: tuple[dict, ...]
    output_low: np.ndarray
    output_high: np.ndarray
    output_units: tuple[dict, ...]
    shown: OutputMap
    time_scale: float
    length: float
    free: tuple[str, ...]
    mobility: dict[int, float] = field(default_factory=dict)
    hook_scale: tuple[float, ...] = ()
    visited: np.ndarray = field(default_factory=lambda: np.zeros((1, 0)), repr=False)
    empty: np.ndarray | None = None

    # ------------------------------------------------------------------ helpers
    @property
    def input_max(self) -> np.ndarray:
        """Largest magnitude of each input."""
        return np.maximum(np.abs(self.input_low), np.abs(self.input_high))

    @property
    def output_state(self) -> tuple[int, ...]:
        """The state that each output shows, -1 where it shows none alone."""
        return self.shown.state

    @property
    def start_map(self) -> tuple:
        """What `first_states` needs: states of the outputs, speeds of the positions, their ratios, units."""
        return self.shown, self.partner, self.ratio, self.state_units

    def position_of(self, v: int) -> int:
        found = [i for i in range(len(self.partner)) if self.partner[i] == v]
        return found[0] if found else -1

    def reach(self, i: int) -> float:
        if i < 0:
            return 1.0
        return float(max(abs(self.low[i]), abs(self.high[i]), 1e-12))

    def velocities(self) -> list[int]:
        return [i for i, k in enumerate(self.kinds) if k == "velocity"]

    def place(self, kind, signal, variables, ii, v=-1, x=-1, k=-1, j=-1, **more) -> Place:
        """A place with the scales and units of its speed v, position x, output k and input j (-1: none); `more` adds
        to them."""
        scales = {"time": self.time_scale, "rate": 1 / self.time_scale, "length": self.length, "kelvin": 1.0}
        units = {"time": {"s": 1}, "rate": {"s": -1}, "length": {"s": 1}, "kelvin": {"K": 1}}
        if v >= 0:
            scales |= {"force": self.force_scale.get(v, 1.0), "speed": self.reach(v)}
            units |= {"force": self.force_units.get(v, {}), "speed": self.state_units[v]}
            units["inertia"] = self.inertia_units.get(v, {})
            scales["inertia"] = 1.0 / self.mobility.get(v, 1.0)
        if x >= 0:
            scales["position"], units["position"] = self.reach(x), self.state_units[x]
        if k >= 0:
            scales["output"] = float(max(abs(self.output_low[k]), abs(self.output_high[k]), 1e-12))
            units["output"] = self.output_units[k]
        if j >= 0:
            scales["input"], units["input"] = float(self.input_max[j]) or 1.0, self.input_units[j]
        return Place(kind, signal, tuple(variables), tuple(ii), scales | more.pop("scales", {}),
                     units | more.pop("units", {}), **more)

    def force_ii(self, v: int) -> list[int]:
        """The integers of a place where a force on speed v enters."""
        mode, target, inertia = self.entry[v]
        ii = [0, mode, target, inertia, v, self.position_of(v), -1, -1, -1, -1, 0, 0]
        return ii

    # ------------------------------------------------------------------ places for the catalogue
    def moving(self, with_position: bool = False) -> list[Place]:
        """Every speed a force can act on."""
        places = []
        for v in self.velocities():
            ii, x = self.force_ii(v), self.position_of(v)
            if x < 0 and with_position:
                x = v  # the stroke is unknown; scale by speed times the time scale
            names, more = [self.plant.state_names[v]], {}
            if with_position and self.position_of(v) < 0:
                more = {"scales": {"position": self.reach(v) * self.time_scale},
                        "units": {"position": {**self.state_units[v],
                                               "s": self.state_units[v].get("s", 0) + 1}}}
            places.append(self.place("state", self.plant.state_names[v], names, ii, v=v, x=x, **more))
        return places

    def loaded(self) -> list[Place]:
        """Every speed a force can act on, with every input that may press on what slides, its own drive first."""
        places = []
        for v in self.velocities():
            mode, target, _ = self.entry[v]
            for j in sorted(range(len(self.input_rms)), key=lambda j: mode == 1 or j != target):
                ii, names = self.force_ii(v), [self.plant.state_names[v], self.plant.input_names[j]]
                ii[8] = j
                note = f"load: {names[1]}" if len(self.input_rms) > 1 else ""
                places.append(self.place("state", names[0], names, ii, v=v, x=self.position_of(v), j=j, note=note))
        return places

    def positions(self, sides: bool = False) -> list[Place]:
        """Every position with a speed that a force can act on; one per side for stops."""
        places = []
        for v in self.velocities():
            x = self.position_of(v)
            if x < 0:
                continue
            for side in ((0, 1, -1) if sides else (0,)):
                ii = self.force_ii(v)
                ii[10] = side
                span = side_span(side, self.low[x], self.high[x])
                name = self.plant.state_names[x]
                places.append(self.place("state", self.plant.state_names[v], [name], ii, v=v, x=x,
                                         levels={"position": span},
                                         note=SIDES[side] if sides else ""))
        return places

    def angles(self) -> list[Place]:
        """Positions measured as angles; the constant turns them into radians."""
        places = []
        for place in self.positions():
            symbols = self.state_units[place.ii[5]]
            if any(KNOWN[s] == "length" for s in symbols):
                continue
            constant = next((factor_of(s) for s in symbols if KNOWN[s] == "angle"), 1.0)
            if self.reach(place.ii[5]) * constant > 0.05:
                places.append(self._with_constants(place, (constant,)))
        return places

    @staticmethod
    def _with_constants(place: Place, constants) -> Place:
        return Place(place.kind, place.signal, place.variables, place.ii, place.scales, place.units,
                     tuple(constants), place.levels, place.note)

    def points(self, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """States and inputs within the ranges met."""
        rng = np.random.default_rng(1)
        return [drawn_point(rng, (self.low, self.high), self.input_rms, (self.input_low, self.input_high))
                for _ in range(count)]

    def slope(self, i, j, x, u, p=None):
        """Derivative of the rate of state i by state j at one point, with parameters p or the nominal ones."""
        d = max(self.reach(j), 1e-9) * 1e-4
        up, dn = x.copy(), x.copy()
        up[j] += d
        dn[j] -= d
        return (self.plant.derivative(up, u, p)[i] - self.plant.derivative(dn, u, p)[i]) / (2 * d)

    def inertias(self) -> list[Place]:
        places = []
        for v in self.velocities():
            ii = self.force_ii(v)
            places.append(self.place("state", self.plant.state_names[v],
                                     [f"d{self.plant.state_names[v]}/dt"], ii,
                                     v=v, constants=(self.mobility.get(v, 1.0),)))
        return places

    def velocity_products(self, stretching: bool = False) -> list[Place]:
        """Products of two speeds, times 1, sin or cos of an angle; stretching: times a length. Only with a second
        axis."""
        places = []
        vs = self.velocities()
        if len(vs) < 2 or "position" not in self.kinds:  # no position, no inertia that varies with one
            return places
        angular = {place.ii[5]: place.constants[0] for place in self.angles()}
        lengths = [p.ii[5] for p in self.positions() if any(KNOWN[s] == "length" for s in self.state_units[p.ii[5]])]
        trigs = [(3, x, 1.0) for x in lengths] if stretching else [
            (0, -1, 1.0), *((k, x, factor) for x, factor in angular.items() for k in (1, 2))]
        names = self.plant.state_names
        for v in vs:
            for a, b in itertools.combinations_with_replacement(vs, 2):
                if a == v and b == v:
                    continue
                for variant, x, factor in trigs:
                    ii = self.force_ii(v)
                    ii[4], ii[6], ii[9], ii[10] = a, b, x, variant
                    times = [("", "sin({})", "cos({})", "{}")[variant].format(names[x])] if x >= 0 else []
                    both = {s: self.state_units[a].get(s, 0) + self.state_units[b].get(s, 0)
                            for s in {*self.state_units[a], *self.state_units[b]}}
                    places.append(self.place("state", names[v], [names[a], names[b], *times], ii, v=v, x=x,
                                             scales={"speeds": self.reach(a) * self.reach(b)},
                                             units={"speeds": both}, constants=(factor,)))
        return places

    def varying_inertias(self) -> list[Place]:
        """Every position on which alone the inertia that the simulator shows depends; the matrix as constants."""
        places = []
        for shown in shown_inertia(self):
            ii = self.force_ii(shown.speeds[shown.moving])
            ii[5], ii[10] = shown.position, int(not shown.angular)
            ii[6:9] = [k for k, _, _ in shown.changes] + [-1] * (3 - len(shown.changes))
            nominal = [value for _, value, _ in shown.changes] + [1.0] * (3 - len(shown.changes))
            names = [self.plant.state_names[i] for i in (shown.position, *shown.speeds)]
            constants = (len(shown.speeds), shown.moving, shown.turn, shown.ratio, *nominal, *shown.speeds,
                         *shown.table.ravel(), *(w for _, _, change in shown.changes for w in change.ravel()))
            places.append(self.place("state", self.plant.state_names[shown.speeds[shown.moving]], names, ii,
                                     constants=tuple(float(c) for c in constants)))
        return places

    def inputs(self, delays: bool = False, signs: bool = False) -> list[Place]:
        """Every command channel; signs: once for its positive and once for its negative values."""
        return [self.place("input", name, [name], [0, 0, j, -1, -1, -1, -1, -1, j, -1, sign, 0], j=j,
                           note={1: "positive", -1: "negative"}.get(sign, ""))
                for j, name in enumerate(self.plant.input_names) for sign in ((1, -1) if signs else (0,))]

    def loads(self) -> list[Place]:
        """Constant forces: at every speed, at inputs that drive no speed, and at a black box's force hook."""
        places = [self.place("state", self.plant.state_names[v], [], self.force_ii(v), v=v)
                  for v in self.velocities()]
        taken = {self.entry[v][1] for v in self.velocities() if self.entry[v][0] != 1}
        driven = len(self.velocities()) and all(self.kinds[i] in ("velocity", "position")
                                                for i in range(len(self.kinds)))
        for j, name in enumerate(self.plant.input_names):
            if j in taken or (driven and len(self.plant.input_names) == 1):
                continue
            ii = [0, 0, j, -1, -1, -1, -1, -1, j, -1, 0, 0]
            places.append(self.place("input", name, [], ii, j=j,
                                     scales={"force": float(self.input_max[j]) or 1.0},
                                     units={"force": self.input_units[j]}))
        nu = len(self.plant.input_names)
        for j, (name, unit) in enumerate(zip(self.plant.force_names, self.plant.force_units, strict=True)):
            places.append(self.place("force", name, [], [0, 0, nu + j, -1, -1, -1, -1, -1, -1, -1, 0, 0],
                                     scales={"force": self.hook_scale[j]}, units={"force": parse_unit(unit)}))
        return places

    def outputs(self, sides: bool = False, variant: int = 0, unsigned: bool = False) -> list[Place]:
        """Every sensor channel; one per side for limits; unsigned: only those that hardly show negative values."""
        places = []
        for k, name in enumerate(self.plant.output_names):
            lo, hi = float(self.output_low[k]), float(self.output_high[k])
            if unsigned and lo < -0.1 * hi:
                continue
            options = [(variant, (0.0, max(abs(lo), abs(hi), 1e-12)))]
            if sides:
                options = [(side, side_span(side, lo, hi)) for side in ((0, 1, -1) if lo < 0 < hi else (1, -1))]
            for side, span in options:
                ii = [0, 0, 0, -1, -1, -1, -1, k, -1, -1, side, 0]
                places.append(self.place("output", name, [name], ii, k=k, levels={"output": span},
                                         note=SIDES[side] if sides else ""))
        return places

    def drifting_parameters(self) -> list[Place]:
        if self.plant.black_box is not None and not self.plant.gains:
            return []  # its parameters hold for a whole call
        if self.plant.entries is not None:
            return []  # its matrices are made before a simulation
        names = list(self.plant.parameters)
        return [self.place("parameter", name, ["t"],
                           [0, 0, 0, -1, -1, -1, -1, -1, -1, -1, names.index(name), 0])
                for name in self.free if name in names]
