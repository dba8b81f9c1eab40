"""Where a simulation may begin: start states from the first samples of a recording, and from which a plant runs."""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.model import LIMIT
from pwaid.mismatch.plant import Plant

__all__ = ["OPENING", "first_states", "usable_starts"]

OPENING = 12  # samples that show where a segment begins


def first_states(plant: Plant, structure_map, data: Dataset) -> np.ndarray:
    """Start states from the outputs: measured states from the first samples, speeds from their slope."""
    shown, partner, ratio, units = structure_map
    output_state = shown.state
    nx = plant.sizes[0]
    X0 = np.zeros((len(data.segments), nx))
    for g, (a, b) in enumerate(data.segments[:, :2]):
        m = int(min(b - a, OPENING))
        tt = np.arange(m) * data.sample_time
        for k, i in enumerate(output_state):
            if i < 0:
                continue
            measured = shown.state_of(k, data.Y[a:a + m, k])
            slope, level = np.polyfit(tt, measured, 1) if m > 2 else (0.0, measured[0])
            X0[g, i] = level
            j = partner[i]
            if j >= 0 and j not in output_state:
                X0[g, j] = slope / ratio[i]
        for i in range(nx):  # an unmeasured position starts with the first measured one of its unit
            if partner[i] >= 0 and i not in output_state:
                alike = [k for k, s in enumerate(output_state) if s >= 0 and partner[s] >= 0 and units[s] == units[i]]
                X0[g, i] = X0[g, output_state[alike[0]]] if alike else 0.0
    return X0


def usable_starts(model, theta, data: Dataset, mapping):
    """Start states from which the plant can be simulated."""
    X0 = first_states(model.settings.plant, mapping, data)
    if model.settings.plant.linear:
        return X0
    Y, _ = model.simulate(theta, X0, data)
    if np.all(np.isfinite(Y)) and np.all(np.abs(Y) < LIMIT):
        return X0
    return _positive_start(model.settings.plant, X0, data)


def _positive_start(plant, X0, data):
    """Stores that start at zero sit at a corner of a square root: lift them to the mean output."""
    lifted = X0.copy()
    for i in range(X0.shape[1]):
        if np.all(lifted[:, i] == 0.0):
            lifted[:, i] = np.mean(np.abs(data.Y[0])) if data.Y.size else 0.0
    return lifted
