"""Simulation of piecewise-affine systems: samples, crossings, sliding, and the reason why a simulation
ended.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from pwaid.dynamics.cell import Cell, freeze
from pwaid.dynamics.flow import (
    DIVERGED,
    DONE,
    FULL,
    NO_CELL,
    ZENO,
    Events,
    FlowTables,
    choose,
    natural_step,
    run,
)
from pwaid.dynamics.sliding import Slide, find_slide, touching
from pwaid.errors import InputError

__all__ = ["Crossings", "PWAStatus", "PWATrajectory", "simulate_cells"]


class PWAStatus(Enum):
    """Why a simulation ended; the value advises."""

    DONE = "reached the last sample"
    SLIDING = "two flows push towards a surface; see slides; sliding='filippov' goes on along affine surfaces"
    ZENO = "crossings accumulate at stop_time; the model has no motion beyond it without a further convention"
    DIVERGED = "the state passed the limit; check the stability of the loop, or raise `limit`"
    OUTSIDE = "the state left every cell; the cells do not cover the space, add the missing one"
    TOO_MANY_EVENTS = "the buffer of crossings is full; raise `max_events`, or shorten the simulation"


@dataclass(frozen=True)
class Crossings:
    """Located crossings, in order.

    Attributes
    ----------
    time, state : ndarray (E,), (E, n)
    before, after : ndarray of int (E,)
        Cells; an index ≥ the number of cells is a sliding motion.
    guard : ndarray of int (E,)
        The row of the cell before that ended the stay; -1 when a jump of the input did.
    ambiguous : ndarray of bool (E,)
        More than one cell would have been a continuation (flows that part at the border); the first was
        taken.
    """

    time: np.ndarray
    state: np.ndarray
    before: np.ndarray
    after: np.ndarray
    guard: np.ndarray
    ambiguous: np.ndarray

    def __post_init__(self):
        freeze(self)

    def __len__(self) -> int:
        return self.time.size


@dataclass(frozen=True)
class PWATrajectory:
    """Samples of one simulation; shorter than asked for when `status` is not DONE.

    Attributes
    ----------
    time, states, inputs, outputs : ndarray (N,), (N, n), (N, m), (N, p)
        At a crossing the value just after it.
    cells : ndarray of int (N,)
        The cell of each sample; an index ≥ the number of cells means sliding, on ``slides[index − number of
        cells]``.
    crossings : Crossings
    slides : tuple of Slide
        Where and when the motion slid, also when it stopped there.
    status : PWAStatus
    stop_time : float
        The last sample, or the time of the reason to stop.
    stop_state : ndarray (n,)
    message : str
        `status` in words, with where and what.
    """

    time: np.ndarray
    states: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    cells: np.ndarray
    crossings: Crossings
    slides: tuple[Slide, ...]
    status: PWAStatus
    stop_time: float
    stop_state: np.ndarray
    message: str

    def __post_init__(self):
        freeze(self)


def _tables(cells: list[Cell], n_ordinary: int, scale: float) -> FlowTables:
    """Every cell's matrices padded to one shape; one dummy input when there is none."""
    m, n, p = len(cells), cells[0].A.shape[0], max(cells[0].B.shape[1], 1)
    rows = np.array([len(c.g) for c in cells])
    shape = (m, max(rows.max(), 1))
    B, G, H, g = np.zeros((m, n, p)), np.zeros((*shape, n)), np.zeros((*shape, p)), np.zeros(shape)
    for i, cell in enumerate(cells):
        B[i, :, : cell.B.shape[1]] = cell.B
        G[i, : rows[i]], g[i, : rows[i]] = cell.G, cell.g
        H[i, : rows[i], : cell.H.shape[1]] = cell.H
    A, a = np.array([c.A for c in cells]), np.array([c.a for c in cells])
    step = np.array([natural_step(c.A, scale) for c in cells])
    return FlowTables(A, a, B, G, H, g, rows, step, n_ordinary)


