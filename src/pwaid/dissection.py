"""Nested dissection: an elimination order for the sparse matrices of a mesh, by cuts with few unknowns on them.

A set of unknowns is cut in two parts by a plane; the fewest unknowns that touch every matrix entry across the cut (a
smallest vertex cover, by Kőnig's theorem from a largest matching) become the separator, which is eliminated after
both parts; each part is cut again until it is small. Of several planes the one counts whose separator is smallest
for the size of the smaller part, and that separator is moved to the narrowest place nearby (`pwaid.separator`). Each
separator and each leaf becomes one dense front of `pwaid.fronts`. Where there are no coordinates, graph distances from
a few far-apart unknowns serve instead.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from pwaid.fronts import FrontTree
from pwaid.separator import narrow, score

__all__ = ["dissect"]

LEAF = 24
# Sets of more than this many unknowns are cut in several directions and shares, and the best separator is kept.
MANY = 100
SHARES = np.array([0.5, 0.45, 0.55, 0.4, 0.6])
# Cells of the Morton curve an axis, as a power of 2; up to 6 axes fit into an integer.
MORTON_BITS = 10
# Steps to either side of a plane's separator within which the narrowest one is looked for, in the plane and in more
# dimensions, where parts of a wide band lose their shape.
FLAT, THICK = 3, 1


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
        indptr, indices, coordinates, _directions(coordinates.shape[1]), SHARES, _morton_order(coordinates), leaf,
        FLAT if coordinates.shape[1] == 2 else THICK,
    )
    return FrontTree.of(indptr, indices, order, starts, parents)


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
def _dissect(indptr, indices, coordinates, directions, shares, order, leaf, width):
    n, d = coordinates.shape
    order = order.copy()
    side = np.full(n, -1)
    partner, seen = np.full(n, -1), np.zeros(n, np.int64)
    stack, edge = np.empty(n + 1, np.int64), np.empty(n + 1, np.int64)
    separator = np.zeros(n, np.bool_)
    part, chosen, sizes = np.empty(n, np.int64), np.empty(n, np.int64), np.zeros(3, np.int64)
    kept, where, band = np.zeros(3, np.int64), np.full(n, -1), np.zeros(n, np.bool_)
    first, last = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    before, after, entered = np.empty(n, np.int64), np.empty(n, np.int64), np.zeros(n, np.int64)
    came, states = np.empty(2 * n, np.int64), np.empty(2 * n + 2, np.int64)
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
                size = score(sizes)
                if size < best:
                    best = size
                    chosen[: members.size] = part[: members.size]
                    kept[:] = sizes
                stamp += 2
        if members.size > MANY:
            round_ = narrow(indptr, indices, members, chosen, kept, where, band, first, last, before, after, entered,
                             seen, round_, came, states, width)
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
