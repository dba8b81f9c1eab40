"""The noise floor: what no model could explain, from the most trustworthy source at hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Floor", "estimate_floor", "white_level"]

LOUD = 0.87  # of the level is rounding alone: the noise under it is smaller than half of it

_GAIN = {1: 2.0, 2: 6.0, 3: 20.0, 4: 70.0}  # variance of the k-th difference of unit white noise


@dataclass(frozen=True)
class Floor:
    """Noise level per output (ny,), its source, whether it includes run-to-run disturbance; whether it comes of
    repeats alone; the step of readings whose level may be that of their rounding, 0 for the others (ny,); and why it
    was put down where a law stays below it (`pwaid.mismatch.evidence`)."""

    level: np.ndarray
    source: str
    trusted: bool
    repeated: bool = False
    rounding: np.ndarray | None = None
    beaten: str = ""


def white_level(signal, order: int = 3) -> float:
    """Standard deviation of the white part of a sampled signal, from its differences (robust to spikes)."""
    d = np.diff(np.asarray(signal, dtype=float), n=order)
    if d.size < 10:
        return 0.0
    return float(np.median(np.abs(d)) / 0.6745 / np.sqrt(_GAIN[order]))


def _step(signal) -> float:
    """The step of a rounded signal: what its distinct values are multiples apart of; 0 where they are not."""
    values = np.unique(signal)
    apart = np.diff(values)
    apart = apart[apart > 1e-6 * np.max(apart, initial=0.0)]
    if len(apart) < 4 or 4 * len(apart) > len(signal):
        return 0.0
    step = float(np.min(apart))
    return step if np.all(np.abs(apart / step - np.round(apart / step)) < 1e-2) else 0.0


def estimate_floor(residual, outputs, segments, output_names: Sequence[str],
                   given: Mapping[str, float] | None = None,
                   repeats: Sequence[Sequence[np.ndarray]] = ()) -> Floor:
    """The floor of every output.

    Parameters
    ----------
    residual, outputs : (N, ny) of the nominal simulation and of the recording.
    segments : (n, 4) rows of first, last+1 sample.
    given : level per output name, trusted.
    repeats : groups of (N, ny) arrays, what a simulation leaves of outputs recorded under the same input.
    """
    ny = outputs.shape[1]
    if given and all(n in given for n in output_names):
        return Floor(np.array([float(given[n]) for n in output_names]), "given", True)
    level, source, trusted = np.zeros(ny), "high-frequency part of the residual (estimated)", False
    rounding = np.array([_step(outputs[:, k]) for k in range(ny)])
    for k in range(ny):
        parts = []
        for a, b in segments[:, :2]:
            parts.append(min(white_level(residual[a:b, k], 3), white_level(outputs[a:b, k], 4) * 1.2))
        level[k] = float(np.median(parts)) if parts else 0.0
        level[k] = level[k] or rounding[k] / np.sqrt(12.0)
    spread = []
    for group in repeats:
        n = min(len(y) for y in group)
        skip = n // 10
        stack = np.array([y[skip:n] for y in group])
        spread.append(np.mean(np.var(stack, axis=0, ddof=1), axis=0))
    if spread:
        level, source, trusted = np.sqrt(np.mean(spread, axis=0)), "repeated recordings", True
    if given:
        for k, name in enumerate(output_names):
            if name in given:
                level[k] = float(given[name])
                source = f"given for {', '.join(given)}; otherwise {source}"
    rounding[rounding / np.sqrt(12.0) < LOUD * level] = 0.0
    return Floor(level, source, trusted, bool(spread) and not given, None if spread or given else rounding)