def _checked(cells, time, inputs, x0, sliding) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, inputs and initial state as arrays of the right shape, or an error that says what is wrong."""
    n, m = cells[0].B.shape
    time = np.array(time, dtype=float)
    if time.ndim != 1 or time.size < 2 or not np.isfinite(time).all() or not (np.diff(time) > 0).all():
        raise InputError("time must be at least two finite, strictly increasing values in seconds; sort it, "
                         "drop repeats")
    u = np.zeros((time.size, m)) if inputs is None else np.asarray(inputs, dtype=float)
    if u.ndim == 1 and m == 1:
        u = u[:, None]
    if u.ndim == 1 and u.size == m:
        u = np.tile(u, (time.size, 1))
    if u.shape != (time.size, m):
        raise InputError(f"inputs have shape {u.shape}; expected ({time.size}, {m}): one row per time, held "
                         "until the next")
    x = np.zeros(n) if x0 is None else np.array(x0, dtype=float)
    if x.shape != (n,):
        raise InputError(f"x0 has shape {x.shape}; expected ({n},), one value per state")
    if not (np.isfinite(u).all() and np.isfinite(x).all()):
        raise InputError("inputs and x0 must be finite; NaN or infinity came")
    if n == 0:
        raise InputError("the system has no state; evaluate it with `output` instead of simulating it")
    if sliding not in ("stop", "filippov"):
        raise InputError(f"sliding={sliding!r}; expected 'stop' or 'filippov'")
    return time, np.array(u, order="C"), x


class _Motion:
    """The state of one simulation between calls of the compiled loop."""

    def __init__(self, cells, time, u, x, max_events, scale):
        n, N = x.size, time.size
        self.cells, self.n_ordinary, self.scale = list(cells), len(cells), scale
        self.time, self.u, self.x = time, u if u.shape[1] else np.zeros((N, 1)), x
        self.now = np.array([time[0]])
        self.state = np.zeros(4, dtype=np.int64)
        self.states, self.index = np.full((N, n), np.nan), np.full(N, -1, dtype=np.int64)
        flags = np.zeros(max_events, dtype=np.bool_)
        whole = [np.zeros(max_events, dtype=np.int64) for _ in range(3)]
        self.events = Events(np.zeros(max_events), np.zeros((max_events, n)), *whole, flags)
        self.slides: list[Slide] = []
        self.tables = _tables(self.cells, self.n_ordinary, scale)

    @property
    def held(self) -> np.ndarray:
        return self.u[self.state[3]]

    def choose(self) -> int:
        return choose(self.tables, self.x, self.held, self.state[1], self.time[-1] - self.time[0])[0]

    def slide(self, sliding: str) -> PWAStatus | None:
        """Find the surface the motion stopped on; go on along it, or say why not."""
        u = self.u[self.state[3], : self.cells[0].B.shape[1]]
        steps = np.minimum(self.tables.step[: self.n_ordinary], self.time[-1] - self.time[0])
        candidates = touching(self.cells[: self.n_ordinary], self.x, u, steps)
        if not candidates:
            return PWAStatus.OUTSIDE
        surface = find_slide(self.cells[: self.n_ordinary], candidates, self.x, u, float(self.now[0]))
        if surface is None:
            return PWAStatus.SLIDING if len(candidates) > 1 else PWAStatus.OUTSIDE
        self.slides.append(surface)
        if sliding == "stop" or surface.cell is None:
            return PWAStatus.SLIDING
        self.cells.append(surface.cell)
        self.tables = _tables(self.cells, self.n_ordinary, self.scale)
        before, self.state[1] = self.state[1], len(self.cells) - 1
        if self.choose() != self.state[1]:
            return PWAStatus.SLIDING  # an intersection of surfaces: another neighbour pushes as well
        e = self.state[0]
        if e < self.events.time.size:
            self.events.time[e], self.events.x[e], self.events.ambiguous[e] = self.now[0], self.x, False
            self.events.before[e], self.events.after[e] = before, self.state[1]
            self.state[0] += 1
        return None


def simulate_cells(cells, time, inputs=None, x0=None, *, sliding="stop", limit=1e9, max_events=100_000,
                   zeno_events=9, zeno_time=None, step_scale=1.0) -> PWATrajectory:  # fmt: skip
    """Simulate; see `pwaid.dynamics.pwa_system.PWASystem.simulate`."""
    time, u, x = _checked(cells, time, inputs, x0, sliding)
    motion = _Motion(cells, time, u, x, max_events, step_scale)
    zeno_time = 1e-7 * (time[-1] - time[0]) if zeno_time is None else zeno_time
    motion.state[1] = motion.choose()
    status = motion.slide(sliding) if motion.state[1] < 0 else None
    codes = {DONE: PWAStatus.DONE, ZENO: PWAStatus.ZENO, DIVERGED: PWAStatus.DIVERGED,
             FULL: PWAStatus.TOO_MANY_EVENTS}
    while status is None:
        code = run(motion.tables, motion.time, motion.u, motion.x, motion.state, motion.now, motion.states,
                   motion.index, motion.events, limit, zeno_events, zeno_time)  # fmt: skip
        status = codes.get(code)
        if code == NO_CELL:
            status = motion.slide(sliding)
            if status is None and len(motion.slides) >= max_events:
                status = PWAStatus.TOO_MANY_EVENTS
    return _trajectory(motion, u, status)


def _outputs(motion: _Motion, count: int, u: np.ndarray) -> np.ndarray:
    """Outputs of the samples; while sliding, the same mixture of the neighbours' outputs as of their
    velocities.
    """
    y = np.empty((count, motion.cells[0].C.shape[0]))
    for index in np.unique(motion.index[:count]):
        at = np.flatnonzero(motion.index[:count] == index)
        x, v = motion.states[at], u[at]
        if index < motion.n_ordinary:
            y[at] = motion.cells[index].output(x, v)
            continue
        surface = motion.slides[index - motion.n_ordinary]
        i, j = (motion.cells[k] for k in surface.cells)
        to_j = (x @ i.A.T + i.a + v @ i.B.T) @ surface.normal
        from_j = (x @ j.A.T + j.a + v @ j.B.T) @ surface.normal
        share = (from_j / (from_j - to_j))[:, None]
        y[at] = share * i.output(x, v) + (1 - share) * j.output(x, v)
    return y


def _trajectory(motion: _Motion, u: np.ndarray, status: PWAStatus) -> PWATrajectory:
    count, n_events = int(motion.state[2]), int(motion.state[0])
    if status is PWAStatus.DIVERGED:
        finite = np.abs(motion.states[:count]).max(axis=1, initial=0.0) < np.inf
        count = int(finite.sum())
    e = motion.events
    crossings = Crossings(*(array[:n_events].copy() for array in e))
    for k in range(len(motion.slides)):
        left = crossings.time[crossings.before == motion.n_ordinary + k]
        motion.slides[k] = replace(motion.slides[k], stop=float(left[0]) if left.size else np.nan)
    message = status.value
    if status is not PWAStatus.DONE:
        message = f"at t = {motion.now[0]:.9g} s, x = {np.array2string(motion.x, precision=6)}: {message}"
    if status is PWAStatus.SLIDING and motion.slides:
        last = motion.slides[-1]
        reason = f"; {last.reason}" if last.reason else ""
        message += f" (between cells {last.cells[0]} and {last.cells[1]}{reason})"
    return PWATrajectory(
        time=motion.time[:count].copy(), states=motion.states[:count], inputs=u[:count].copy(),
        outputs=_outputs(motion, count, u), cells=motion.index[:count], crossings=crossings,
        slides=tuple(motion.slides), status=status, stop_time=float(motion.now[0]),
        stop_state=motion.x, message=message,
    )  # fmt: skip
