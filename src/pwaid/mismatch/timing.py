"""Clocks: does the recording run late against the simulation, does that change from start to end, is it the hold?

The refitted simulation s is compared with the recording y. A shift by τ changes s by about -τ ds/dt, so where the
match is otherwise good the shift is the slope of y - s over -ds/dt; the cross-correlation finds larger ones first.
"""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.nullfit import Problem

__all__ = ["shift_between", "timing_notes"]

ALIKE = 0.9  # correlation at the best lag below which a shift means nothing
GAIN = 0.3  # share of the squared error a shift must remove
PIECE = 0.25  # of a recording, taken at either end


def shift_between(y, s, most: int) -> tuple[float, float, float]:
    """Samples by which y is later than s, the correlation there, and the share of squared error that shift removes.

    The integer part maximises the cross-correlation over ±most lags, the fraction follows from the slope there.
    """
    y, s = y - y.mean(), s - s.mean()
    n = len(y)
    if n < 4 * most + 8 or not (np.ptp(y) > 0 and np.ptp(s) > 0):
        return 0.0, 0.0, 0.0
    inner = slice(most + 1, n - most - 1)
    best, lag = -np.inf, 0
    for k in range(-most, most + 1):
        moved = np.roll(s, k)[inner]
        c = float(y[inner] @ moved) / max(float(np.linalg.norm(y[inner]) * np.linalg.norm(moved)), 1e-300)
        if c > best:
            best, lag = c, k
    moved = np.roll(s, lag)
    slope = np.gradient(moved)[inner]
    moved = moved[inner]
    fraction = -float((y[inner] - moved) @ slope) / max(float(slope @ slope), 1e-300)
    fraction = float(np.clip(fraction, -1.0, 1.0))
    before = float(np.sum((y[inner] - s[inner]) ** 2))
    after = float(np.sum((y[inner] - moved + fraction * slope) ** 2))
    return lag + fraction, best, 1.0 - after / before if before > 0 else 0.0


def timing_notes(problem: Problem) -> list[str]:
    """Warnings about clocks and the hold, in plain words."""
    data, notes = problem.train, []
    for k, name in enumerate(problem.plant.output_names):
        ends, whole = [], []
        for a, b in data.recordings:
            y, s = data.Y[a:b, k], problem.null.Y[a:b, k]
            n = int(PIECE * (b - a))
            most = max(2, min(20, n // 12))
            whole.append(shift_between(y, s, most))
            ends.append((shift_between(y[:n], s[:n], most), shift_between(y[-n:], s[-n:], most), b - a))
        drift = [_drift(first, last, n) for first, last, n in ends]
        if all(d is not None for d in drift) and np.ptp(np.sign(drift)) == 0:
            first, last, n = ends[0]
            notes.append(f"{name} is {first[0] * data.sample_time:.3g} s late against the simulation at the start of "
                         f"{data.names[0]} and {last[0] * data.sample_time:.3g} s at its end: two clocks that run "
                         f"apart by {100 * drift[0]:.2g} %?")
        else:
            shifts = [w[0] for w in whole if w[1] > ALIKE and w[2] > GAIN]
            notes += _constant(name, shifts, len(whole), data.sample_time, problem.settings.first_order_hold)
    return notes


def _drift(first, last, samples: int) -> float | None:
    """Relative speed of the clocks when the shift changes by more than one sample, credibly at both ends."""
    good = min(first[1], last[1]) > ALIKE and max(first[2], last[2]) > GAIN
    change = last[0] - first[0]
    return change / ((1 - PIECE) * samples) if good and abs(change) > 1.0 else None


def _constant(name: str, shifts, count: int, sample_time: float, interpolated: bool) -> list[str]:
    """One shift shared by every recording: half a sample points to the hold, more to a delay."""
    if len(shifts) < count or np.ptp(shifts) > 0.4:
        return []
    shift = float(np.mean(shifts))
    amount = f"{abs(shift):.2g} samples ({abs(shift) * sample_time:.2g} s)"
    if abs(abs(shift) - 0.5) < 0.2:
        if shift < 0 and not interpolated:
            return [f"{name} comes {amount} before its simulation: is the input interpolated between samples? "
                    "then say hold = \"first\""]
        if shift > 0 and interpolated:
            return [f"{name} comes {amount} after its simulation: is the input held between samples? "
                    "then say hold = \"zero\""]
    if shift > 0.3:
        return [f"{name} comes {amount} after its simulation in every recording: a delay, a lag, or late sampling"]
    if shift < -0.3:
        return [f"{name} comes {amount} before its simulation in every recording: no cause can do that; check which "
                "sample of input and output belong together"]
    return []
