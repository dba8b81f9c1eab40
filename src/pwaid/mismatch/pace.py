"""How fast a simulator moves: eigenvalues along the recordings, substeps that resolve them, lengths of segments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.floor import white_level
from pwaid.mismatch.model import LIMIT, Model
from pwaid.mismatch.plant import Plant

__all__ = ["UNSTABLE", "eigenvalues", "segment_length", "sliding_substeps", "substeps_of"]

UNSTABLE = 4.0  # growth over a recording, in time constants, that no start state can follow
SLIDING, MOST = 1.5, 8  # times the fastest time constant: a step that dry friction is stable with; substeps at most


def eigenvalues(plant: Plant, states, inputs) -> tuple[float, float]:
    """Largest real part and largest modulus of the linearisation's eigenvalues (per second), medians over visited
    points."""
    found = []
    if plant.black_box is not None or not plant.sizes[0]:
        return -np.inf, 0.0  # nothing that pwaid could restart in the middle of a recording
    rng = np.random.default_rng(0)
    for k in rng.integers(0, len(states), 8):
        x, u = states[k], inputs[k]
        n = len(x)
        J = np.empty((n, n))
        for i in range(n):
            d = 1e-5 * max(np.max(np.abs(states[:, i])), 1e-6)
            up, dn = x.copy(), x.copy()
            up[i] += d
            dn[i] -= d
            J[:, i] = (plant.derivative(up, u) - plant.derivative(dn, u)) / (2 * d)
        if not np.all(np.isfinite(J)):
            continue
        eigenvalues = np.linalg.eigvals(J)
        if plant.dt:
            eigenvalues = np.log(np.maximum(np.abs(1 + plant.dt * eigenvalues), 1e-12)) / plant.dt
        found.append((np.max(eigenvalues.real), np.max(np.abs(eigenvalues))))
    growth, fastest = np.median(found, axis=0) if found else (0.0, 0.0)
    return float(growth), float(fastest)


def sliding_substeps(plant: Plant, fastest: float, sample_time: float) -> int:
    """Substeps per sample with which dry friction is stable beside the fastest eigenvalue (per second)."""
    return 1 if plant.dt else int(np.clip(np.ceil(fastest * sample_time / SLIDING), 1, MOST))


def substeps_of(model: Model, theta, X0, data: Dataset) -> int:
    """Substeps per sample for which halving the step changes the outputs by less than the noise."""
    if model.settings.plant.dt:
        return 1
    span = np.ptp(data.Y, axis=0) + 1e-12
    noise = np.array([white_level(data.Y[:, k], 4) for k in range(data.Y.shape[1])])
    allowed = np.clip(0.05 * noise, 2e-5 * span, 5e-4 * span)
    short = replace(data, segments=data.segments.copy())
    S, previous = 1, None
    while S <= 32:
        Y, _ = Model(model.settings, model.located, S).simulate(theta, X0, short)
        same = previous is not None and np.all(np.sqrt(np.mean((Y - previous) ** 2, axis=0)) < allowed)
        if same and np.all(np.abs(Y) < LIMIT):
            return S // 2
        previous = Y
        S *= 2
    return 8


def segment_length(growth: float, samples: int, sample_time: float, time_scale: float) -> int:
    """Samples per segment: whole recordings when stable, a few time constants when unstable or integrating.

    `growth` is the largest real part of the eigenvalues, per second.
    """
    length = samples * sample_time
    if growth * length > UNSTABLE:
        return int(max(30, 2.5 / growth / sample_time))
    if growth * length > -0.7:  # integrating: errors pile up over the whole recording
        return int(max(200, min(samples, 12 * time_scale / sample_time)))
    return samples
