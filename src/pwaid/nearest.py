"""The rule "affine" outside a mesh: the simplex behind the nearest boundary facet.

The distance of a point from a facet is found exactly, by looking at the facet's faces of every dimension: the
nearest point of a simplex lies in the relative interior of one of its faces, where the orthogonal projection onto
that face's affine hull has positive barycentric coordinates. Facets whose bounding ball is farther than the best
distance so far are passed over.
"""

from __future__ import annotations

import numba
import numpy as np

from pwaid.delaunay import SimplexMesh

__all__ = ["extend", "nearest_facet"]


@numba.njit(cache=True)
def _solve(gram, right, k):
    """Solve a small positive definite system in place by Gaussian elimination; False when it is singular."""
    for i in range(k):
        if gram[i, i] <= 0.0:
            return False
        for j in range(i + 1, k):
            factor = gram[j, i] / gram[i, i]
            for l in range(i, k):
                gram[j, l] -= factor * gram[i, l]
            right[j] -= factor * right[i]
    for i in range(k - 1, -1, -1):
        for j in range(i + 1, k):
            right[i] -= gram[i, j] * right[j]
        right[i] /= gram[i, i]
    return True


@numba.njit(cache=True)
def _face_distance(V, mask, x, members, gram, right):
    """Squared distance of x from the affine hull of the vertices in `mask`, or −1 if projected outside the face."""
    d, k = x.shape[0], -1
    for j in range(V.shape[0]):
        if mask >> j & 1:
            k += 1
            members[k] = j
    base = V[members[0]]
    for i in range(k):
        right[i] = 0.0
        for l in range(d):
            right[i] += (V[members[i + 1], l] - base[l]) * (x[l] - base[l])
        for j in range(k):
            gram[i, j] = 0.0
            for l in range(d):
                gram[i, j] += (V[members[i + 1], l] - base[l]) * (V[members[j + 1], l] - base[l])
    if not _solve(gram, right, k):  # a flat face only repeats what its own faces say
        return -1.0
    total = 0.0
    for i in range(k):
        if right[i] < 0.0:
            return -1.0
        total += right[i]
    if total > 1.0:
        return -1.0
    distance = 0.0
    for l in range(d):
        rest = x[l] - base[l]
        for i in range(k):
            rest -= right[i] * (V[members[i + 1], l] - base[l])
        distance += rest * rest
    return distance


@numba.njit(cache=True)
def _distance(x, y):
    total = 0.0
    for l in range(x.shape[0]):
        total += (x[l] - y[l]) ** 2
    return np.sqrt(total)


@numba.njit(cache=True)
def nearest_facet(facets, centres, radii, x):
    """Index of the facet nearest to x; `facets` (n, d, d) holds their vertices."""
    n, d = facets.shape[0], facets.shape[1]
    members, gram, right = np.empty(d, np.int64), np.empty((d, d)), np.empty(d)
    bound, first = np.inf, 0  # the facet that reaches nearest is looked at first, to pass over the others
    for f in range(n):
        reach = _distance(x, centres[f]) + radii[f]
        if reach < bound:
            bound, first = reach, f
    best, found = bound, first
    for g in range(n):
        f = (first + g) % n
        if _distance(x, centres[f]) - radii[f] > best:
            continue
        for mask in range(1, 1 << d):
            squared = _face_distance(facets[f], mask, x, members, gram, right)
            if squared >= 0.0 and np.sqrt(squared) < best:
                best, found = np.sqrt(squared), f
    return found


@numba.njit(cache=True)
def _nearest_facets(facets, centres, radii, X, result):
    for k in range(X.shape[0]):
        result[k] = nearest_facet(facets, centres, radii, X[k])


def extend(mesh: SimplexMesh, X: np.ndarray, simplex: np.ndarray, weights: np.ndarray):
    """Replace the −1 of `mesh.locate` by the simplex behind the nearest boundary facet (normalised distance).

    Returns the completed copies of `simplex` and `weights`; outside, some weights are negative.
    """
    outside = np.flatnonzero(simplex < 0)
    s, j = mesh.boundary
    corners = np.stack([np.delete(mesh.simplices[i], k) for i, k in zip(s, j, strict=True)])
    facets = np.ascontiguousarray(mesh.normalised[corners])
    centres = facets.mean(axis=1)
    radii = np.linalg.norm(facets - centres[:, None], axis=2).max(axis=1)
    Z = mesh.scaling.apply(X[outside])
    found = np.zeros(len(outside), np.int64)
    _nearest_facets(facets, centres, radii, Z, found)
    simplex, weights = simplex.copy(), weights.copy()
    simplex[outside] = s[found]
    gradients, offsets = mesh._barycentric
    weights[outside] = np.einsum("kjd,kd->kj", gradients[s[found]], Z) + offsets[s[found]]
    return simplex, weights
