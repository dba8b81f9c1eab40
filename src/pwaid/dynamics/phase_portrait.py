"""Phase portraits as arrays: trajectories and the velocity field in a plane of the state space. Drawing is
elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwaid.dynamics.cell import freeze
from pwaid.dynamics.pwa_simulation import PWATrajectory
from pwaid.dynamics.pwa_system import PWASystem
from pwaid.errors import InputError

__all__ = ["PhasePortrait", "phase_portrait"]


@dataclass(frozen=True)
class PhasePortrait:
    """What a phase portrait shows.

    Attributes
    ----------
    axes : (str, str)
        Names of the two states.
    curves : tuple of ndarray (N, 2)
        One per initial state, with the crossings among the samples so that corners are sharp.
    trajectories : tuple of PWATrajectory
    grid : ndarray (ny, nx, 2)
        Points of the plane; empty when no bounds were given.
    field : ndarray (ny, nx, 2)
        Velocities there, the other states at `at`.
    cells : ndarray of int (ny, nx)
    """

    axes: tuple[str, str]
    curves: tuple[np.ndarray, ...]
    trajectories: tuple[PWATrajectory, ...]
    grid: np.ndarray
    field: np.ndarray
    cells: np.ndarray

    def __post_init__(self):
        freeze(self)


def phase_portrait(system: PWASystem, axes, initial_states, time, inputs=None, bounds=None, shape=(21, 21),
                   at=None,
                   **options) -> PhasePortrait:  # fmt: skip
    """Trajectories from several initial states, and the velocity field, in the plane of two states.

    Parameters
    ----------
    system : PWASystem
    axes : (str, str)
        State names.
    initial_states : array_like (k, n)
    time, inputs
        As in `PWASystem.simulate`.
    bounds : ((low, high), (low, high)), optional
        Box for the velocity field.
    shape : (int, int)
        Points along the first and the second axis.
    at : array_like (n,), optional
        The other states on the field's plane, zero when not given.
    **options
        Passed to `PWASystem.simulate`.
    """
    missing = [name for name in axes if name not in system.states]
    if missing or len(axes) != 2:
        raise InputError(f"axes {tuple(axes)}; expected two of the states {system.states}")
    pick = [system.states.index(name) for name in axes]
    trajectories = tuple(system.simulate(time, inputs, x0, **options) for x0 in np.atleast_2d(initial_states))
    curves = []
    for path in trajectories:
        t = np.concatenate([path.time, path.crossings.time])
        order = np.argsort(t, kind="stable")
        curves.append(np.concatenate([path.states, path.crossings.state])[order][:, pick])
    grid, field, cells = np.empty((0, 0, 2)), np.empty((0, 0, 2)), np.empty((0, 0), dtype=int)
    if bounds is not None:
        grid = np.stack(np.meshgrid(*(np.linspace(*b, k) for b, k in zip(bounds, shape, strict=True))),
                        axis=-1)
        field, cells = np.full(grid.shape, np.nan), np.full(grid.shape[:2], -1)
        for index in np.ndindex(grid.shape[:2]):
            x = np.zeros(len(system.states)) if at is None else np.array(at, dtype=float)
            x[pick] = grid[index]
            cells[index] = system.cell_of(x)
            if cells[index] >= 0:
                field[index] = system.velocity(x)[pick]
    return PhasePortrait(tuple(axes), tuple(curves), trajectories, grid, field, cells)
