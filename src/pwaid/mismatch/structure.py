"""What the simulator's equations mean: positions and speeds, inertias, stores, inputs, outputs.

Found by probing the right-hand side, not by reading it: a state whose derivative is another state
times a constant is a position; a parameter whose doubling halves a velocity's derivative is its
inertia; units come from the outputs. Everything the catalogue needs to place its effects follows.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pwaid.mismatch.effects.base import Place
from pwaid.mismatch.plant import Plant
from pwaid.mismatch.units import parse_unit, unit_kind

__all__ = ["Structure", "find_structure"]

_SPEEDS = ("speed", "angular_speed")
_NAMES = {
    "fluid": ("h", "level", "hl", "hu", "p", "pressure", "head", "vol", "volume"),
    "thermal": ("temp", "temperature", "tw", "tb", "t1", "t2", "t"),
    "velocity": ("v", "vel", "omega", "w", "speed", "dq", "dtheta", "qd", "thetadot", "xdot", "dx"),
    "electrical": ("i", "current", "vc", "il", "q"),
}


@dataclass(frozen=True)
class Structure:
    """Roles of states, inputs and outputs, with the ranges met in the recordings."""

    plant: Plant
    kinds: tuple[str, ...]
    partner: np.ndarray
    ratio: np.ndarray
    entry: dict[int, tuple[int, int, int]]
    force_scale: dict[int, float]
    state_units: tuple[dict, ...]
    force_units: dict[int, dict]
    inertia_units: dict[int, dict]
    low: np.ndarray
    high: np.ndarray
    input_rms: np.ndarray
    input_max: np.ndarray
    input_units: tuple[dict, ...]
    output_low: np.ndarray
    output_high: np.ndarray
    output_units: tuple[dict, ...]
    output_state: tuple[int, ...]
    time_scale: float
    length: float
    free: tuple[str, ...]
    mobility: dict[int, float] = field(default_factory=dict)

    # ------------------------------------------------------------------ helpers
    def position_of(self, v: int) -> int:
        found = [i for i in range(len(self.partner)) if self.partner[i] == v]
        return found[0] if found else -1

    def reach(self, i: int) -> float:
        if i < 0:
            return 1.0
        return float(max(abs(self.low[i]), abs(self.high[i]), 1e-12))

    def velocities(self) -> list[int]:
        return [i for i, k in enumerate(self.kinds) if k == "velocity"]

    def _place(self, kind, signal, variables, ii, v=-1, x=-1, k=-1, j=-1, **more) -> Place:
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

    def _force_ii(self, v: int) -> list[int]:
        mode, target, inertia = self.entry[v]
        ii = [0, mode, target, inertia, v, self.position_of(v), -1, -1, -1, -1, 0, 0]
        return ii

    # ------------------------------------------------------------------ places for the catalogue
    def moving(self, with_position: bool = False, with_input: bool = False) -> list[Place]:
        """Every speed a force can act on."""
        places = []
        for v in self.velocities():
            ii, x = self._force_ii(v), self.position_of(v)
            if x < 0 and with_position:
                x = v  # the stroke is unknown; scale by speed times the time scale
            names = [self.plant.state_names[v]]
            more = {}
            if with_position and self.position_of(v) < 0:
                more = {"scales": {"position": self.reach(v) * self.time_scale},
                        "units": {"position": {**self.state_units[v],
                                               "s": self.state_units[v].get("s", 0) + 1}}}
            if with_input:
                if not len(self.input_rms):
                    continue
                ii[8] = self._main_input(v)
                names.append(self.plant.input_names[ii[8]])
                more = {"scales": {"load": 1.0}}
            places.append(self._place("state", self.plant.state_names[v], names, ii, v=v, x=x, **more))
        return places

    def _main_input(self, v: int) -> int:
        mode, target, _ = self.entry[v]
        return target if mode == 0 else 0

    def positions(self, sides: bool = False) -> list[Place]:
        """Every position with a speed that a force can act on; one per side for stops."""
        places = []
        for v in self.velocities():
            x = self.position_of(v)
            if x < 0:
                continue
            for side in ((0, 1, -1) if sides else (0,)):
                ii = self._force_ii(v)
                ii[10] = side
                span = {0: (0.0, self.reach(x)), 1: (self.low[x], self.high[x] - self.low[x]),
                        -1: (self.high[x], self.low[x] - self.high[x])}[side]
                name = self.plant.state_names[x]
                places.append(self._place("state", self.plant.state_names[v], [name], ii, v=v, x=x,
                                          levels={"position": span},
                                          note=("both sides", "upper", "lower")[side]
                                          if sides else ""))
        return places

    def angles(self) -> list[Place]:
        """Positions measured as angles; the constant turns them into radians."""
        places = []
        for place in self.positions():
            symbols = self.state_units[place.ii[5]]
            if "m" in symbols or "mm" in symbols:
                continue
            factor = {"deg": np.pi / 180, "rev": 2 * np.pi, "mrad": 1e-3}
            constant = next((factor[s] for s in symbols if s in factor), 1.0)
            if self.reach(place.ii[5]) * constant > 0.05:
                places.append(self._with_constants(place, (constant,)))
        return places

    @staticmethod
    def _with_constants(place: Place, constants) -> Place:
        return Place(place.kind, place.signal, place.variables, place.ii, place.scales, place.units,
                     tuple(constants), place.levels, place.note)

    def shafts(self) -> list[Place]:
        """Pairs of positions joined by a stiff spring: one depends on the other's difference only."""
        places = []
        n = len(self.kinds)
        vs = [v for v in self.velocities() if self.position_of(v) >= 0]
        for a in vs:
            for b in vs:
                if a == b:
                    continue
                xa, xb = self.position_of(a), self.position_of(b)
                gear = self._shaft_ratio(a, b, xa, xb, n)
                if gear is None or (a > b and self._shaft_ratio(b, a, xb, xa, n) is not None):
                    continue
                ii = self._force_ii(a)
                ii[5], ii[9], ii[6] = xa, xb, b
                twist = max(abs(self.twist(xa, xb, gear)), 1e-12)
                places.append(self._place("state", f"{self.plant.state_names[xa]}-{self.plant.state_names[xb]}",
                                          [self.plant.state_names[xa], self.plant.state_names[xb]], ii, v=a,
                                          x=xa,
                                          scales={"position": twist},
                                          constants=(gear, float(self.ratio[xb]))))
        return places

    def twist(self, xa: int, xb: int, gear: float) -> float:
        return min(self.reach(xa) / abs(gear), self.reach(xb))

    def _shaft_ratio(self, a, b, xa, xb, n):
        rng = np.random.default_rng(1)
        ratios = []
        for _ in range(6):
            x = self.low + (self.high - self.low) * rng.uniform(size=n)
            u = self.input_rms * rng.normal(size=len(self.input_rms))
            ja = self._slope(a, xa, x, u), self._slope(a, xb, x, u)
            jb = self._slope(b, xa, x, u), self._slope(b, xb, x, u)
            if not (abs(ja[1]) > 0 and abs(jb[0]) > 0 and abs(jb[1]) > 0):
                return None
            ratios.append(-jb[1] / jb[0])
        ratios = np.array(ratios)
        if np.ptp(ratios) > 1e-3 * abs(ratios.mean()) or ratios.mean() <= 0:
            return None
        return float(ratios.mean())

    def _slope(self, i, j, x, u):
        d = max(self.reach(j), 1e-9) * 1e-4
        up, dn = x.copy(), x.copy()
        up[j] += d
        dn[j] -= d
        return (self.plant.derivative(up, u)[i] - self.plant.derivative(dn, u)[i]) / (2 * d)

    def single_masses(self) -> list[Place]:
        """A speed whose inertia may hide a load behind a shaft, measured on either side."""
        places = []
        if self.shafts():
            return places
        for v in self.velocities():
            x = self.position_of(v)
            if x < 0:
                continue
            ii = self._force_ii(v)
            places.append(self._place("state", self.plant.state_names[v], [self.plant.state_names[x]], ii,
                                      v=v, x=x,
                                      note="motor side measured"))
            for k, state in enumerate(self.output_state):
                if state in (x, v):
                    jj = list(ii)
                    jj[7], jj[10], jj[11] = k, 1, int(state == v)
                    places.append(self._place("state", self.plant.state_names[v],
                                              [self.plant.state_names[x]], jj, v=v,
                                              x=x, note="load side measured"))
        return places

    def inertias(self) -> list[Place]:
        places = []
        for v in self.velocities():
            ii = self._force_ii(v)
            places.append(self._place("state", self.plant.state_names[v],
                                      [f"d{self.plant.state_names[v]}/dt"], ii,
                                      v=v, constants=(self.mobility.get(v, 1.0),)))
        return places

    def velocity_products(self) -> list[Place]:
        """Products of speeds, times 1, sin or cos of a position: only with a second axis or a varying inertia."""
        places = []
        vs = self.velocities()
        angular = [self.position_of(v) for v in vs if self.position_of(v) >= 0]
        if len(vs) < 2:
            return places
        for v in vs:
            for a in range(len(vs)):
                for b in range(a, len(vs)):
                    if vs[a] == v and vs[b] == v:
                        continue
                    for variant, x in [(0, -1)] + [(k, x) for x in angular for k in (1, 2)]:
                        ii = self._force_ii(v)
                        ii[4], ii[6], ii[9], ii[10] = vs[a], vs[b], x, variant
                        names = [self.plant.state_names[vs[a]], self.plant.state_names[vs[b]]]
                        if x >= 0:
                            names.append(f"{('', 'sin', 'cos')[variant]}({self.plant.state_names[x]})")
                        speed = float(np.sqrt(self.reach(vs[a]) * self.reach(vs[b])))
                        places.append(self._place("state", self.plant.state_names[v], names, ii, v=v,
                                                  scales={"speed": speed}))
        return places

    def inputs(self, delays: bool = False) -> list[Place]:
        """Every command channel."""
        return [self._place("input", name, [name], [0, 0, j, -1, -1, -1, -1, -1, j, -1, 0, 0], j=j)
                for j, name in enumerate(self.plant.input_names)]

    def loads(self) -> list[Place]:
        """Constant forces: at every speed, and at inputs that drive no speed."""
        places = [self._place("state", self.plant.state_names[v], [], self._force_ii(v), v=v)
                  for v in self.velocities()]
        taken = {self.entry[v][1] for v in self.velocities() if self.entry[v][0] == 0}
        driven = len(self.velocities()) and all(self.kinds[i] in ("velocity", "position")
                                                for i in range(len(self.kinds)))
        for j, name in enumerate(self.plant.input_names):
            if j in taken or (driven and len(self.plant.input_names) == 1):
                continue
            ii = [0, 0, j, -1, -1, -1, -1, -1, j, -1, 0, 0]
            places.append(self._place("input", name, [], ii, j=j,
                                      scales={"force": float(self.input_max[j]) or 1.0},
                                      units={"force": self.input_units[j]}))
        return places

    def outputs(self, sides: bool = False, variant: int = 0) -> list[Place]:
        """Every sensor channel; one per side for limits."""
        places = []
        for k, name in enumerate(self.plant.output_names):
            lo, hi = float(self.output_low[k]), float(self.output_high[k])
            options = [(variant, (0.0, max(abs(lo), abs(hi), 1e-12)))]
            if sides:
                options = [(1, (lo, hi - lo)), (-1, (hi, lo - hi))]
                if lo < 0 < hi:
                    options.insert(0, (0, (0.0, max(-lo, hi))))
            for side, span in options:
                ii = [0, 0, 0, -1, -1, -1, -1, k, -1, -1, side, 0]
                places.append(self._place("output", name, [name], ii, k=k, levels={"output": span},
                                          note=("both sides", "upper", "lower")[side] if sides else ""))
        return places

    def stores(self, kind: str) -> list[Place]:
        """Levels or pressures (fluid), temperatures (thermal)."""
        places = []
        for i, found in enumerate(self.kinds):
            if found not in (kind, "store"):
                continue
            ii = [0, 1, i, -1, i, -1, -1, -1, -1, -1, 0, 0]
            typical = 0.5 * (self.low[i] + self.high[i])
            absolute = typical > 200.0
            shift = 0.0 if absolute else (293.15 if "K" in self.state_units[i] else 273.15)
            constants = (shift,) if kind == "thermal" else ()
            span = (min(self.low[i], 0.0), self.high[i] - min(self.low[i], 0.0))
            places.append(self._place("state", self.plant.state_names[i], [self.plant.state_names[i]], ii,
                                      x=i,
                                      levels={"position": span,
                                              "ambient": (self.low[i], self.high[i] - self.low[i])},
                                      units={"ambient": self.state_units[i]}, constants=constants))
        return places

    def cascades(self, kind: str) -> list[Place]:
        """A store that feeds another."""
        places = []
        members = [i for i, k in enumerate(self.kinds) if k in (kind, "store")]
        mid = 0.5 * (self.low + self.high)
        for i in members:
            for j in members:
                if i != j and abs(self._slope(j, i, mid, self.input_rms)) > 1e-9 / self.time_scale:
                    if abs(self._slope(i, j, mid, self.input_rms)) > 1e-9 / self.time_scale and i > j:
                        continue
                    ii = [0, 1, i, -1, i, -1, j, -1, -1, -1, 0, 0]
                    places.append(self._place(
                        "state", self.plant.state_names[i],
                        [self.plant.state_names[i], self.plant.state_names[j]], ii,
                        x=i, levels={"position": (0.0, self.reach(i)), "second": (0.0, self.reach(j))},
                        units={"second": self.state_units[j]}))
        return places

    def drifting_parameters(self) -> list[Place]:
        names = list(self.plant.parameters)
        return [self._place("parameter", name, ["t"],
                            [0, 0, 0, -1, -1, -1, -1, -1, -1, -1, names.index(name), 0])
                for name in self.free if name in names]


