"""Outputs that show the rate of a state: accelerometers, and load cells under a body."""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.structure import Structure, on_line, weights_of
from pwaid.mismatch.units import combine, unit_kind

__all__ = ["rates_shown"]


def rates_shown(s: Structure) -> tuple[tuple[int, int, float], ...]:
    """Output, speed and output per rate, for every output that shows the rate of a speed.

    The simulator computes such an output from forces that it knows; a law that is left out must be added to it, or the
    output would contradict the motion. A load cell between a body and the ground shows what the inputs push with less
    mass times acceleration. So may the force in a shaft, or mass times acceleration of what it drives, but what acts on
    either body does not go through the shaft: a force without an input in it, or that depends on another body, shows no
    rate.
    """
    if s.plant.black_box is not None or s.plant.dt:
        return ()
    points, found = s.points(16), []
    rates, outputs = (np.array([f(x, u) for x, u in points]) for f in (s.plant.derivative, s.plant.outputs))
    inputs = np.array([u for _, u in points]).reshape(len(points), -1)
    for k in (k for k, state in enumerate(s.output_state) if state < 0):
        force = unit_kind(combine({}, (dict(s.output_units[k]), 1))) in ("force", "torque")
        for v in s.velocities():
            if force:
                gain = 0.0 if _of_others(s, v, k) else _reaction(s, v, rates[:, v], inputs, outputs[:, k])
            else:
                gain = _slope(rates[:, v], outputs[:, k])
            if gain:
                found.append((k, v, gain))
                break  # of two in proportion one will do
    return tuple(found)


def _slope(rate, y) -> float:
    """Output per rate where one follows from the other; 0 where it does not."""
    line = on_line(rate, y)
    return line[0] if line is not None else 0.0


def _of_others(s: Structure, v: int, k: int) -> bool:
    """Whether output k changes with a state besides speed v and its position."""
    x, u = s.points(1)[0]
    before = s.plant.outputs(x, u)[k]
    for i in set(range(len(x))) - {v, s.position_of(v)}:
        moved = x.copy()
        moved[i] += 0.1 * s.reach(i)
        if abs(s.plant.outputs(moved, u)[k] - before) > 1e-9 * abs(before):
            return True
    return False


def _reaction(s: Structure, v: int, rate, inputs, y) -> float:
    """Output per rate where the output is that and inputs, both of them; 0 where it is not.

    A law that enters through an input would count as pushed from outside, so only rates with an inertia do; it must be
    trusted, since the output per rate is that inertia.
    """
    mode, _, inertia = s.entry[v]
    if mode != 1 or (inertia >= 0 and list(s.plant.parameters)[inertia] in s.free):
        return 0.0
    columns = np.column_stack([rate, inputs, np.ones(len(rate))])
    if np.linalg.matrix_rank(columns) < columns.shape[1]:
        return 0.0
    weights = weights_of(columns, y, trifle=1e-9)
    if weights is None:
        return 0.0
    size = np.max(np.abs(columns * weights), axis=0)
    seen = size[0] > 1e-6 * np.max(size) and np.any(size[1:-1] > 1e-6 * np.max(size))
    return float(weights[0]) if seen else 0.0
