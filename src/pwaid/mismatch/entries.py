"""Where a force on each speed enters the simulator's equations, in which unit, and how large forces are there."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from pwaid.mismatch.plant import Plant
from pwaid.mismatch.units import KNOWN, factor_of, parse_unit, unit_kind

__all__ = ["STEPPED", "Forces", "force_entries"]

STEPPED = 5e-3  # of the largest rate: what a step of a discrete simulator adds to a relation of its equations


@dataclass(frozen=True)
class Forces:
    """By the index of a speed: how a force on it enters (mode, target, inertia as `Effect` kernels take them), the size
    of forces there, the units of a force and of an inertia, and the acceleration by a unit of force."""

    entry: dict[int, tuple[int, int, int]] = field(default_factory=dict)
    scale: dict[int, float] = field(default_factory=dict)
    units: dict[int, dict] = field(default_factory=dict)
    inertia_units: dict[int, dict] = field(default_factory=dict)
    mobility: dict[int, float] = field(default_factory=dict)


def force_entries(plant: Plant, kinds, points, ranges, rms_u, input_units, units) -> Forces:
    """The entry of every speed, from probes at `points`, (state, input) each.

    Parameters
    ----------
    kinds, units : per state. ranges : lowest and highest states, (nx,) each. rms_u : (nu,) of the inputs.
    input_units : texts.
    """
    found = Forces()
    base = np.array([plant.derivative(x, u) for x, u in points])
    doubled = _with_doubled_parameters(plant, points)
    gain, affine = _gains(plant, points, rms_u)
    forces = [j for j, unit in enumerate(input_units) if unit_kind(unit) in ("force", "torque")]
    speeds = [i for i, kind in enumerate(kinds) if kind == "velocity"]
    pairs = _collocated(gain, speeds, forces)
    driven = _driven(plant, speeds, points, gain)
    for i in speeds:
        trifle = STEPPED * np.max(np.abs(base[:, i])) if plant.dt else 1e-14
        inertia = [k for k, h in doubled.items()
                   if np.any(base[:, i]) and np.allclose(2 * h[:, i], base[:, i], rtol=1e-9, atol=trifle)]
        inputs = [j for j in forces if gain[i, j] != 0 and affine[i, j] and driven[i, j] >= 0] or [
            j for j in range(gain.shape[1]) if driven[i, j] > 0 and affine[i, j]]
        angular = any(KNOWN[s] == "angle" for s in units[i])
        found.units[i] = {"N": 1, "m": 1} if angular else {"N": 1}
        found.inertia_units[i] = {"kg": 1, "m": 2} if angular else {"kg": 1}
        converted = abs(math.prod(factor_of(s) ** n for s, n in units[i].items()) - 1) > 1e-3
        if inertia and not (inputs and converted):  # of a speed in mm/s, force over inertia is not in its unit
            found.entry[i] = (1, i, inertia[0])
            found.mobility[i] = 1.0 / plant.vector()[inertia[0]]
            if not inputs and _is_time_constant(plant, i, inertia[0], points):
                found.units[i], found.inertia_units[i] = units[i], {"s": 1}
            elif converted:  # kg mm/s^2
                found.units[i] = found.inertia_units[i] | units[i] | {"s": units[i].get("s", 0) - 1}
        elif inputs:
            j = pairs.get(i, max(inputs, key=lambda j: abs(gain[i, j])))
            found.entry[i] = (0 if gain[i, j] > 0 else 2, j, -1)
            found.units[i] = parse_unit(input_units[j])
            found.mobility[i] = abs(gain[i, j])
        else:
            found.entry[i] = (1, i, -1)
            found.mobility[i] = 1.0
            found.units[i] = {**units[i], "s": units[i].get("s", 0) - 1}
            found.inertia_units[i] = {}
        rates = [*np.abs(gain[i]) * rms_u, *_by_states(plant, i, ranges), float(np.std(base[:, i])) * 0.3]
        found.scale[i] = max([q for q in rates if np.isfinite(q)] + [1e-12]) / found.mobility[i]
    return found


def _with_doubled_parameters(plant: Plant, points) -> dict[int, np.ndarray]:
    """Rates (points, nx) with each parameter doubled, by its index; those that are zero left out."""
    p, found = plant.vector(), {}
    for k in range(len(p)):
        q = p.copy()
        q[k] *= 2.0
        if q[k] != p[k]:
            found[k] = np.array([plant.derivative(x, u, q) for x, u in points])
    return found


def _gains(plant: Plant, points, rms_u) -> tuple[np.ndarray, np.ndarray]:
    """Mean rate of each state per unit of each input, (nx, nu), and whether it has one sign everywhere."""
    nx, nu, _ = plant.sizes
    gain, affine = np.zeros((nx, nu)), np.ones((nx, nu), dtype=bool)
    for j in range(nu):
        d = np.zeros(nu)
        d[j] = max(rms_u[j], 1e-9)
        columns = np.array([(plant.derivative(x, u + d) - plant.derivative(x, u)) / d[j] for x, u in points])
        gain[:, j] = np.mean(columns, axis=0)
        affine[:, j] = np.all(columns > 1e-12, axis=0) | np.all(columns < -1e-12, axis=0)
    return gain, affine


def _by_states(plant: Plant, i: int, ranges) -> list[float]:
    """Standard deviation of the rate of state i by each state that moves evenly over its range."""
    low, high = ranges
    still, found = np.zeros(plant.sizes[1]), []
    for m in range(len(low)):
        up, down = 0.5 * (low + high), 0.5 * (low + high)
        up[m], down[m] = high[m], low[m]
        found.append(abs(plant.derivative(up, still)[i] - plant.derivative(down, still)[i]) / 3.5)
    return found


def _collocated(gain, speeds, forces) -> dict[int, int]:
    """The input that works on each speed, where coupled inertias let every input accelerate every speed.

    A force and the speed it works on are conjugate: with inputs in that order the accelerations per force are the
    inverse of the inertia matrix, symmetric and positive definite. Empty where no order makes them so.
    """
    n = len(speeds)
    if not 2 <= n <= min(4, len(forces)):
        return {}
    best, found = 0.02, {}
    for order in itertools.permutations(forces, n):
        B = gain[np.ix_(speeds, order)]
        if np.linalg.norm(B - B.T) <= best * np.linalg.norm(B) and np.all(np.linalg.eigvalsh(B + B.T) > 0):
            best, found = np.linalg.norm(B - B.T) / np.linalg.norm(B), dict(zip(speeds, order, strict=True))
    return found


def _driven(plant, speeds, points, gain) -> np.ndarray:
    """Whether each input works on each speed's own coordinate (nx, nu): 1 yes, -1 no, 0 where that does not show.

    With coupled inertias an input accelerates several speeds. The joint it works on is the one whose own damping
    accelerates them all in the same proportion, at every position; at rest nothing else depends on a speed.
    """
    found = np.zeros(gain.shape, dtype=int)
    if len(speeds) < 2:
        return found
    still = [(x.copy(), np.zeros_like(u)) for x, u in points]
    for x, _ in still:
        x[speeds] = 0.0
    base = np.array([plant.derivative(x, u)[speeds] for x, u in still])
    damping = np.array([[plant.derivative(x + np.eye(len(x))[i] * 1e-6, u)[speeds] for x, u in still]
                        for i in speeds]) - base
    for j in range(gain.shape[1]):
        push = np.array([plant.derivative(x, u + np.eye(len(u))[j] * 1e-6)[speeds] for x, u in still]) - base
        if np.sum(np.max(np.abs(push), axis=0) > 1e-9 * np.max(np.abs(push))) < 2:
            continue  # it accelerates one speed only
        for i, own in zip(speeds, damping, strict=True):
            size = np.linalg.norm(own, axis=1) * np.linalg.norm(push, axis=1)
            if np.all(size > 0):
                found[i, j] = 1 if np.all(np.abs(np.sum(own * push, axis=1)) > (1 - 1e-5) * size) else -1
    return found


def _is_time_constant(plant, i, k, points) -> bool:
    """Whether parameter k times the rate of state i is minus the state and more, whatever the other parameters are:
    what acts on it then has the unit of the state."""
    p = plant.vector()
    others = p * (1.1 + 0.1 * np.arange(len(p)))
    others[k] = p[k]
    for q, (x, u) in itertools.product((p, others), points[:4]):
        step = np.zeros(len(x))
        step[i] = 1e-3 * max(abs(x[i]), 1e-3)
        slope = (plant.derivative(x + step, u, q) - plant.derivative(x - step, u, q))[i] / (2 * step[i])
        if not abs(p[k] * slope + 1.0) < 1e-6:
            return False
    return True
