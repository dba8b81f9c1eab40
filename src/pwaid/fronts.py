"""The tree of dense fronts of a multifrontal factorisation: which rows each one has, and where its numbers lie.

A separator's columns fill almost wholly once the parts on either side of it are gone, so each separator and each leaf
of an elimination order (`pwaid.dissection`) is one dense front. A front eliminates its own unknowns and updates rows
of later ones, among those of its parent. `pwaid.cholesky` does the arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np

__all__ = ["FrontTree"]


@dataclass(frozen=True, eq=False)
class FrontTree:
    """The fronts of a multifrontal factorisation, children before parents.

    Attributes
    ----------
    order : ndarray of int, shape (n,)
        order[k] is the unknown eliminated k-th.
    position : ndarray of int, shape (n,)
        The inverse of `order`.
    starts : ndarray of int, shape (n_fronts + 1,)
        Front i eliminates positions starts[i] … starts[i + 1] − 1.
    parents : ndarray of int, shape (n_fronts,)
        −1 for a root.
    row_starts, rows : ndarray of int
        rows[row_starts[i]:row_starts[i + 1]] are the later positions that front i updates, ascending.
    places : ndarray of int, the shape of rows
        Where each of these rows stands in the parent's front.
    """

    order: np.ndarray
    position: np.ndarray
    starts: np.ndarray
    parents: np.ndarray
    row_starts: np.ndarray
    rows: np.ndarray
    places: np.ndarray

    @classmethod
    def of(cls, indptr, indices, order, starts, parents) -> FrontTree:
        """Lay out the fronts for a pattern (indptr, indices: compressed rows, both triangles) and its order."""
        position = np.empty_like(order)
        position[order] = np.arange(order.size)
        return cls(order, position, starts, parents, *_rows(indptr, indices, order, position, starts, parents))

    @cached_property
    def panel_starts(self) -> np.ndarray:
        """Where each front's columns of L begin in one array; column-major, (k + m) × k each."""
        k, m = np.diff(self.starts), np.diff(self.row_starts)
        return np.concatenate([[0], np.cumsum(k * (k + m))])

    @property
    def n_stored(self) -> int:
        """Numbers stored for L, explicit zeros counted."""
        return int(self.panel_starts[-1])

    @property
    def flops(self) -> float:
        """Multiplications and additions of one factorisation."""
        k, m = np.diff(self.starts).astype(float), np.diff(self.row_starts).astype(float)
        return float((k**3 / 3 + k * k * m + k * m * m).sum())

    @cached_property
    def stack_starts(self) -> tuple[np.ndarray, int]:
        """Where each front's update matrix (m × m) lies on a stack, and the size of the stack."""
        m = np.diff(self.row_starts)
        return _stack(self.parents, m)

    @cached_property
    def n_inner(self) -> np.ndarray:
        """How many of each front's rows its parent eliminates."""
        row_front = np.repeat(np.arange(self.parents.size), np.diff(self.row_starts))
        ends = self.starts[self.parents + 1]
        return np.bincount(row_front[self.rows < ends[row_front]], minlength=self.parents.size)

    def entries(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """Where the matrix entries (i, j) go in the array of panels (either triangle)."""
        a, b = self.position[i], self.position[j]
        found = np.empty(a.size, np.int64)
        _entries(
            np.maximum(a, b), np.minimum(a, b), self.starts, self.row_starts, self.rows, self.panel_starts, found
        )
        return found


@numba.njit(cache=True)
def _append(row, end, front, mark, rows, count):
    """The list with a later row appended once per front, longer where it was full, and its new length."""
    if row >= end and mark[row] != front:
        mark[row] = front
        if count == rows.size:
            rows = np.concatenate((rows, np.empty(rows.size, np.int64)))
        rows[count] = row
        count += 1
    return rows, count


@numba.njit(cache=True)
def _rows(indptr, indices, order, position, starts, parents):
    """The later positions each front updates (starts and list), and their places in its parent's front."""
    n_fronts = parents.size
    n = order.size
    row_starts = np.zeros(n_fronts + 1, np.int64)
    rows = np.empty(4 * n + 16, np.int64)
    mark = np.full(n, -1)
    child, sibling = np.full(n_fronts, -1), np.full(n_fronts, -1)
    for i in range(n_fronts):
        end, count = starts[i + 1], row_starts[i]
        for p in range(starts[i], end):
            v = order[p]
            for e in range(indptr[v], indptr[v + 1]):
                rows, count = _append(position[indices[e]], end, i, mark, rows, count)
        c = child[i]
        while c >= 0:
            for t in range(row_starts[c], row_starts[c + 1]):
                rows, count = _append(rows[t], end, i, mark, rows, count)
            c = sibling[c]
        rows[row_starts[i] : count] = np.sort(rows[row_starts[i] : count])
        row_starts[i + 1] = count
        p = parents[i]
        if p >= 0:
            sibling[i] = child[p]
            child[p] = i
    rows = rows[: row_starts[-1]].copy()
    places = np.empty_like(rows)
    for i in range(n_fronts):
        p = parents[i]
        if p < 0:
            continue
        later = rows[row_starts[p] : row_starts[p + 1]]
        k = starts[p + 1] - starts[p]
        for t in range(row_starts[i], row_starts[i + 1]):
            q = rows[t]
            places[t] = q - starts[p] if q < starts[p + 1] else k + np.searchsorted(later, q)
    return row_starts, rows, places


@numba.njit(cache=True)
def _stack(parents, m):
    """Update matrices on two stacks, for even and odd depth: a front's own never lies where its children's do."""
    n_fronts = parents.size
    depth, first = np.zeros(n_fronts, np.int64), np.full(n_fronts, -1)
    for i in range(n_fronts - 1, -1, -1):
        if parents[i] >= 0:
            depth[i] = 1 - depth[parents[i]]
    starts = np.empty(n_fronts, np.int64)
    top, peak = np.zeros(2, np.int64), np.zeros(2, np.int64)
    for i in range(n_fronts):
        here = depth[i]
        if first[i] >= 0:  # the children's are done with after this front
            top[1 - here] = first[i]
        starts[i] = top[here]
        p = parents[i]
        if p >= 0:
            if first[p] < 0:
                first[p] = top[here]
            top[here] += m[i] * m[i]
            peak[here] = max(peak[here], top[here])
    for i in range(n_fronts):
        if depth[i] == 1:
            starts[i] += peak[0]
    return starts, peak[0] + peak[1]


@numba.njit(cache=True)
def _entries(row, column, starts, row_starts, rows, panel_starts, found):
    for e in range(row.size):
        i = np.searchsorted(starts, column[e], side="right") - 1
        k = starts[i + 1] - starts[i]
        later = rows[row_starts[i] : row_starts[i + 1]]
        if row[e] < starts[i + 1]:
            r = row[e] - starts[i]
        else:
            r = k + np.searchsorted(later, row[e])
        found[e] = panel_starts[i] + (column[e] - starts[i]) * (k + later.size) + r