def find_structure(plant: Plant, states, inputs, outputs, input_units, output_units, sample_time, length,
                   free=()):
    """Probe the plant over the states met in a simulation of the recordings.

    Parameters
    ----------
    states, inputs, outputs : (N, nx), (N, nu), (N, ny) arrays of the refitted nominal simulation.
    input_units, output_units : unit texts per channel.
    sample_time, length : seconds.
    free : names of free parameters.
    """
    states = np.asarray(states, dtype=float)
    good = np.all(np.isfinite(states), axis=1)
    states = states[good] if good.any() else np.zeros_like(states)
    nx, nu, _ = plant.sizes
    low, high = np.quantile(states, 0.002, axis=0), np.quantile(states, 0.998, axis=0)
    rms_u = np.sqrt(np.mean(inputs**2, axis=0)) if nu else np.zeros(0)
    rng = np.random.default_rng(0)
    points = [(low + (high - low) * rng.uniform(size=nx), rms_u * rng.normal(size=nu)) for _ in range(12)]
    partner, ratio = _kinematics(plant, points, low, high)
    output_state, gains = _output_map(plant, points, low, high)
    in_units = tuple(parse_unit(u) for u in input_units)
    out_units = tuple(parse_unit(u) for u in output_units)
    units = [{} for _ in range(nx)]
    kinds = [""] * nx
    for k, i in enumerate(output_state):
        if i >= 0 and abs(gains[k] - 1) < 1e-6:
            units[i] = out_units[k]
    _spread_units(units, partner)
    for i in range(nx):
        kinds[i] = _kind_of(i, plant, partner, units, output_state, output_units)
    _guess_stores(kinds, plant, points, high)
    default_angle = any(unit_kind(u) == "torque" for u in input_units)
    for i in range(nx):
        if kinds[i] in ("velocity", "position") and not units[i]:
            base = {"rad": 1} if default_angle or "th" in plant.state_names[i].lower() else {"m": 1}
            units[i] = {**base, "s": -1} if kinds[i] == "velocity" else base
    for kind in ("fluid", "thermal"):
        known = next((units[i] for i in range(nx) if kinds[i] == kind and units[i]), {})
        for i in range(nx):
            if kinds[i] == kind and not units[i]:
                units[i] = known
    entry, scale, funits, iunits, mobility = _force_entries(plant, kinds, points, low, high, rms_u,
                                                            input_units, units)
    dy = np.diff(outputs, axis=0) / sample_time
    active = np.std(outputs, axis=0) > 0
    ratios = np.std(outputs, axis=0)[active] / np.maximum(np.std(dy, axis=0)[active], 1e-300)
    time_scale = float(np.clip(np.median(ratios) if ratios.size else 1.0, 2 * sample_time, length / 4))
    return Structure(
        plant, tuple(kinds), partner, ratio, entry, scale, tuple(units), funits, iunits, low, high, rms_u,
        np.max(np.abs(inputs), axis=0) if nu else np.zeros(0), in_units, np.min(outputs, axis=0),
        np.max(outputs, axis=0), out_units, output_state, time_scale, float(length), tuple(free), mobility)


