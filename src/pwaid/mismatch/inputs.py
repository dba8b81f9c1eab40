"""Inputs that an engineer would record next, within the range of those already recorded."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.summary import number

__all__ = ["Proposal", "proposals"]

SAMPLES = 4000
LEVELS = (1.0, 0.4)  # shares of the recorded amplitude


@dataclass(frozen=True)
class Proposal:
    """An input to record: `U` (N, nu), held between samples, and what it is in words."""

    kind: str
    signal: str
    words: str
    U: np.ndarray = field(repr=False)
    amplitude: float
    period: float | None
    duration: float


@dataclass(frozen=True)
class _Channel:
    """One input channel: where its recorded range has its middle, how far it reaches, and its unit."""

    index: int
    name: str
    unit: str
    centre: float
    reach: float

    def size(self, amplitude: float) -> str:
        text = f"{number(amplitude)} {self.unit}".rstrip()
        return text if self.centre == 0.0 else f"{text} around {number(self.centre)} {self.unit}".rstrip()


def _channel(data: Dataset, j: int, name: str, unit: str) -> _Channel | None:
    low, high = float(data.U[:, j].min()), float(data.U[:, j].max())
    if not high > low:
        return None
    two_sided = low < 0 < high and min(-low, high) > 0.2 * max(-low, high)
    centre = 0.0 if two_sided else 0.5 * (low + high)
    return _Channel(j, name, unit, centre, min(high - centre, centre - low))


def _rest(data: Dataset) -> np.ndarray:
    """What the other channels do meanwhile: zero where that was recorded, their middle elsewhere."""
    low, high = data.U.min(axis=0), data.U.max(axis=0)
    return np.where((low <= 0) & (high >= 0), 0.0, 0.5 * (low + high))


def _top_frequency(u, h: float) -> float:
    """The frequency below which 90 % of the recorded input's power lies."""
    power = np.abs(np.fft.rfft(u - u.mean())) ** 2
    if not power.sum() > 0:
        return 0.1 / h
    k = int(np.searchsorted(np.cumsum(power), 0.9 * power.sum()))
    return max(k, 4) / (len(u) * h)


def _shapes(t: np.ndarray, top: float):
    """(kind, words with {size}, period, shape in [-1, 1]) of the designed inputs."""
    length = float(t[-1] + t[1])
    for cycles in (2, 6):
        period = length / cycles
        s = np.mod(t / period + 0.25, 1.0)
        yield ("slow triangle" if cycles == 2 else "triangle", "a triangle of {size} and a period of "
               f"{number(period)} s", period, 1.0 - 4.0 * np.abs(s - 0.5))
    lines = np.unique(np.round(np.linspace(1, max(2.0, top * length / 2), 10))).astype(int)
    angle = -np.pi * np.arange(len(lines)) ** 2 / len(lines)  # Schroeder's phases keep the crest low
    wave = np.sum(np.cos(2 * np.pi * np.outer(t, lines) * 2 / length + angle), axis=1)
    wave = wave / np.max(np.abs(wave))
    yield ("two amplitudes of one multisine", f"a multisine up to {number(lines[-1] * 2 / length)} Hz, first at half "
           "amplitude, then with {size}", length / 2, wave * np.where(t < length / 2, 0.5, 1.0))
    yield ("step, hold, reverse", "steps of {size}, held and reversed every " f"{number(length / 4)} s", length / 2,
           np.where(np.mod(t, length / 2) < length / 4, 1.0, -1.0))
    yield ("coast down", "{size} for " f"{number(length / 5)} s, then nothing: let it coast", None,
           np.where(t < length / 5, 1.0, 0.0))


def proposals(data: Dataset, names, units, most: int = SAMPLES) -> list[Proposal]:
    """Candidate inputs of every channel, each as long as the first recording and inside the recorded range.

    Parameters
    ----------
    names, units : of the input channels.
    most : samples of a proposal.
    """
    a, b = data.recordings[0]
    n, h, found = int(min(b - a, most)), data.sample_time, []
    t = np.arange(n) * h
    low, high = data.U.min(axis=0), data.U.max(axis=0)
    for j, name in enumerate(names):
        c = _channel(data, j, name, units[j])
        if c is None:
            continue
        recorded = data.U[a:a + n]

        def add(kind, words, u, amplitude, period, whole=None, c=c):
            U = np.tile(_rest(data), (n, 1)) if whole is None else whole.copy()
            U[:, c.index] = u
            tiny = 1e-9 * (high - low)
            if not (np.any(low - tiny > U) or np.any(high + tiny < U)):
                found.append(Proposal(kind, c.name, f"{words} on {c.name}", np.ascontiguousarray(U), amplitude, period,
                                      n * h))

        for kind, words, period, shape in _shapes(t, _top_frequency(recorded[:, j], h)):
            for level in LEVELS:
                size = level * c.reach
                add(kind, words.format(size=c.size(size)), c.centre + size * shape, size, period)
        swing = recorded[:, j] - c.centre
        for factor, word in ((0.5, "half"), (2.0, "double")):
            size = factor * float(np.max(np.abs(swing)))
            add(f"recorded input at {word} amplitude", f"the recorded input at {word} amplitude ({c.size(size)})",
                c.centre + factor * swing, size, None, recorded)
        bias = 0.4 * c.reach
        add("bias and recorded input", f"the recorded input at half amplitude on a constant {number(c.centre + bias)} "
            f"{c.unit}".rstrip(), c.centre + 0.5 * swing + bias, 0.5 * float(np.max(np.abs(swing))), None, recorded)
    return found
