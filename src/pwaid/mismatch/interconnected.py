"""The equations of a control system as two functions that can be run on symbols, interconnected systems included.

python-control propagates signals through feedthrough by comparing numbers until they no longer change; here they are
propagated as often as the longest chain of systems can need.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import control
import numpy as np

from pwaid.errors import InputError

__all__ = ["equations", "equations_of_parts"]


def equations(system) -> tuple[Callable, Callable]:
    """Update and output ``f(t, x, u, params)`` of a nonlinear, a linear or an interconnected system."""
    if isinstance(system, control.InterconnectedSystem):
        return equations_of_parts(system)
    if not hasattr(system, "A"):
        return system.updfcn, system.outfcn or (lambda t, x, u, params: x)

    def move(t, x, u, params):
        return system.A @ x + system.B @ u

    def seen(t, x, u, params):
        return system.C @ x + system.D @ u

    return move, seen


def equations_of_parts(system: control.InterconnectedSystem) -> tuple[Callable, Callable]:
    """The same of a system made by interconnect, feedback, series or a block algebra.

    Raises
    ------
    InputError
        When signals do not settle: an algebraic loop.
    """
    blocks = [(equations(block), block) for block in system.syslist]
    connect, entering, leaving = (np.asarray(m) for m in (system.connect_map, system.input_map, system.output_map))
    states = _slices([block.nstates for _, block in blocks])
    inputs = _slices([block.ninputs for _, block in blocks])

    def values(block, params):
        return {**(block.params or {}), **(system.params or {}), **params}

    def signals(t, x, u, params):
        into = entering @ u
        for _ in range(len(blocks) + 1):
            out = np.concatenate([
                np.asarray(output(t, x[a], into[b], values(block, params))).ravel()
                for ((_, output), block), a, b in zip(blocks, states, inputs, strict=True)])
            new = connect @ out + entering @ u
            if all(_same(a, b) for a, b in zip(new, into, strict=True)):
                return into, out
            into = new
        raise InputError("the simulator has an algebraic loop: some block's output depends on itself without delay; "
                         "solve that equation in one block, or put a lag into the loop")

    def update(t, x, u, params):
        into, _ = signals(t, x, u, params)
        rates = [np.asarray(move(t, x[a], into[b], values(block, params))).ravel()
                 for ((move, _), block), a, b in zip(blocks, states, inputs, strict=True) if block.nstates]
        return np.concatenate(rates)

    def output(t, x, u, params):
        into, out = signals(t, x, u, params)
        return leaving @ np.concatenate([out, into])

    try:
        signals(0.0, np.full(system.nstates, 0.1), np.ones(system.ninputs), {})
    except InputError:
        raise
    except (ArithmeticError, ValueError):  # of a block outside its domain: not asked here
        pass
    update.runs = output.runs = tuple(f for pair, _ in blocks for f in pair)
    return update, output


def _slices(counts) -> list[slice]:
    ends = np.cumsum([0, *counts])
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]


def _same(a, b) -> bool:
    """Whether two signals are one number, or one operation on symbols."""
    return a is b or (hasattr(a, "node") and getattr(b, "node", None) == a.node) or (
        not hasattr(a, "node") and not hasattr(b, "node") and bool(a == b))