def _kinematics(plant, points, low, high):
    nx = plant.sizes[0]
    partner, ratio = -np.ones(nx, dtype=np.int64), np.zeros(nx)
    if plant.dt:
        return partner, ratio
    F = np.array([plant.derivative(x, u) for x, u in points])
    Xs = np.array([x for x, _ in points])
    for i in range(nx):
        for j in range(nx):
            if i == j or np.ptp(Xs[:, j]) == 0:
                continue
            c = F[:, i] @ Xs[:, j] / max(Xs[:, j] @ Xs[:, j], 1e-300)
            if c != 0 and np.allclose(F[:, i], c * Xs[:, j], rtol=1e-9, atol=1e-12 * np.max(np.abs(F[:, i]))):
                # a store emptying into the next is not a speed: the other way round must not hold a loss only
                partner[i], ratio[i] = j, c
    for i in range(nx):  # a chain position -> speed -> acceleration keeps only its first link
        if partner[i] >= 0 and partner[partner[i]] >= 0:
            partner[partner[i]] = -1
    return partner, ratio


def _output_map(plant, points, low, high):
    ny = plant.sizes[2]
    G = np.array([plant.outputs(x, u) for x, u in points])
    Xs = np.array([x for x, _ in points])
    found, gains = [-1] * ny, [0.0] * ny
    for k in range(ny):
        for i in range(Xs.shape[1]):
            c = G[:, k] @ Xs[:, i] / max(Xs[:, i] @ Xs[:, i], 1e-300)
            if np.any(G[:, k]) and np.allclose(G[:, k], c * Xs[:, i], rtol=1e-9,
                                               atol=1e-12 * np.max(np.abs(G[:, k]))):
                found[k], gains[k] = i, c
    return tuple(found), gains


