"""What an effect is: a law, where it may enter, how large it can be, and what separates it from others.

An effect's kernel is one function called by the engine (see `pwaid.mismatch.engine`) with

    kernel(phase, t, h, x, xs, u, p, dx, ii, q)

`q` holds its parameters in the order of `Effect.quantities`, followed by the place's constants, and
`ii` holds integers that say where it acts:

== ==================================================================================
ii meaning
== ==================================================================================
0  index of its first extra state
1  how a force enters: 0 through input ii[2], 2 against it, where that input counts the
   other way, 1 on derivative ii[2] divided by p[ii[3]]
2  the input or the state equation the force enters
3  position of the inertia in p, or -1 (then the force is per unit inertia)
4  state index of the velocity (or of the stored quantity: level, temperature, ...)
5  state index of the position, or -1
6  a second velocity or stored quantity, or -1
7  output index; between two bodies, how the force on the second one enters, as 1
8  input index; between two bodies, what that force enters, as 2
9  a second position, or -1
10 a variant of the law
11 between two bodies, the inertia of the second one, as 3; else what a law makes of it
== ==================================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numba import njit

from pwaid.errors import InputError
from pwaid.mismatch.engine import EFFECT_SIGNATURE
from pwaid.mismatch.units import combine

__all__ = ["Effect", "Place", "Quantity", "push", "react", "scale_of", "slide", "unit_of"]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _enter(phase, force, mode, target, inertia, u, p, dx):
    """Add a force to an input (mode 0), against it (2), or to a rate, over an inertia where there is one (1)."""
    if mode != 1:
        if phase == 1:
            u[target] += force if mode == 0 else -force
    elif phase == 2:
        if inertia >= 0:
            dx[target] += force / p[inertia]
        else:
            dx[target] += force


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def push(phase, force, ii, u, p, dx):
    """Add a force at the place ii describes, in phases 1 (through an input) and 2 (on a derivative)."""
    _enter(phase, force, ii[1], ii[2], ii[3], u, p, dx)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def react(phase, force, ii, u, p, dx):
    """The same for the second of two bodies."""
    _enter(phase, force, ii[7], ii[8], ii[11], u, p, dx)


@njit(cache=True, nogil=True, error_model="numpy")
def slide(phase, level, ii, h, x, xs, dx):
    """Dry friction of the given level on the velocity x[ii[4]].

    Phase 5, sliding: a force against the motion that the substep began with, added to dx; xs holds the mobility column
    turned that way.
    Phase 4, near rest: a proximal step on the velocity, which sticks exactly; dx holds the mobility column.
    """
    i = ii[4]
    if phase == 5:
        for k in range(xs.size if xs[i] != 0.0 else 0):
            dx[k] -= level * xs[k]
        return
    v, g = x[i], dx[i]
    if g == 0.0:
        return
    reach = h * abs(g) * max(level, 0.0)
    new = v - reach if v > reach else (v + reach if v < -reach else 0.0)
    impulse = (new - v) / g
    for k in range(dx.size):
        x[k] += dx[k] * impulse
    x[i] = new  # exactly, so that rest is recognised as rest


@dataclass(frozen=True)
class Quantity:
    """One parameter of a law.

    `size` says what sets its scale and unit (``"force/speed^2"``); `low`, `high` and `probes` are
    multiples of that scale; `log` parameters are positive and fitted on a logarithmic axis. A size that
    ends in ``_level`` is a threshold: its value is origin + multiple * span of the place's range.
    """

    name: str
    size: str
    low: float
    high: float
    probes: tuple[float, ...]
    log: bool = True
    neutral: float = 0.0


@dataclass(frozen=True)
class Place:
    """Where an effect enters one particular simulator, with the scales and units met there."""

    kind: str
    signal: str
    variables: tuple[str, ...]
    ii: tuple[int, ...]
    scales: Mapping[str, float]
    units: Mapping[str, Mapping[str, int]]
    constants: tuple[float, ...] = ()
    levels: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    note: str = ""

    @property
    def channel(self) -> str:
        return f"{self.kind}:{self.signal}"


@dataclass(frozen=True)
class Effect:
    """One piece of physics that a simulator may have left out.

    `reshapes`: it changes what forces accelerate, so it acts after them and has a phase 6 for mobility columns.
    `start`: of its extra states: "zero"; "input", what the input has been; its first one like the store it hangs on, or
    zero, and fitted in every segment: "stored", "free".
    `between`: it acts between two bodies, and depends on how one moves against the other.
    `contains`: laws that it is with some parameters, so that they make no pair with it.
    `becomes`: laws that it comes to at the ends of its parameters or at small amplitudes, and that may stand beside it.
    `inherit`: by id, the parameters of such a law from its own, where their names do not tell.
    `variant`: what tells it from another law of the same id that may act at the same place.
    """

    id: str
    family: str
    law: str
    quantities: tuple[Quantity, ...]
    kernel: Callable
    places: Callable
    confused_with: tuple[str, ...] = ()
    separated_by: str = ""
    extra_states: int = 0
    proximal: bool = False
    contains: tuple[str, ...] = ()
    becomes: tuple[str, ...] = ()
    inherit: Mapping[str, Callable] = field(default_factory=dict, compare=False)
    memory: bool = False
    dissipative: bool = False
    delays: bool = False
    reshapes: bool = False
    between: bool = False
    start: str = "zero"
    variant: str = ""
    cached: bool = field(default=True, repr=False)

    def compiled(self):
        """The kernel compiled for the engine."""
        return _compile(self.kernel, self.cached)


@cache
def _compile(kernel, cached):
    return njit(EFFECT_SIGNATURE, cache=cached, nogil=True, error_model="numpy")(kernel)


def _factors(size: str):
    up, _, down = size.partition("/")
    for text, sign in ((up, 1), (down, -1)):
        for token in text.split("*"):
            if token and token != "1":
                name, _, power = token.partition("^")
                yield name, sign * (float(power) if "." in power else int(power or 1))


def scale_of(size: str, place: Place) -> float:
    """The scale of a quantity at a place, e.g. force/speed² from the forces and speeds met there."""
    if size.endswith("_level"):
        return place.levels[size.removesuffix("_level")][1]
    value = 1.0
    for name, power in _factors(size):
        if name not in place.scales:
            raise InputError(f"the place {place.channel} has no scale {name!r}; it has {sorted(place.scales)}")
        value *= place.scales[name] ** power
    return float(value) if np.isfinite(value) and value > 0 else 1.0


def unit_of(size: str, place: Place) -> str:
    """The unit of a quantity at a place."""
    size = size.removesuffix("_level")
    return combine({}, *[(dict(place.units.get(name, {})), power) for name, power in _factors(size)])
