"""Borders between cells: which cells meet, and by how much the vector field jumps where they do (equation
8).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from pwaid.dynamics.cell import Cell
from pwaid.errors import InputError

__all__ = ["Border", "find_borders", "has_interior"]

ZERO = 1e-9


@dataclass(frozen=True)
class Border:
    """The common facet of two cells.

    Attributes
    ----------
    cells : (int, int)
    normal, offset : ndarray (n,), float
        The facet lies in normal·x + offset = 0; the normal has unit length and points into the second cell.
    jump : float
        Largest component of |(A_i − A_j) x + a_i − a_j| on the facet; infinite when it grows without bound.
    where : ndarray (n,) or None
        A point of the facet with that jump (with an infinite jump, one on the way there); None when there
        is no jump.
    state : int
        The component that jumps most.
    input_jump : float
        Largest entry of |B_i − B_j|.
    mismatch : float
        Largest |F_i x + f_i − F_j x − f_j| on the facet; 0 when F was not given.
    """

    cells: tuple[int, int]
    normal: np.ndarray
    offset: float
    jump: float
    where: np.ndarray | None
    state: int
    input_jump: float
    mismatch: float

    @property
    def continuous(self) -> bool:
        """Whether the velocity is the same on both sides of the whole facet, for every input."""
        return self.jump == 0.0 and self.input_jump == 0.0


def interior_point(G, g, equality=None, bounds=None):
    """Point of G x + g ≥ 0 (on equality: normal, offset) deepest inside, and its depth (at most 1)."""
    n = G.shape[1]
    lengths = np.linalg.norm(G, axis=1)
    if equality is not None:
        s = equality[0]
        lengths = np.linalg.norm(G - np.outer(G @ s, s), axis=1)  # depth is measured within the facet
    cost = np.zeros(n + 1)
    cost[-1] = -1.0
    box = [(None, None)] * n if bounds is None else list(bounds)
    A_eq = None if equality is None else np.append(equality[0], 0.0)[None, :]
    b_eq = None if equality is None else np.array([-equality[1]])
    found = linprog(cost, A_ub=np.column_stack([-G, lengths]), b_ub=g, A_eq=A_eq, b_eq=b_eq,
                    bounds=[*box, (None, 1.0)], method="highs")  # fmt: skip
    return (found.x[:n], found.x[n]) if found.status == 0 else (None, -np.inf)


def has_interior(cell: Cell) -> bool:
    """Whether the cell has inner points (at zero input, unless its guards depend on inputs: then for some
    input).
    """
    G = np.hstack([cell.G, cell.H])
    lengths = np.linalg.norm(G, axis=1)
    if (cell.g[lengths == 0] < 0).any():
        return False
    keep = lengths > 0
    unit = G[keep] / lengths[keep, None]
    return not keep.any() or interior_point(unit, cell.g[keep] / lengths[keep])[1] > ZERO


def _largest(M, m0, G, g, s, s0, bounds):
    """Largest |M x + m0| component on the facet {s x + s0 = 0, G x + g ≥ 0}: value, point, component."""
    box = [(None, None)] * s.size if bounds is None else list(bounds)
    best = (0.0, None, 0)
    size = max(np.abs(M).max(initial=0.0), np.abs(m0).max(initial=0.0))
    for k, (row, constant) in enumerate(zip(M, m0, strict=True)):
        if np.abs(np.append(row - (row @ s) * s, constant - (row @ s) * s0)).max() <= ZERO * size:
            continue  # a multiple of the facet's own equation
        for sign in (1.0, -1.0):
            found = linprog(-sign * row, A_ub=-G, b_ub=g, A_eq=s[None, :], b_eq=[-s0], bounds=box,
                            method="highs")
            if found.status == 3:
                wide = [(-1e6 if lo is None else lo, 1e6 if hi is None else hi) for lo, hi in box]
                found = linprog(-sign * row, A_ub=-G, b_ub=g, A_eq=s[None, :], b_eq=[-s0], bounds=wide,
                                method="highs")
                return np.inf, found.x, k
            if found.status == 0 and abs(row @ found.x + constant) > best[0]:
                best = (float(abs(row @ found.x + constant)), found.x, k)
    return best


def find_borders(cells, bounds=None) -> list[Border]:
    """Every pair of cells that share a facet, at zero input; see `PWASystem.continuity`."""
    n = cells[0].A.shape[0]
    if bounds is not None and len(bounds) != n:
        raise InputError(f"bounds hold {len(bounds)} pairs; expected {n}, one (low, high) per state")
    borders = []
    for i, one in enumerate(cells):
        for j in range(i + 1, len(cells)):
            borders.extend(_between(one, cells[j], i, j, bounds))
    return borders


def _between(one: Cell, other: Cell, i: int, j: int, bounds):
    G, g = np.vstack([one.G, other.G]), np.concatenate([one.g, other.g])
    for row, constant in zip(other.G, other.g, strict=True):
        length = np.linalg.norm(row)
        if length == 0:
            continue
        s, s0 = row / length, constant / length
        opposite = [q for q in range(len(one.g)) if _is_opposite(one, q, s, s0)]
        if not opposite:
            continue
        across = np.array([not _along(Gk, gk, s, s0) for Gk, gk in zip(G, g, strict=True)], dtype=bool)
        point, depth = interior_point(G[across], g[across], (s, s0), bounds)
        if point is None or depth <= ZERO:
            continue
        jump, where, state = _largest(one.A - other.A, one.a - other.a, G[across], g[across], s, s0, bounds)
        mismatch = 0.0
        if one.F.size and one.F.shape == other.F.shape:
            mismatch = _largest(one.F - other.F, one.f - other.f, G[across], g[across], s, s0, bounds)[0]
        input_jump = float(np.abs(one.B - other.B).max(initial=0.0))
        yield Border((i, j), s, float(s0), jump, where, state, input_jump, mismatch)


def _is_opposite(cell: Cell, q: int, s, s0) -> bool:
    length = np.linalg.norm(cell.G[q])
    return length > 0 and np.allclose(np.append(cell.G[q], cell.g[q]) / length, -np.append(s, s0), atol=1e-12)


def _along(row, constant, s, s0) -> bool:
    """Whether a guard is the facet's own hyperplane, from either side."""
    length = np.linalg.norm(row)
    if length == 0:
        return True
    full = np.append(row, constant) / length
    return np.allclose(full, np.append(s, s0), atol=1e-12) or np.allclose(full, -np.append(s, s0), atol=1e-12)