def _spread_units(units, partner):
    for i, j in enumerate(partner):
        if j >= 0:
            if units[i] and not units[j]:
                units[j] = {**units[i], "s": units[i].get("s", 0) - 1}
            elif units[j] and not units[i]:
                units[i] = {s: p for s, p in {**units[j], "s": units[j].get("s", 0) + 1}.items() if p}


def _kind_of(i, plant, partner, units, output_state, output_units):
    if partner[i] >= 0:
        return "position"
    if i in partner:
        return "velocity"
    if plant.dt and plant.linear:
        return "abstract"
    for k, state in enumerate(output_state):
        if state == i:
            kind = unit_kind(output_units[k])
            if kind in _SPEEDS:
                return "velocity"
            if kind in ("length", "pressure", "volume", "flow"):
                return "fluid"
            if kind == "temperature":
                return "thermal"
            if kind in ("current", "charge"):
                return "electrical"
    name = plant.state_names[i].lower().rstrip("0123456789_")
    for kind, names in _NAMES.items():
        if name in names or plant.state_names[i].lower() in names:
            return kind
    return "abstract" if plant.linear else "unknown"


def _guess_stores(kinds, plant, points, high):
    """Undecided states: stores when the right-hand side holds a square root of them, else like their siblings."""
    for i, kind in enumerate(kinds):
        if kind not in ("unknown", "electrical"):
            continue
        x, u = points[0][0].copy(), points[0][1]
        a = max(abs(high[i]), 1e-9) / 4
        values = []
        for m in (0.0, 1.0, 4.0):
            z = x.copy()
            z[i] = m * a
            values.append(plant.derivative(z, u))
        d1, d4 = values[1] - values[0], values[2] - values[0]
        rooted = (np.abs(d1) > 0) & np.isclose(d4, 2 * d1, rtol=1e-3)
        if rooted.any():
            kinds[i] = "fluid"
    decided = {k for k in kinds if k in ("fluid", "thermal")}
    for i, kind in enumerate(kinds):
        if kind == "unknown":
            kinds[i] = decided.pop() if len(decided) == 1 else ("store" if not decided else "unknown")
            decided = {k for k in kinds if k in ("fluid", "thermal")}


