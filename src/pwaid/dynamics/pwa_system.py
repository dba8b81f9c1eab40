"""Continuous-time piecewise-affine systems in the form of Yamada, Ruderman and Fujimoto, equations (6)-(8).

ẋ = A_i x + a_i + B_i u and y = C_i x + c_i + D_i u while G_i x + H_i u + g_i ≥ 0, with closed polyhedral
cells whose interiors are disjoint. Inputs are held between samples. Simulation is exact to rounding between
crossings, crossings are located, and none is missed (`flow`, `events`). What a motion does on a border is
decided by the flow just after.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pwaid.dynamics.cell import Cell
from pwaid.dynamics.pwa_borders import Border, find_borders, has_interior
from pwaid.dynamics.pwa_simulation import PWATrajectory, simulate_cells
from pwaid.errors import InputError

__all__ = ["Cell", "PWASystem"]


def _names(given, count: int, letter: str, what: str) -> tuple[str, ...]:
    names = tuple(f"{letter}[{k}]" for k in range(count)) if given is None else tuple(given)
    if len(names) != count or len(set(names)) != count:
        raise InputError(f"{what} names {names}; expected {count} different names, one per {what}")
    return names


@dataclass(frozen=True)
class PWASystem:
    """A piecewise-affine system.

    Parameters
    ----------
    cells : sequence of Cell
        All with the same numbers of states, inputs and outputs.
    states, inputs, outputs : sequence of str, optional
        Names, in python-control's manner ``x[0]``, ``u[0]``, ``y[0]`` when not given.
    name : str

    Raises
    ------
    InputError
        No cell, cells of different sizes, or names that do not fit.
    """

    cells: tuple[Cell, ...]
    states: tuple[str, ...] | None = None
    inputs: tuple[str, ...] | None = None
    outputs: tuple[str, ...] | None = None
    name: str = field(default="pwa")

    def __post_init__(self):
        cells = tuple(self.cells)
        if not cells:
            raise InputError("a PWA system came without cells; give at least one Cell")
        sizes = [(*c.B.shape, c.C.shape[0]) for c in cells]
        if len(set(sizes)) != 1:
            raise InputError(f"cells have (states, inputs, outputs) {sizes}; expected the same sizes in "
                             "every cell")
        object.__setattr__(self, "cells", cells)
        n, m, p = sizes[0]
        object.__setattr__(self, "states", _names(self.states, n, "x", "state"))
        object.__setattr__(self, "inputs", _names(self.inputs, m, "u", "input"))
        states_out = self.outputs is None and p == n and all((np.eye(n) == c.C).all() for c in cells)
        default_outputs = self.states if states_out else None
        object.__setattr__(self, "outputs", _names(self.outputs or default_outputs, p, "y", "output"))

    def simulate(self, time, inputs=None, x0=None, **options) -> PWATrajectory:
        """Simulate with located crossings.

        Parameters
        ----------
        time : array_like (N,)
            Sample times, seconds, strictly increasing. The motion does not depend on them.
        inputs : array_like (N, m), optional
            ``inputs[k]`` is held from ``time[k]`` to ``time[k + 1]``; zero when not given.
        x0 : array_like (n,), optional
            Initial state, zero when not given. It may lie on a guard: the flow just after decides.
        sliding : {"stop", "filippov"}
            What to do where two flows push towards their border: end with status SLIDING, or go on along it
            by Filippov's convention where that is affine (`pwaid.dynamics.sliding`). Either way it is in
            ``slides``.
        limit : float
            |x| beyond which the motion has diverged.
        max_events : int
        zeno_events, zeno_time : int, float
            This many crossings (9) within this time (1e-7 of the whole), ever closer, end the simulation with
            status ZENO.
        step_scale : float
            Multiplies the internal step, for refinement studies; 1 or less.

        Returns
        -------
        PWATrajectory
        """
        return simulate_cells(self.cells, time, inputs, x0, **options)

    def cell_of(self, x, u=None) -> int:
        """Index of the first cell whose closure holds (x, u); -1 when none does."""
        x = np.asarray(x, dtype=float)
        u = np.zeros(len(self.inputs)) if u is None else np.asarray(u, dtype=float)
        for i, cell in enumerate(self.cells):
            if (cell.margin(x, u) >= 0).all():
                return i
        return -1

    def _at(self, x, u) -> tuple[Cell, np.ndarray, np.ndarray]:
        x = np.asarray(x, dtype=float)
        u = np.zeros(len(self.inputs)) if u is None else np.asarray(u, dtype=float)
        i = self.cell_of(x, u)
        if i < 0:
            raise InputError(f"x = {x} with u = {u} lies in no cell; the cells do not cover the space there")
        return self.cells[i], x, u

    def velocity(self, x, u=None) -> np.ndarray:
        """ẋ at one point (n,); the first cell counts on a border."""
        cell, x, u = self._at(x, u)
        return cell.velocity(x, u)

    def output(self, x, u=None) -> np.ndarray:
        """y at one point (p,); the first cell counts on a border."""
        cell, x, u = self._at(x, u)
        return cell.output(x, u)

    def continuity(self, bounds=None) -> list[Border]:
        """Every border between two cells, with the jump of the velocity (and of F x + f) over it.

        Parameters
        ----------
        bounds : sequence of (low, high), optional
            Box in the states within which the largest jump is sought; the whole space when not given (then
            a jump that grows without bound is reported as infinite). Inputs are held at zero.

        Returns
        -------
        list of Border
        """
        return find_borders(self.cells, bounds)

    def without_empty_cells(self) -> PWASystem:
        """A copy without the cells that have no interior."""
        kept = tuple(c for c in self.cells if has_interior(c))
        return PWASystem(kept, self.states, self.inputs, self.outputs, self.name)
