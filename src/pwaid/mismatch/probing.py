"""Find what the simulator's equations mean by probing the right-hand side, not by reading it.

A state whose derivative is another state times a constant is a position; a parameter whose doubling
halves a velocity's derivative is its inertia; a square root marks a fluid store; units come from the
outputs and spread along the kinematic chain.
"""

from __future__ import annotations

import numpy as np

from pwaid.errors import InputError
from pwaid.mismatch.entries import STEPPED, force_entries
from pwaid.mismatch.plant import Plant
from pwaid.mismatch.structure import OutputMap, Structure, drawn_point, on_line, two_terms, weights_of
from pwaid.mismatch.units import combine, parse_unit, scaled_unit, unit_kind

__all__ = ["find_structure"]

VISITED = 500  # states kept
_SPEEDS = ("speed", "angular_speed")
_NO_MOTION = ("current", "voltage", "charge", "temperature", "force", "torque", "pressure", "flow", "acceleration")
_NAMES = {
    "fluid": ("h", "level", "hl", "hu", "p", "pressure", "head", "vol", "volume"),
    "thermal": ("temp", "temperature", "tw", "tb", "t1", "t2", "t"),
    "velocity": ("v", "vel", "omega", "w", "speed", "dq", "dtheta", "qd", "thetadot", "xdot", "dx"),
    "electrical": ("i", "current", "vc", "il", "q"),
}


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
    input_range = np.min(inputs, axis=0), np.max(inputs, axis=0)
    points = _points(plant, rng, low, high, rms_u, input_range)
    partner, ratio, share = _kinematics(plant, points, low, high)
    shown = _output_map(plant, points)
    for k, i in enumerate(shown.state):
        if i >= 0:  # a simulator that lacks friction or a stop goes elsewhere than the machine
            met = shown.state_of(k, np.quantile(outputs[:, k], [0.002, 0.998]))
            low[i], high[i] = min(low[i], met.min()), max(high[i], met.max())
    in_units = tuple(parse_unit(u) for u in input_units)
    out_units = tuple(parse_unit(u) for u in output_units)
    units = [{} for _ in range(nx)]
    kinds = [""] * nx
    for k, i in enumerate(shown.state):
        if i >= 0 and not units[i]:
            units[i] = scaled_unit(output_units[k], shown.gain[k], shown.offset[k])
    averaged = _averages(plant, points, shown, output_units)
    for i, k in averaged.items():
        units[i] = units[i] or out_units[k]
    _drop_impossible(units, partner, ratio)
    _spread_units(units, partner, ratio)
    for i in range(nx):
        kinds[i] = _kind_of(i, plant, partner, units, shown.state, output_units, averaged)
    _relative_speeds(kinds, units, plant, points)
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
    visited, least, most = _joined_motion(points, states, kinds, low, high)
    forces = force_entries(plant, kinds, visited, (least, most), rms_u, input_units, units)
    dy = np.diff(outputs, axis=0) / sample_time
    active = np.std(outputs, axis=0) > 0
    ratios = np.std(outputs, axis=0)[active] / np.maximum(np.std(dy, axis=0)[active], 1e-300)
    time_scale = float(np.clip(np.median(ratios) if ratios.size else 1.0, 2 * sample_time, length / 4))
    return Structure(
        plant, tuple(kinds), partner, ratio, share, forces.entry, forces.scale, tuple(units), forces.units,
        forces.inertia_units, low, high, rms_u,
        *input_range, in_units, np.min(outputs, axis=0),
        np.max(outputs, axis=0), out_units, shown, time_scale, float(length), tuple(free), forces.mobility,
        _hook_scale(plant, inputs, outputs), states[::max(1, len(states) // VISITED)],
        _empty(plant, points, kinds, high))


def _empty(plant, points, kinds, high) -> np.ndarray:
    """Levels (nx,) below which a store is empty: 0 where nothing depends on lower ones, -inf for other states."""
    found = np.full(len(kinds), -np.inf)
    for i, kind in enumerate(kinds):
        if plant.black_box is None and kind in ("fluid", "store"):
            a, rates = max(abs(high[i]), 1e-9), []
            for x, u in points[:6]:
                levels = np.repeat(np.asarray(x, dtype=float)[None], 4, axis=0)
                levels[:, i] = -2 * a, -a, a, 2 * a
                rates.append([plant.derivative(z, u) for z in levels])
            below, above = (np.array([np.subtract(r[k + 1], r[k]) for r in rates]) for k in (0, 2))
            if np.all(np.abs(below) <= 1e-9 * np.max(np.abs(above))) and np.any(above):
                found[i] = 0.0
    return found


def _hook_scale(plant, inputs, outputs):
    """Size of a constant at each force hook of a black box that moves the outputs as much as they vary."""
    if not plant.force_names:
        return ()
    nu, values, still = plant.sizes[1], plant.black_box.parameters, np.zeros(plant.sizes[0])
    U = np.zeros((len(inputs), nu + len(plant.force_names)))
    U[:, :nu] = inputs
    spread, found = np.std(outputs, axis=0) + 1e-300, []
    for j in range(len(plant.force_names)):
        size = 1.0
        for _ in range(3):  # the response need not be linear
            pushed = U.copy()
            pushed[:, nu + j] = size
            base, moved = plant.black_box.run(U, values, still), plant.black_box.run(pushed, values, still)
            if base is None or moved is None or not np.all(np.isfinite(moved - base)):
                size *= 1e-3
                continue
            response = float(np.max(np.sqrt(np.mean((moved - base) ** 2, axis=0)) / spread))
            size = size / response if response > 1e-9 else size
        found.append(size)
    return tuple(found)


def _points(plant, rng, low, high, rms_u, input_range, count: int = 12):
    """States and inputs where the plant can be evaluated, within the ranges met."""
    found = []
    for _ in range(10 * count):
        x, u = drawn_point(rng, (low, high), rms_u, input_range)
        if np.all(np.isfinite(plant.derivative(x, u))) and np.all(np.isfinite(plant.outputs(x, u))):
            found.append((x, u))
        if len(found) == count:
            return found
    raise InputError(f"the simulator gives finite derivatives at {len(found)} of {10 * count} states between "
                     f"{low.tolist()} and {high.tolist()}; expected them wherever the recordings go")


def _joined_motion(points, states, kinds, low, high):
    """Points and ranges for the sizes of forces where several positions move together.

    Two bodies on one stiff shaft never are at independent positions: the force between them would come out as
    stiffness times the whole travel. Each position keeps the range that the others leave open.
    """
    places = [i for i, kind in enumerate(kinds) if kind == "position"]
    if len(places) < 2 or len(states) < 4 * len(places):
        return points, low, high
    least, most = low.copy(), high.copy()
    centre = np.median(states, axis=0)
    for i in places:
        others = states[:, [j for j in places if j != i]] - centre[[j for j in places if j != i]]
        slope = np.linalg.lstsq(others, states[:, i] - centre[i], rcond=None)[0]
        free = states[:, i] - centre[i] - others @ slope
        span = np.quantile(free, 0.998) - np.quantile(free, 0.002)
        middle = 0.5 * (low[i] + high[i])
        least[i], most[i] = middle - 0.5 * span, middle + 0.5 * span
    rows = np.linspace(0, len(states) - 1, len(points)).astype(int)
    return [(states[k], u) for k, (_, u) in zip(rows, points, strict=True)], least, most


def _kinematics(plant, points, low, high):
    """Of each state the speed it is a position of (-1: none), their ratio, and `Structure.share`."""
    nx = plant.sizes[0]
    partner, ratio, found = -np.ones(nx, dtype=np.int64), np.zeros(nx), []
    if plant.black_box is not None or (plant.dt and plant.linear):  # their states need not be anything physical
        return partner, ratio, 0.5
    F = np.array([plant.derivative(x, u) for x, u in points])
    Xs = np.array([x for x, _ in points])
    for i in range(nx):
        for j in range(nx):
            if i == j or np.ptp(Xs[:, j]) == 0:
                continue
            # over a step of a discrete simulator the speed is its mean, or its next value
            later = ((0.0, 1e-12), (0.5, STEPPED), (1.0, STEPPED)) if plant.dt else ((0.0, 1e-12),)
            for share, trifle in later:
                speed = Xs[:, j] + share * plant.dt * F[:, j] if share else Xs[:, j]
                c = F[:, i] @ speed / max(speed @ speed, 1e-300)
                if partner[i] < 0 and c != 0 and np.allclose(F[:, i], c * speed, rtol=1e-9,
                                                             atol=trifle * np.max(np.abs(F[:, i]))):
                    # a store emptying into the next is not a speed: the other way round must not hold a loss only
                    partner[i], ratio[i] = j, c
                    found.append(share)
    for i in range(nx):  # a chain position -> speed -> acceleration keeps only its first link
        if partner[i] >= 0 and partner[partner[i]] >= 0:
            partner[partner[i]] = -1
    return partner, ratio, found[0] if plant.dt and found else 0.5


def _output_map(plant, points) -> OutputMap:
    """The state each output shows, y = gain x + offset; -1 where it shows none alone."""
    G = np.array([plant.outputs(x, u) for x, u in points])
    Xs = np.array([x for x, _ in points])
    state, gains, offsets = [-1] * plant.sizes[2], [1.0] * plant.sizes[2], [0.0] * plant.sizes[2]
    for k, y in enumerate(G.T):
        for i, x in enumerate(Xs.T):
            line = on_line(x, y)
            if line is not None:
                state[k], (gains[k], offsets[k]) = i, line
    return OutputMap(tuple(state), tuple(gains), tuple(offsets))


def _drop_impossible(units, partner, ratio):
    """A speed or a current is no position, and a current or a position no speed, whatever the derivatives look like.

    Volts are what a pick-up gives: a state in volts and its very rate may be a position and a speed.
    """
    for i, j in enumerate(partner):
        if j >= 0:
            position, speed = (unit_kind(combine({}, (units[k], 1))) for k in (i, j))
            if "voltage" in (position, speed) and abs(ratio[i] - 1.0) < 1e-9:
                continue
            if position in (*_SPEEDS, *_NO_MOTION) or speed in ("length", "angle", *_NO_MOTION):
                partner[i], ratio[i] = -1, 0.0


def _spread_units(units, partner, ratio):
    """A position's unit from its speed's and the reverse, where the one is the rate of the other."""
    for i, j in enumerate(partner):
        if j >= 0 and abs(ratio[i] - 1.0) < 1e-6:
            if units[i] and not units[j]:
                units[j] = {**units[i], "s": units[i].get("s", 0) - 1}
            elif units[j] and not units[i]:
                units[i] = {s: p for s, p in {**units[j], "s": units[j].get("s", 0) + 1}.items() if p}


def _averages(plant, points, shown, output_units) -> dict[int, int]:
    """State and output, for outputs that are a mean of several states: temperatures or levels that a sensor sees at
    once, in its own unit."""
    found = {}
    Xs, G = np.array([x for x, _ in points]), np.array([plant.outputs(x, u) for x, u in points])
    if np.linalg.matrix_rank(Xs) < Xs.shape[1]:
        return found
    for k, y in enumerate(G.T):
        if shown.state[k] >= 0 or unit_kind(output_units[k]) not in ("temperature", "length", "pressure"):
            continue
        weights = weights_of(Xs, y)
        if weights is None:
            continue
        parts = np.flatnonzero(np.abs(weights) > 1e-9)
        if np.all(weights[parts] > 0) and abs(np.sum(weights) - 1) < 1e-6:
            found |= {int(i): k for i in parts}
    return found


def _kind_of(i, plant, partner, units, output_state, output_units, averaged):
    if partner[i] >= 0:
        return "position"
    if i in partner:
        return "velocity"
    if plant.black_box is not None or (plant.dt and plant.linear):
        return "abstract"
    for k, state in [*enumerate(output_state), *((k, i) for i, k in averaged.items())]:
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


def _relative_speeds(kinds, units, plant, points):
    """The other speed where a state is the difference of two, one of them known: the twist of a shaft, a stretch."""
    if "velocity" not in kinds:
        return
    F, Xs = np.array([plant.derivative(x, u) for x, u in points]), np.array([x for x, _ in points])
    if np.linalg.matrix_rank(Xs) < Xs.shape[1]:
        return
    for own, rate in enumerate(F.T):
        found = two_terms(Xs, rate)
        if found is None or own in found[0]:  # a body's own damping beside the spring that drives it
            continue
        pair, weights = found
        same = np.isclose(*np.abs(weights), rtol=1e-6)
        for known, other in (pair, pair[::-1]):
            if kinds[known] == "velocity" and kinds[other] in ("unknown", "abstract"):
                kinds[other] = "velocity"
                units[other] = units[other] or (units[known] if same else {})


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
            moving = "velocity" in kinds
            kinds[i] = decided.pop() if len(decided) == 1 else ("store" if not decided and not moving else "unknown")
            decided = {k for k in kinds if k in ("fluid", "thermal")}
