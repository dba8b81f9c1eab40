"""Nested dissection: an elimination order for the sparse matrices of a mesh, and the tree of dense fronts it gives.

A set of unknowns is cut in two parts by a plane; the fewest unknowns that touch every matrix entry across the cut (a
smallest vertex cover, by Kőnig's theorem from a largest matching) become the separator, which is eliminated after
both parts; each part is cut again until it is small. Of several planes the one counts whose separator is smallest
for the size of the smaller part. Because a separator's columns fill
almost wholly once its halves are gone, each separator and each leaf is one dense front of the multifrontal
factorisation in `pwaid.cholesky`. Where there are no coordinates, graph distances from a few far-apart unknowns
serve instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numba
import numpy as np

__all__ = ["FrontTree", "dissect"]

LEAF = 24
# Sets of more than this many unknowns are cut in several directions and shares, and the best separator is kept.
MANY = 100
SHARES = np.array([0.5, 0.45, 0.55, 0.4, 0.6])
# Cells of the Morton curve an axis, as a power of 2; up to 6 axes fit into an integer.
MORTON_BITS = 10


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
    def run_ends(self) -> np.ndarray:
        """For each of `places` where the run of consecutive places that it belongs to ends, counted in its front."""
        return _run_ends(self.row_starts, self.places)

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


def dissect(indptr: np.ndarray, indices: np.ndarray, coordinates: Any = None, *, leaf: int = LEAF) -> FrontTree:
    """Order the unknowns of a symmetric sparse matrix and lay out the fronts.

    Parameters
    ----------
    indptr, indices : ndarray of int
        Pattern of the matrix, compressed rows or columns, both triangles.
    coordinates : ndarray, shape (n, d), optional
        Where the unknowns lie.
    leaf : int
        Sets of at most this many unknowns are not cut again.
    """
    indptr, indices = indptr.astype(np.int64), indices.astype(np.int64)
    if coordinates is None:
        coordinates = _landmark_distances(indptr, indices, 3)
    coordinates = np.ascontiguousarray(coordinates, dtype=float)
    order, starts, parents = _dissect(
        indptr, indices, coordinates, _directions(coordinates.shape[1]), SHARES, _morton_order(coordinates), leaf
    )
    position = np.empty_like(order)
    position[order] = np.arange(order.size)
    row_starts, rows, places = _rows(indptr, indices, order, position, starts, parents)
    return FrontTree(order, position, starts, parents, row_starts, rows, places)


def _directions(d: int) -> np.ndarray:
    """Normals of the planes tried: the axes, and the diagonals between two of them."""
    eye = np.eye(d)
    diagonals = [(eye[i] + sign * eye[j]) for i in range(d) for j in range(i) for sign in (1.0, -1.0)]
    return np.vstack([eye, *diagonals])


def _morton_order(coordinates: np.ndarray) -> np.ndarray:
    """Unknowns along a Morton curve: within a front, those that a child shares then lie in few runs."""
    n, d = coordinates.shape
    ranks = np.argsort(np.argsort(coordinates, axis=0), axis=0)
    cells = (ranks * 2**MORTON_BITS) // max(n, 1)
    key = np.zeros(n, np.int64)
    for bit in range(MORTON_BITS - 1, -1, -1):
        for axis in range(d):
            key = 2 * key + ((cells[:, axis] >> bit) & 1)
    return np.argsort(key, kind="stable")


@numba.njit(cache=True)
def _landmark_distances(indptr, indices, count):
    """Graph distances from `count` unknowns, each the farthest from those before; unreached parts lie far off."""
    n = indptr.size - 1
    coordinates = np.zeros((n, count))
    nearest = np.full(n, np.inf)
    queue = np.empty(n, np.int64)
    source = 0
    for c in range(-1, count):  # the first round only finds a start at the rim
        distance = np.full(n, -1.0)
        distance[source] = 0.0
        queue[0] = source
        head, tail = 0, 1
        while head < tail:
            v = queue[head]
            head += 1
            for e in range(indptr[v], indptr[v + 1]):
                w = indices[e]
                if distance[w] < 0.0:
                    distance[w] = distance[v] + 1.0
                    queue[tail] = w
                    tail += 1
        for v in range(n):
            if distance[v] < 0.0:
                distance[v] = 2.0 * n
            if c >= 0:
                coordinates[v, c] = distance[v]
                nearest[v] = min(nearest[v], distance[v])
        source = np.argmax(distance) if c < 0 else np.argmax(nearest)
    return coordinates


@numba.njit(cache=True)
def _cut(members, values, share, side, stamp):
    """Mark the members below and above a quantile of `values` with side = stamp, stamp + 1."""
    below = int(members.size * share)
    by_value = np.argsort(values)
    for t in range(members.size):
        side[members[by_value[t]]] = stamp if t < below else stamp + 1


@numba.njit(cache=True)
def _match(v, indptr, indices, side, other, partner, seen, round_, stack, edge):
    """Augment the matching from the free unknown v of the lower half, depth first; whether it worked."""
    depth = 0
    stack[0] = v
    edge[0] = indptr[v]
    while depth >= 0:
        u = stack[depth]
        advanced = False
        while edge[depth] < indptr[u + 1]:
            w = indices[edge[depth]]
            edge[depth] += 1
            if side[w] != other or seen[w] == round_:
                continue
            seen[w] = round_
            if partner[w] < 0:  # free: flip the path
                while True:
                    u = stack[depth]
                    w = indices[edge[depth] - 1]
                    partner[w], partner[u], depth = u, w, depth - 1
                    if depth < 0:
                        return True
            depth += 1
            stack[depth] = partner[w]
            edge[depth] = indptr[partner[w]]
            advanced = True
            break
        if not advanced:
            depth -= 1
    return False


@numba.njit(cache=True)
def _cover(indptr, indices, members, side, stamp, partner, seen, round_, stack, edge, separator):
    """Set `separator` on a smallest set of members that touches every entry between the halves."""
    for v in members:
        partner[v] = -1
        separator[v] = False
    for v in members:  # a greedy matching first: few are left for the search
        if side[v] == stamp:
            for e in range(indptr[v], indptr[v + 1]):
                w = indices[e]
                if side[w] == stamp + 1 and partner[w] < 0:
                    partner[v], partner[w] = w, v
                    break
    for v in members:
        if side[v] == stamp and partner[v] < 0:
            round_ += 1
            _match(v, indptr, indices, side, stamp + 1, partner, seen, round_, stack, edge)
    # Kőnig: Z = what alternating paths reach from free unknowns of the lower half; cover = lower \ Z and upper ∩ Z.
    round_ += 1
    for v in members:
        if side[v] == stamp and partner[v] < 0 and seen[v] != round_:
            seen[v] = round_
            stack[0] = v
            top = 1
            while top > 0:
                top -= 1
                u = stack[top]
                for e in range(indptr[u], indptr[u + 1]):
                    w = indices[e]
                    if side[w] == stamp + 1 and seen[w] != round_:
                        seen[w] = round_
                        u2 = partner[w]
                        if u2 >= 0 and seen[u2] != round_:
                            seen[u2] = round_
                            stack[top] = u2
                            top += 1
    for v in members:
        if side[v] == stamp:
            separator[v] = partner[v] >= 0 and seen[v] != round_
        else:
            separator[v] = seen[v] == round_
    return round_


@numba.njit(cache=True)
def _dissect(indptr, indices, coordinates, directions, shares, order, leaf):
    n, d = coordinates.shape
    order = order.copy()
    side = np.full(n, -1)
    partner, seen = np.full(n, -1), np.zeros(n, np.int64)
    stack, edge = np.empty(n + 1, np.int64), np.empty(n + 1, np.int64)
    separator = np.zeros(n, np.bool_)
    part, chosen, sizes = np.empty(n, np.int64), np.empty(n, np.int64), np.zeros(3, np.int64)
    stamp, round_ = 0, 0
    # Fronts are found parents first; `begins` sorts them into elimination order at the end.
    begins, parents = [0 for _ in range(0)], [0 for _ in range(0)]
    todo = [(0, n, -1)]
    while len(todo) > 0:
        low, high, parent = todo.pop()
        if high == low:
            continue
        members = order[low:high].copy()
        if members.size <= leaf:
            begins.append(low)
            parents.append(parent)
            continue
        best = np.inf
        n_shares = shares.size if members.size > MANY else 1
        for i in range(directions.shape[0] if members.size > MANY else d):
            values = coordinates[members] @ directions[i]
            for share in shares[:n_shares]:
                _cut(members, values, share, side, stamp)
                round_ = _cover(indptr, indices, members, side, stamp, partner, seen, round_, stack, edge, separator)
                sizes[:] = 0
                for t in range(members.size):
                    v = members[t]
                    part[t] = 2 if separator[v] else side[v] - stamp
                    sizes[part[t]] += 1
                score = sizes[2] / max(1, min(sizes[0], sizes[1])) ** (1.0 / 3.0)
                if score < best:
                    best = score
                    chosen[: members.size] = part[: members.size]
                stamp += 2
        middle, a = low, low
        for which in range(3):
            if which == 1:
                middle = a
            elif which == 2:
                b = a
            for t in range(members.size):
                if chosen[t] == which:
                    order[a] = members[t]
                    a += 1
        a = b
        if a == high:  # nothing across the cut: both halves hang below the parent
            me = parent
        else:
            me = len(begins)
            begins.append(a)
            parents.append(parent)
        todo.append((low, middle, me))
        todo.append((middle, a, me))
    begin = np.array(begins)
    rank = np.argsort(begin)
    number = np.empty_like(rank)
    number[rank] = np.arange(rank.size)
    parent = np.empty(rank.size, np.int64)
    for i in range(rank.size):
        p = parents[rank[i]]
        parent[i] = number[p] if p >= 0 else -1
    starts = np.empty(rank.size + 1, np.int64)
    starts[:-1] = begin[rank]
    starts[-1] = n
    return order, starts, parent


@numba.njit(cache=True)
def _rows(indptr, indices, order, position, starts, parents):
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
                q = position[indices[e]]
                if q >= end and mark[q] != i:
                    mark[q] = i
                    if count == rows.size:
                        rows = np.concatenate((rows, np.empty(rows.size, np.int64)))
                    rows[count] = q
                    count += 1
        c = child[i]
        while c >= 0:
            for t in range(row_starts[c], row_starts[c + 1]):
                q = rows[t]
                if q >= end and mark[q] != i:
                    mark[q] = i
                    if count == rows.size:
                        rows = np.concatenate((rows, np.empty(rows.size, np.int64)))
                    rows[count] = q
                    count += 1
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
def _run_ends(row_starts, places):
    ends = np.empty_like(places)
    for i in range(row_starts.size - 1):
        first, end = row_starts[i], row_starts[i + 1]
        for t in range(end - 1, first - 1, -1):
            joined = t + 1 < end and places[t + 1] == places[t] + 1
            ends[t] = ends[t + 1] if joined else t + 1 - first
    return ends


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
