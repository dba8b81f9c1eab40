"""Where fluid or heat is stored, and through which outlets it leaves."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from pwaid.mismatch.effects.base import Place
from pwaid.mismatch.structure import Structure

__all__ = ["cascades", "heated", "neighbours", "outlets", "own_outlets", "spills", "stores"]

STEP = 1e-4  # relative change of a parameter
# what makes a temperature in it absolute
ZEROS = {"degC": 273.15, "°C": 273.15, "C": 273.15, "degF": 459.67, "°F": 459.67}


def stores(s: Structure, kind: str) -> list[Place]:
    """Levels or pressures (fluid), temperatures (thermal)."""
    places = []
    for i in _members(s, kind):
        ii = [0, 1, i, -1, i, -1, -1, -1, -1, -1, 0, 0]
        constants = (_zero(s, i),) if kind == "thermal" else ()
        span = (min(s.low[i], 0.0), s.high[i] - min(s.low[i], 0.0))
        levels = {"position": span, "ambient": (s.low[i], s.high[i] - s.low[i])}
        places.append(s.place("state", s.plant.state_names[i], [s.plant.state_names[i]], ii, x=i, levels=levels,
                              units={"ambient": s.state_units[i]}, constants=constants))
    return places


def _zero(s: Structure, i: int) -> float:
    """What makes a temperature absolute: by its unit, and where that is kelvin or not known by its size."""
    unit = s.state_units[i]
    known = next((shift for symbol, shift in ZEROS.items() if symbol in unit), None)
    if known is not None:
        return known
    return 0.0 if 0.5 * (s.low[i] + s.high[i]) > 200.0 else (293.15 if "K" in unit else 273.15)


def cascades(s: Structure, kind: str) -> list[Place]:
    """A store that feeds another."""
    places, mid = [], 0.5 * (s.low + s.high)
    for i, j in itertools.permutations(_members(s, kind), 2):
        feeds, fed_back = (abs(s.slope(*pair, mid, s.input_rms)) > 1e-9 / s.time_scale for pair in ((j, i), (i, j)))
        if not feeds or (fed_back and i > j):
            continue
        ii = [0, 1, i, -1, i, -1, j, -1, -1, -1, 0, 0]
        names = [s.plant.state_names[i], s.plant.state_names[j]]
        places.append(s.place("state", names[0], names, ii, x=i,
                              levels={"position": (0.0, s.reach(i)), "second": (0.0, s.reach(j))},
                              units={"second": s.state_units[j]}))
    return places


def spills(s: Structure, *first: float) -> list[Place]:
    """Cascades, with what the second store rises when the first one gives away what it would rise itself, behind the
    constants `first`.

    With two areas a1 and a2 that is a1/a2. It is read off the flow that the first store's level drives into the second,
    with up to two parameters that it is proportional to, or inversely; 1 where the level drives other flows too.
    """
    places = []
    for place in cascades(s, "fluid"):
        gain, shaping = _passed_on(s, place.ii[4], place.ii[6])
        ii, constants = list(place.ii), [gain]
        for slot, (n, value, power) in zip((9, 11), shaping, strict=False):
            ii[slot] = n
            constants += [value, power]
        ii[11] = ii[11] if len(shaping) > 1 else -1
        places.append(replace(place, ii=tuple(ii), constants=(*first, *constants, *[1.0] * (5 - len(constants)))))
    return places


def _passed_on(s: Structure, i: int, j: int) -> tuple[float, list[tuple[int, float, float]]]:
    """What store j rises per fall of store i, and parameters that shape it: position, value, power (1 or -1)."""
    p = s.plant.vector()
    points = [(x, u) for x, u in s.points(8) if x[i] > 0.1 * s.reach(i)]
    gains = np.array([_gain(s, i, j, x, u, p) for x, u in points])
    if not len(gains) or not np.all(gains > 0.0) or np.ptp(gains) > 1e-3 * np.mean(gains):
        return 1.0, []
    shaping, (x, u) = [], points[0]
    for n, value in enumerate(p):
        other = p.copy()
        other[n] *= 1.25
        power = np.log(max(_gain(s, i, j, x, u, other), 1e-300) / gains[0]) / np.log(1.25) if value > 0.0 else 0.0
        if abs(power) > 1e-3:
            shaping.append((n, float(value), float(np.round(power))))
            if abs(abs(power) - 1.0) > 1e-3 or len(shaping) > 2:
                return float(np.mean(gains)), []
    return float(np.mean(gains)), shaping


def _gain(s: Structure, i: int, j: int, x, u, p) -> float:
    """How much faster store j rises by a higher level in store i, over how much faster that one falls."""
    falls = -s.slope(i, i, x, u, p)
    return float(s.slope(j, i, x, u, p) / falls) if falls > 0.0 else 0.0


def heated(s: Structure) -> list[Place]:
    """A temperature and an input that heats it alone, in proportion, whatever else happens."""
    thermal, places = _members(s, "thermal"), []
    for j in range(len(s.plant.input_names)) if thermal and s.plant.black_box is None else ():
        warmed = np.array([_by_input(s, x, u, j) for x, u in s.points(6)])
        largest = np.max(np.abs(warmed))
        driven = np.flatnonzero(np.abs(warmed[0]) > 1e-9 * largest)
        if np.ptp(warmed, axis=0).max() > 1e-6 * largest or len(driven) != 1:
            continue
        i = int(driven[0])
        if i in thermal and warmed[0][i] > 0.0:
            ii = [0, 1, i, -1, i, -1, -1, -1, j, -1, 0, 0]
            names = [s.plant.input_names[j], s.plant.state_names[i]]
            places.append(s.place("input", names[0], names, ii, x=i, j=j))
    return places


def _by_input(s: Structure, x, u, j: int) -> np.ndarray:
    """What a tenth of the largest input j adds to the rates."""
    more = u.copy()
    more[j] += 0.1 * s.input_max[j]
    return s.plant.derivative(x, more) - s.plant.derivative(x, u)


def neighbours(s: Structure) -> list[Place]:
    """Two fluid stores in one unit, between which a gap may leak."""
    places = []
    for i, j in itertools.combinations(_members(s, "fluid"), 2):
        if s.state_units[i] == s.state_units[j]:
            names = [s.plant.state_names[i], s.plant.state_names[j]]
            places.append(s.place("state", "-".join(names), names, [0, 1, i, -1, i, -1, j, -1, -1, -1, 0, 0], x=i))
    return places


def outlets(s: Structure) -> list[Place]:
    """A place for every parameter k that acts as the flow k*h or k*(h - h2) out of a store, wherever that flow goes.

    The derivative of every rate by such a parameter is proportional to the head, whatever the inputs are.
    """
    members = _members(s, "fluid")
    heads = [(i, -1) for i in members] + list(itertools.combinations(members, 2))
    places = []
    for n, name, points, change in _flows(s, members, s.free):
        X, size = np.array([x for x, _ in points]), np.max(np.abs(change), axis=0)
        for i, j in heads:
            head = X[:, i] - (X[:, j] if j >= 0 else 0.0)
            gain = head @ change / (head @ head)
            if np.allclose(change, np.outer(head, gain), rtol=1e-5, atol=1e-7 * float(size.max())) and gain[i] < 0.0:
                names = [s.plant.state_names[k] for k in (i, j) if k >= 0]
                ii = [0, 0, i, n, i, -1, j, -1, -1, -1, 0, 0]
                places.append(s.place("state", names[0], names, ii, x=i, note=f"through {name}"))
    return places


def own_outlets(s: Structure) -> list[Place]:
    """A place for every parameter k that acts as the flow k*h or k*sqrt(h) out of a store whose rate depends on h in
    another way too: its area does, or another flow.

    The area shows in how much an input raises the level; the constant is the power of h in the flow.
    """
    places = []
    for i in _members(s, "fluid"):
        for n, name, points, change in _flows(s, [i], s.plant.parameters):
            power = _power(s, i, n, points) if np.all(change[:, i] < 0.0) else None
            if power is not None:
                ii = [0, 0, i, n, i, -1, -1, -1, -1, -1, 0, 0]
                places.append(s.place("state", s.plant.state_names[i], [s.plant.state_names[i]], ii, x=i,
                                      constants=(power,), note=f"through {name}"))
    return places


def _flows(s: Structure, members, names):
    """Parameter, its name, points and the derivative of every rate by it there, (points, nx), in steps of its size."""
    if not members or s.plant.black_box is not None:
        return
    points, p = s.points(12), s.plant.vector()
    for n, name in enumerate(s.plant.parameters):
        if name in names and p[n] != 0.0:
            yield n, name, points, np.array([_change(s, x, u, p, n) for x, u in points])


def _change(s: Structure, x, u, p, n: int) -> np.ndarray:
    more, less = p.copy(), p.copy()
    more[n] *= 1 + STEP
    less[n] *= 1 - STEP
    return s.plant.derivative(x, u, more) - s.plant.derivative(x, u, less)


def _power(s: Structure, i: int, n: int, points) -> float | None:
    """The power, 0.5 or 1, of level i in the flow that parameter n scales, where the area or another flow depends
    on the level; None where there is no such, or no input that shows the area."""
    p, found, other = s.plant.vector(), [], False
    for x, u in points:
        high, low = x.copy(), x.copy()
        high[i], low[i] = s.high[i], 0.5 * s.high[i]
        flow = [_change(s, z, u, p, n)[i] for z in (high, low)]
        fill = [_fill(s, z, i) for z in (high, low)]
        if not s.high[i] > 0.0 or max(flow) >= 0.0 or min(fill) <= 0.0:
            return None
        area = fill[1] / fill[0]
        rest = [s.plant.derivative(z, u)[i] - f / (2 * STEP) for z, f in zip((high, low), flow, strict=True)]
        other |= abs(area - 1.0) > 1e-3 or abs(rest[0] - rest[1]) > 1e-3 * abs(flow[0]) / (2 * STEP)
        found.append(np.log2(flow[0] / flow[1] * area))
    power = next((q for q in (0.5, 1.0) if np.allclose(found, q, atol=1e-3)), None)
    return power if other else None


def _fill(s: Structure, x, i: int) -> float:
    """How much more the largest inputs raise level i than inputs a tenth smaller."""
    return float((s.plant.derivative(x, s.input_high) - s.plant.derivative(x, 0.9 * s.input_high))[i])


def _members(s: Structure, kind: str) -> list[int]:
    return [i for i, found in enumerate(s.kinds) if found in (kind, "store")]
