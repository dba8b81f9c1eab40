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

__all__ = ["extend"]


@numba.njit(cache=True)
def _face_distance(V, mask, x):
    """Squared distance of x from the affine hull of the vertices in `mask`, or −1 if projected outside the face."""
    k = -1
    d = x.shape[0]
    members = np.empty(V.shape[0], np.int64)
    for j in range(V.shape[0]):
        if mask >> j & 1:
            k += 1
            members[k] = j
    base = V[members[0]]
    distance = 0.0
    if k == 0:
        for i in range(d):
            distance += (x[i] - base[i]) ** 2
        return distance
    E = np.empty((k, d))
    for j in range(k):
        E[j] = V[members[j + 1]] - base
    gram = E @ E.T
    right = E @ (x - base)
    for j in range(k):  # a flat face only repeats what its own faces say
        gram[j, j] *= 1.0 + 1e-14
        if gram[j, j] == 0.0:
            return -1.0
    b = np.linalg.solve(gram, right)
    if b.min() < 0.0 or b.sum() > 1.0:
        return -1.0
    rest = x - base - E.T @ b
    return (rest * rest).sum()


@numba.njit(cache=True)
def _nearest_facet(facets, centres, radii, X, result):
    n_faces = 1 << facets.shape[1]
    distances = np.empty(facets.shape[0])
    for k in range(X.shape[0]):
        for f in range(facets.shape[0]):
            distances[f] = np.sqrt(((X[k] - centres[f]) ** 2).sum())
        best = np.inf
        for f in np.argsort(distances - radii):
            if distances[f] - radii[f] > best:
                break
            for mask in range(1, n_faces):
                squared = _face_distance(facets[f], mask, X[k])
                if 0.0 <= squared and np.sqrt(squared) < best:
                    best = np.sqrt(squared)
                    result[k] = f


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
    _nearest_facet(facets, centres, radii, Z, found)
    simplex, weights = simplex.copy(), weights.copy()
    simplex[outside] = s[found]
    gradients, offsets = mesh._barycentric
    weights[outside] = np.einsum("kjd,kd->kj", gradients[s[found]], Z) + offsets[s[found]]
    return simplex, weights
