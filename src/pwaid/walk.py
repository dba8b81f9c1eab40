"""Compiled point location: which simplex holds a point, by walking from neighbour to neighbour.

A simplex s with vertices v_0 … v_d has barycentric coordinates b_j(x) = gradients[s, j] · x + offsets[s, j].
The walk leaves the simplex through a facet whose coordinate is negative. In a Delaunay mesh such a walk ends
(no simplex is met twice). A grid of buckets over the mesh gives a start next to the goal, so that a walk takes
two or three steps on average. Everything here works in the mesh's normalised coordinates.
"""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["bucket_index", "locate", "locate_exhaustively", "walk"]


@numba.njit(cache=True, inline="always")
def barycentric(gradients, offsets, s, x, out):
    """Write the barycentric coordinates of x in simplex s to `out`; return the index of the smallest."""
    d = x.shape[0]
    worst = 0
    total = 0.0
    for j in range(d):
        b = offsets[s, j]
        for k in range(d):
            b += gradients[s, j, k] * x[k]
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
def walk(gradients, offsets, neighbors, x, start, tolerance, out):
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
        worst = barycentric(gradients, offsets, s, x, out)
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
def locate(gradients, offsets, neighbors, X, buckets, low, inverse_width, shape, tolerance, simplex, weights):
    """Locate every row of X; `simplex` gets the index or −1 − (last simplex), `weights` the coordinates."""
    for k in range(X.shape[0]):
        start = buckets[bucket_index(X[k], low, inverse_width, shape)]
        simplex[k] = walk(gradients, offsets, neighbors, X[k], start, tolerance, weights[k])


@numba.njit(cache=True)
def locate_exhaustively(gradients, offsets, lower, upper, X, tolerance, simplex, weights):
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
            worst = barycentric(gradients, offsets, s, X[k], out)
            if out[worst] >= -tolerance:
                simplex[k] = s
                weights[k] = out
                break
