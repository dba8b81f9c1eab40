"""Simulators whose parameters are arguments of build(): ``def build(m=1.0, b=0.2): ... return control.ss(...)``.

A control.StateSpace holds numbers only, so the names of physics survive in the arguments. The simulator is built again
for every set of values; what is compiled has the arithmetic of build() in it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import replace

import control
import numpy as np

from pwaid.mismatch.interconnected import equations
from pwaid.mismatch.plant import Plant, checked, linear_behind, whole_or_real
from pwaid.mismatch.realise import realise
from pwaid.mismatch.symbolic import Symbol

__all__ = ["with_arguments"]

KEPT = 64  # systems that are kept, so that a simulation in Python builds one only


def with_arguments(plant: Plant, build: Callable, free: Sequence[str] | None) -> Plant:
    """The plant with the numbers that build() takes as its parameters, where the user means them.

    They are meant when `free` names one that the simulator itself does not have, or, without `free`, when the
    simulator is linear and its own parameters are matrix entries. Otherwise the plant as it came.
    """
    arguments = _numbers(build)
    if plant.dt:  # what the sampling time is given by stays as it is
        arguments = {n: v for n, v in arguments.items() if v != plant.dt or n in (free or ())}
    unknown = [n for n in free or () if n not in plant.parameters]
    meant = any(n in arguments for n in unknown) if free is not None else bool(plant.linear and arguments)
    if not meant or plant.black_box is not None:
        return plant
    fixed = {n: v for n, v in arguments.items() if n not in (free or ())}
    return whole_or_real(lambda whole: _around(
        plant, build, {n: float(v) for n, v in arguments.items() if n not in whole}), fixed)


def _around(plant: Plant, build: Callable, arguments: dict[str, float]) -> Plant:
    """The plant around build() with these arguments as parameters."""
    own = {} if plant.linear else {n: v for n, v in plant.parameters.items() if n not in arguments}
    known: dict[tuple, tuple] = {}

    def built(params):
        """Update, output and parameters of the system that these values give."""
        values = {n: params[n] for n in arguments}
        key = tuple((id(v.tape), v.node) if isinstance(v, Symbol) else v for v in values.values())
        if key not in known:
            if len(known) >= KEPT:
                known.clear()
            system = _system(build, values)
            known[key] = (*equations(system), getattr(system, "params", None) or {})
        return known[key]

    def update(t, x, u, params):
        move, _, others = built(params)
        return move(t, x, u, {**others, **{n: v for n, v in params.items() if n not in arguments}})

    def output(t, x, u, params):
        _, seen, others = built(params)
        return seen(t, x, u, {**others, **{n: v for n, v in params.items() if n not in arguments}})

    update.runs = output.runs = (build,)
    update.linear = output.linear = plant.linear
    found = Plant(update, output, plant.state_names, plant.input_names, plant.output_names, {**arguments, **own},
                  plant.constants, dt=plant.dt, source=plant.source, linear=plant.linear, arguments=tuple(arguments))
    compiled = checked(found)
    return compiled if compiled.rhs is not None or not plant.linear else _by_matrices(found, build)


def _by_matrices(plant: Plant, build: Callable) -> Plant:
    """A linear plant whose build() cannot be run on symbols: its matrices are taken from build() for every set of
    values, and the compiled forms read their entries."""
    known: dict[bytes, np.ndarray] = {}
    nx, nu, ny = plant.sizes
    count = (nx + ny) * (nx + nu)

    def entries(p) -> np.ndarray:
        """A, B, C and D row by row, one after the other, for these parameters; NaN where build() gives no such."""
        key = np.asarray(p, dtype=float).tobytes()
        if key not in known:
            if len(known) >= KEPT:
                known.clear()
            try:
                system = _system(build, dict(zip(plant.arguments, map(float, p), strict=True)))
                found = np.concatenate([np.ravel(M) for M in (system.A, system.B, system.C, system.D)]).astype(float)
            except Exception as error:  # values that build() refuses count as diverged
                plant.raised.add(f"{type(error).__name__}: {error}")
                found = np.full(count, np.nan)
            known[key] = found if found.size == count else np.full(count, np.nan)
        return known[key]

    rhs, out = linear_behind(len(plant.arguments))
    return replace(plant, rhs=rhs, out=out, entries=entries)


def _system(build: Callable, values: dict):
    """The system that build() gives for these values, a transfer function in state space."""
    system = build(**values)
    return realise(system) if isinstance(system, control.TransferFunction) else system


def _numbers(build: Callable) -> dict[str, int | float]:
    """The arguments of build() whose defaults are numbers."""
    try:
        signature = inspect.signature(build)
    except (TypeError, ValueError):
        return {}
    return {n: p.default for n, p in signature.parameters.items()
            if isinstance(p.default, int | float | np.number) and not isinstance(p.default, bool)}
