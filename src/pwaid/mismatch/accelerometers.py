"""Outputs that show the rate of a state: accelerometers, and every other reading of a right-hand side."""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.structure import Structure, on_line

__all__ = ["rates_shown"]


def rates_shown(s: Structure) -> tuple[np.ndarray, np.ndarray]:
    """The speed whose rate each output shows, -1 for none, and the output per rate, both (ny,).

    The simulator computes such an output from forces that it knows; a law that is left out must be added to it, or the
    output would contradict the motion.
    """
    ny = len(s.plant.output_names)
    shown, gain = np.full(ny, -1, dtype=np.int64), np.zeros(ny)
    if s.plant.black_box is not None or s.plant.dt:
        return shown, gain
    points = s.points(12)
    rates, outputs = (np.array([f(x, u) for x, u in points]) for f in (s.plant.derivative, s.plant.outputs))
    for k in range(ny):
        for v in s.velocities() if s.output_state[k] < 0 else ():
            line = on_line(rates[:, v], outputs[:, k])
            if line is not None:
                shown[k], gain[k] = v, line[0]
    return shown, gain
