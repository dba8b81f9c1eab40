"""Where the mismatch sits in time and in frequency, from the residual of the refitted simulator."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np

from pwaid.mismatch.nullfit import Problem

__all__ = ["Location", "bands", "intervals", "locate"]


@dataclass(frozen=True)
class Location:
    """Channel, responsible variables with breakpoints, memory flag, intervals (s) and bands (Hz)."""

    channel: str = ""
    variables: tuple[str, ...] = ()
    breakpoints: dict[str, list[float]] = field(default_factory=dict)
    memory: bool = False
    intervals_s: tuple[tuple[float, float], ...] = ()
    bands_hz: tuple[tuple[float, float], ...] = ()


def intervals(problem: Problem, share: float = 0.8, pieces: int = 40):
    """The fewest stretches of the first training recording that hold `share` of the squared residual."""
    data = problem.train
    a, b = data.recordings[0]
    r = np.sum((problem.null.residual(data)[a:b] / problem.sigma) ** 2, axis=1)
    edges = np.linspace(0, b - a, min(pieces, b - a) + 1).astype(int)
    energy = np.array([r[i:j].sum() for i, j in itertools.pairwise(edges)])
    order = np.argsort(energy)[::-1]
    keep = np.zeros(len(energy), dtype=bool)
    keep[order[:int(np.searchsorted(np.cumsum(energy[order]), share * energy.sum())) + 1]] = True
    found, k = [], 0
    while k < len(keep):
        if keep[k]:
            m = k
            while m + 1 < len(keep) and keep[m + 1]:
                m += 1
            found.append((float(edges[k] * data.sample_time), float(edges[m + 1] * data.sample_time)))
            k = m
        k += 1
    return tuple(found)


def bands(problem: Problem, share: float = 0.8):
    """The narrowest frequency band that holds `share` of the residual's power."""
    data = problem.train
    a, b = data.recordings[0]
    r = (problem.null.residual(data)[a:b] / problem.sigma)
    power = np.sum(np.abs(np.fft.rfft((r - r.mean(0)) * np.hanning(b - a)[:, None], axis=0)) ** 2, axis=1)
    f = np.fft.rfftfreq(b - a, data.sample_time)
    c = np.concatenate([[0.0], np.cumsum(power)])
    if c[-1] <= 0:
        return ()
    ends = np.searchsorted(c, c[:-1] + share * c[-1])
    good = ends < len(c)
    starts = np.arange(len(f))[good]
    k = int(np.argmin(ends[good] - starts))
    return ((float(f[starts[k]]), float(f[min(ends[good][k], len(f) - 1)])),)


def locate(problem: Problem) -> Location:
    """Time and frequency of the mismatch."""
    return Location(intervals_s=intervals(problem), bands_hz=bands(problem))