def _force_entries(plant, kinds, points, low, high, rms_u, input_units, units):
    entry, scale, funits, iunits, mobility = {}, {}, {}, {}, {}
    p = plant.vector()
    base = np.array([plant.derivative(x, u) for x, u in points])
    halves = {}
    for k in range(len(plant.parameters)):
        q = p.copy()
        q[k] *= 2.0
        if q[k] != p[k]:
            halves[k] = np.array([plant.derivative(x, u, q) for x, u in points])
    nu = plant.sizes[1]
    gain = np.zeros((len(kinds), nu))
    affine = np.ones((len(kinds), nu), dtype=bool)
    for j in range(nu):
        columns = []
        for x, u in points:
            d = np.zeros(nu)
            d[j] = max(rms_u[j], 1e-9)
            columns.append((plant.derivative(x, u + d) - plant.derivative(x, u)) / d[j])
        columns = np.array(columns)
        gain[:, j] = np.mean(columns, axis=0)
        affine[:, j] = np.all(np.isclose(columns, gain[:, j], rtol=0.6, atol=1e-12), axis=0)
    for i, kind in enumerate(kinds):
        if kind != "velocity":
            continue
        inertia = [k for k, h in halves.items()
                   if np.any(base[:, i]) and np.allclose(2 * h[:, i], base[:, i], rtol=1e-9, atol=1e-14)]
        forces = [j for j in range(nu) if unit_kind(input_units[j]) in ("force", "torque") and gain[i, j] != 0
                  and affine[i, j]]
        angular = any(s in units[i] for s in ("rad", "deg", "rev", "mrad"))
        funits[i] = {"N": 1, "m": 1} if angular else {"N": 1}
        iunits[i] = {"kg": 1, "m": 2} if angular else {"kg": 1}
        if inertia:
            entry[i] = (1, i, inertia[0])
            mobility[i] = 1.0 / p[inertia[0]]
        elif forces:
            j = max(forces, key=lambda j: abs(gain[i, j]))
            entry[i] = (0, j, -1)
            funits[i] = parse_unit(input_units[j])
            mobility[i] = abs(gain[i, j])
        else:
            entry[i] = (1, i, -1)
            mobility[i] = 1.0
            funits[i] = {**units[i], "s": units[i].get("s", 0) - 1}
            iunits[i] = {}
        parts = [abs(gain[i, j]) * rms_u[j] for j in range(nu)]
        for m in range(len(kinds)):
            x = 0.5 * (low + high)
            up, dn = x.copy(), x.copy()
            up[m], dn[m] = high[m], low[m]
            parts.append(abs(plant.derivative(up, np.zeros(nu))[i] - plant.derivative(dn, np.zeros(nu))[i]) / 3.5)
        parts.append(float(np.std(base[:, i])) * 0.3)
        scale[i] = max([q for q in parts if np.isfinite(q)] + [1e-12]) / mobility[i]
    return entry, scale, funits, iunits, mobility
