"""Sliding: on a surface where the flows of both neighbours push towards it, the motion stays on the surface.

Filippov's convention: the velocity is the mixture α v_i + (1 − α) v_j that is tangent to the surface s·x +
s0 = 0. Where the jump v_i − v_j has one direction d on the whole surface (dry friction, relays), the
mixture is P v_j with P = I − d sᵀ / (sᵀ d): affine, so sliding is one more cell, whose guards are that both
neighbours still push towards the surface. Where the direction varies, the sliding velocity is not affine,
and this file says so instead of guessing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwaid.dynamics.cell import Cell

__all__ = ["Slide", "find_slide", "touching"]

NEAR = 1e-9  # of a guard, relative to its terms, when looking for the surface the motion has stopped on


@dataclass(frozen=True)
class Slide:
    """A surface on which the motion slides.

    Attributes
    ----------
    cells : (int, int)
        The neighbours (i, j).
    normal, offset : ndarray (n,), float
        The surface normal·x + offset = 0 (with the held input's part in the offset), positive on the side
        of j.
    start, stop : float
        Seconds; stop is NaN when the simulation ended on the surface.
    state : ndarray (n,)
        Where sliding began.
    closing : (float, float)
        Speeds, in units of the normal's row, at which i and j push towards the surface.
    cell : Cell or None
        The sliding motion as a cell, or None when it is not affine; then `reason` says why.
    """

    cells: tuple[int, int]
    normal: np.ndarray
    offset: float
    start: float
    stop: float
    state: np.ndarray
    closing: tuple[float, float]
    cell: Cell | None
    reason: str = ""


def touching(cells, x: np.ndarray, u: np.ndarray, steps) -> list[int]:
    """Cells whose closure holds (x, u), to `NEAR` of the terms and of what moves in a step (seconds, one
    per cell).
    """
    found = []
    for i, (cell, step) in enumerate(zip(cells, steps, strict=True)):
        reach = np.abs(x) + step * np.abs(cell.velocity(x, u))
        size = np.abs(cell.G) @ reach + np.abs(cell.H) @ np.abs(u) + np.abs(cell.g)
        if (cell.margin(x, u) >= -NEAR * size).all():
            found.append(i)
    return found


def _shared_surfaces(one: Cell, other: Cell, x, u):
    """Pairs of rows (r, q) of two cells that bound them from each other at x."""
    for r, row in enumerate(one.G):
        for q, opposite in enumerate(other.G):
            length, other_length = np.linalg.norm(row), np.linalg.norm(opposite)
            if length == 0 or other_length == 0:
                continue
            parallel = np.allclose(row / length, -opposite / other_length, atol=1e-12)
            scale = np.abs(row) @ np.abs(x) + abs(one.g[r]) + length * NEAR
            if parallel and abs(one.margin(x, u)[r]) <= 1e-6 * scale:
                yield r, q


def _sliding_cell(i: Cell, j: Cell, r: int, q: int, x, u) -> tuple[Cell | None, str]:
    """The affine sliding motion between two cells, or None and the reason why there is none."""
    s = j.G[q]
    jump = i.velocity(x, u) - j.velocity(x, u)
    if abs(s @ jump) <= 1e-12 * np.linalg.norm(s) * max(np.linalg.norm(jump), 1e-300):
        return None, "both velocities are tangent to the surface, so the mixture is not determined"
    d = jump / np.linalg.norm(jump)
    along = np.linalg.svd(s[None, :])[2][1:].T  # directions within the surface
    change = np.column_stack([(i.A - j.A) @ along, jump])
    off_direction = change - np.outer(d, d @ change)
    if np.abs(off_direction).max(initial=0.0) > 1e-9 * np.abs(change).max():
        return None, "the velocity's jump turns along the surface, so sliding is not affine there"
    P = np.eye(s.size) - np.outer(d, s) / (s @ d)
    keep_i, keep_j = np.arange(len(i.g)) != r, np.arange(len(j.g)) != q
    cell = Cell(
        A=P @ j.A, a=P @ j.a, B=P @ j.B,
        G=np.vstack([s @ i.A, -s @ j.A, i.G[keep_i], j.G[keep_j]]),
        H=np.vstack([s @ i.B, -s @ j.B, i.H[keep_i], j.H[keep_j]]),
        g=np.concatenate([[s @ i.a, -s @ j.a], i.g[keep_i], j.g[keep_j]]),
        C=j.C, c=j.c, D=j.D, name=f"sliding between {i.name} and {j.name}",
    )  # fmt: skip
    return cell, ""


def find_slide(cells, candidates, x, u, time: float) -> Slide | None:
    """The surface between two of the `candidates` on which the motion slides from (x, u), if there is one."""
    for at, i in enumerate(candidates):
        for j in candidates[at + 1 :]:
            for r, q in _shared_surfaces(cells[i], cells[j], x, u):
                s = cells[j].G[q]
                towards_j, towards_i = float(s @ cells[i].velocity(x, u)), float(-s @ cells[j].velocity(x, u))
                if min(towards_j, towards_i) < -NEAR * (abs(towards_j) + abs(towards_i)):
                    continue
                cell, reason = _sliding_cell(cells[i], cells[j], r, q, x, u)
                offset = float(cells[j].g[q] + cells[j].H[q] @ u)
                return Slide((i, j), s, offset, time, np.nan, x.copy(), (towards_j, towards_i), cell, reason)
    return None
