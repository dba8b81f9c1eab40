"""Where the mismatch sits: in time, in frequency, at which channel, and over which variable.

Time and frequency come from the residual of the refitted simulator, the channel from the likelihood of an
unknown input there (`pwaid.mismatch.smoother`), the variable from hinges (`pwaid.mismatch.microscope`), two
variables from a map over both (`pwaid.mismatch.pairmap`).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace

import numpy as np

from pwaid.mismatch.microscope import Shape, examine
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.pairmap import PairShape, examine_pairs
from pwaid.mismatch.smoother import Linearised, Unknown, linearise, unknown_inputs

__all__ = ["Location", "bands", "candidates", "intervals", "locate"]


ALIKE = 3.0  # channels whose log-likelihoods differ by less cannot be told apart


@dataclass(frozen=True)
class Location:
    """Channel, responsible variables with breakpoints, memory flag, intervals (s) and bands (Hz).

    `alike`: channels that cannot be told apart from `channel`. `unknown`, `shape`, `samples`: the unknown
    input there, what the microscope saw, and the responsible variable's samples; None where not looked at. `pair`:
    the map over two variables, where one does not suffice.
    """

    channel: str = ""
    variables: tuple[str, ...] = ()
    breakpoints: dict[str, list[float]] = field(default_factory=dict)
    memory: bool = False
    intervals_s: tuple[tuple[float, float], ...] = ()
    bands_hz: tuple[tuple[float, float], ...] = ()
    alike: tuple[str, ...] = ()
    unknown: Unknown | None = None
    shape: Shape | None = None
    samples: np.ndarray | None = field(default=None, repr=False)
    pair: PairShape | None = field(default=None, repr=False)


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


def _rates(z, line: Linearised) -> np.ndarray:
    """dz/dt within every segment."""
    return np.concatenate([np.gradient(z[a:b], line.h) for a, b in line.segments])


def candidates(problem: Problem, line: Linearised, unknown: Unknown) -> dict[str, np.ndarray]:
    """The variables a law may depend on: smoothed states, inputs, their rates, and time."""
    plant = problem.plant
    found = {n: unknown.states[:, i] for i, n in enumerate(plant.state_names)}
    inputs = {n: line.inputs[:, j] for j, n in enumerate(plant.input_names)}
    rates = {f"d{n}/dt": _rates(u, line) for n, u in inputs.items()}
    return found | inputs | rates | {"t": line.time}


def locate(problem: Problem, channel: str = "", look: bool = True) -> Location:
    """Where the mismatch sits.

    Parameters
    ----------
    channel : where the named effect enters; the most likely place of an unknown input otherwise.
    look : False leaves out channel and variable, where there is nothing to explain.
    """
    place = Location(intervals_s=intervals(problem), bands_hz=bands(problem))
    line = linearise(problem) if look else None
    found = unknown_inputs(problem, line) if line is not None else []
    if not found:
        return place
    unknown = next((u for u in found if u.channel == channel), found[0])
    variables, shape, pair = _look(problem, line, unknown)
    if not shape.variable and pair is None and unknown is not found[0]:  # nothing to see there: the likeliest place
        unknown = found[0]
        variables, shape, pair = _look(problem, line, unknown)
    alike = tuple(u.channel for u in found if u.channel in unknown.same or (
        u is not unknown and abs(u.log_likelihood - unknown.log_likelihood) < ALIKE))
    named = (shape.variable,) if shape.variable else pair.variables if pair else ()
    single = named if shape.variable else ()
    return replace(place, channel=unknown.channel, variables=named, memory=shape.memory, alike=alike, unknown=unknown,
                   breakpoints={v: [b.position for b in shape.bends] for v in single}, shape=shape,
                   samples=variables[shape.variable] if single else None, pair=pair)


def _look(problem: Problem, line: Linearised, unknown: Unknown):
    """The candidate variables, what the microscope sees over one of them, and over two."""
    variables = candidates(problem, line, unknown)
    slopes = {n: _rates(z, line) for n, z in variables.items() if n != "t"}
    rise = {n: 2 * unknown.rise * float(np.quantile(np.abs(s), 0.75)) for n, s in slopes.items()}
    shape = examine(unknown.value, unknown.deviation, variables, slopes, rise)
    pair = examine_pairs(unknown.value, unknown.deviation, variables, shape.variable, shape.gain)
    return variables, shape, pair
