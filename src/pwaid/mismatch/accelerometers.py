"""Outputs that show the rate of a state: accelerometers, and every other reading of a right-hand side."""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.structure import Structure, on_line

__all__ = ["rates_shown"]


def rates_shown(s: Structure) -> tuple[tuple[int, int, float], ...]:
    """Output, speed and output per rate, for every output that shows the rate of a speed.

    The simulator computes such an output from forces that it knows; a law that is left out must be added to it, or the
    output would contradict the motion.
    """
    if s.plant.black_box is not None or s.plant.dt:
        return ()
    points, found = s.points(12), []
    rates, outputs = (np.array([f(x, u) for x, u in points]) for f in (s.plant.derivative, s.plant.outputs))
    for k in (k for k, state in enumerate(s.output_state) if state < 0):
        lines = ((v, on_line(rates[:, v], outputs[:, k])) for v in s.velocities())
        found += [(k, v, line[0]) for v, line in lines if line is not None][:1]  # of two in proportion one will do
    return tuple(found)
