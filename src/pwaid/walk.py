"""Compiled point location: which simplex holds a point, by walking from neighbour to neighbour.

A simplex s with vertices v_0 … v_d has barycentric coordinates b_j(x) = gradients[s, j] · (x − v_d) for j < d, and
one minus their sum for the last; differences from a vertex keep the digits that large coordinates would lose.
The walk leaves the simplex through a facet whose coordinate is negative. In a Delaunay mesh such a walk ends
(no simplex is met twice). A grid of buckets over the mesh gives a start next to the goal, so that a walk takes
two or three steps on average. Everything here works in the mesh's normalised coordinates.
"""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["bucket_index", "locate", "locate_exhaustively", "walk"]


@numba.njit(cache=True, inline="always")
def barycentric(gradients, origins, s, x, out):
    """Write the barycentric coordinates of x in simplex s to `out`; return the index of the smallest."""
    d = x.shape[0]
    worst = 0
    total = 0.0
    for j in range(d):
        b = 0.0
        for k in range(d):
            b += gradients[s, j, k] * (x[k] - origins[s, k])
        out[j] = b
        total += b
        if b < out[worst]:
            worst = j
    out[d] = 1.0 - total
    if out[d] < out[worst]:
        worst = d
    return worst


@numba.njit(cache=True)
def bucket_index(x, low, inverse_width, shape):
    """Flat index of the bucket that holds x, clipped to the grid."""
    index = 0
    for k in range(x.shape[0]):
        i = int((x[k] - low[k]) * inverse_width[k])
        if i < 0:
            i = 0
        elif i >= shape[k]:
            i = shape[k] - 1
        index = index * shape[k] + i
    return index


@numba.njit(cache=True)
def walk(gradients, origins, neighbors, x, start, tolerance, out):
    """Walk from simplex `start` to the one that holds x.

    Returns
    -------
    simplex : int
        Its index; −1 − s when the walk left the mesh through a boundary facet of simplex s (`out` then holds
        the coordinates of x in s); −1 − n_simplices − s when it was stopped at s, which rounding in slivers can
        cause.
    """
    s = start
    n_simplices = neighbors.shape[0]
    for _ in range(n_simplices + 10):
        worst = barycentric(gradients, origins, s, x, out)
        if out[worst] >= -tolerance:
            return s
        step = neighbors[s, worst]
        if step < 0:  # a boundary facet: try another way before giving up
            for j in range(out.shape[0]):
                if out[j] < -tolerance and neighbors[s, j] >= 0:
                    step = neighbors[s, j]
                    break
            if step < 0:
                return -1 - s
        s = step
    return -1 - n_simplices - s


@numba.njit(cache=True)
def _by_bucket(X, low, inverse_width, shape, n_buckets):
    """The order of the points by bucket (a counting sort), and each point's bucket."""
    bucket = np.empty(X.shape[0], np.int64)
    begin = np.zeros(n_buckets + 1, np.int64)
    for k in range(X.shape[0]):
        bucket[k] = bucket_index(X[k], low, inverse_width, shape)
        begin[bucket[k] + 1] += 1
    for b in range(n_buckets):
        begin[b + 1] += begin[b]
    order = np.empty(X.shape[0], np.int64)
    for k in range(X.shape[0]):
        order[begin[bucket[k]]] = k
        begin[bucket[k]] += 1
    return order, bucket


@numba.njit(cache=True)
def locate(gradients, origins, neighbors, X, buckets, low, inverse_width, shape, tolerance, simplex, weights):
    """Locate every row of X; `simplex` gets the index or −1 − (last simplex), `weights` the coordinates.

    Points are taken bucket by bucket, and each walk in a bucket starts where the last one ended: the simplices of a
    bucket stay in the cache, and a walk is a step or two.
    """
    order, bucket = _by_bucket(X, low, inverse_width, shape, buckets.size)
    here = -1
    start = 0
    for k in order:
        if bucket[k] != here:
            here = bucket[k]
            start = buckets[here]
        found = walk(gradients, origins, neighbors, X[k], start, tolerance, weights[k])
        simplex[k] = found
        if found >= 0:
            start = found


@numba.njit(cache=True)
def locate_exhaustively(gradients, origins, lower, upper, X, tolerance, simplex, weights):
    """For the rows with simplex < 0: look through all simplices whose bounding box holds the point."""
    d = X.shape[1]
    out = np.empty(d + 1)
    for k in range(X.shape[0]):
        if simplex[k] >= 0:
            continue
        for s in range(lower.shape[0]):
            inside = True
            for j in range(d):
                if X[k, j] < lower[s, j] or X[k, j] > upper[s, j]:
                    inside = False
                    break
            if not inside:
                continue
            worst = barycentric(gradients, origins, s, X[k], out)
            if out[worst] >= -tolerance:
                simplex[k] = s
                weights[k] = out
                break
