"""Delaunay triangulation without degenerate simplices, and the measures of simplices.

Slivers. A simplex whose smallest singular value (about its smallest height) is below 1e-7 of its longest edge is
*degenerate*: rounding decides its shape. Degenerate simplices that lie on the boundary are dropped (it moves by
rounding only). When one is left inside, as Qhull gives for points on a lattice from d = 3 on and for the corners of
a box, dropping it would tear the map; the vertices of such simplices are then moved by a random 1 % of the mesh
spacing (3 %, then 10 %, if that does not help) and triangulated again. Vertices on the boundary move outwards only,
so the mesh still covers what it covered. `SimplexMesh.quality` reports how many simplices were dropped, how far
points moved, and the worst aspect ratio left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy.spatial import Delaunay, QhullError

from pwaid.errors import InputError

__all__ = ["MeshQuality", "kuhn", "longest_edges", "neighbors", "triangulate", "volumes"]

DEGENERATE = 1e-7
JITTERS = (1e-2, 1e-2, 3e-2, 3e-2, 1e-1, 1e-1)


@dataclass(frozen=True)
class MeshQuality:
    """What was done to slivers, and how thin the ones left are."""

    dropped: int = 0
    moved: int = 0
    largest_move: float = 0.0
    worst_aspect_ratio: float = math.nan

    def __str__(self) -> str:
        return (
            f"worst aspect ratio (longest edge / smallest height) {self.worst_aspect_ratio:.3g}; "
            f"{self.dropped} degenerate simplices dropped; {self.moved} points moved by at most "
            f"{self.largest_move:.3g} (normalised)"
        )


def volumes(Z: np.ndarray, simplices: np.ndarray) -> np.ndarray:
    """Volume of each simplex of the points Z (n, d), shape (n_simplices,)."""
    V = Z[simplices]
    return np.abs(np.linalg.det(V[:, 1:] - V[:, :1])) / math.factorial(Z.shape[1])


def longest_edges(Z: np.ndarray, simplices: np.ndarray) -> np.ndarray:
    """Length of each simplex's longest edge, shape (n_simplices,)."""
    longest = np.zeros(len(simplices))
    for i in range(simplices.shape[1]):
        for j in range(i):
            longest = np.maximum(longest, np.linalg.norm(Z[simplices[:, i]] - Z[simplices[:, j]], axis=1))
    return longest


def neighbors(simplices: np.ndarray) -> np.ndarray:
    """The simplex across the facet opposite each vertex, −1 where there is none."""
    n, k = simplices.shape
    facets = np.stack([np.delete(simplices, j, axis=1) for j in range(k)], axis=1).reshape(n * k, k - 1)
    facets = np.sort(facets, axis=1)
    order = np.lexsort(facets.T)
    same = np.all(facets[order[1:]] == facets[order[:-1]], axis=1)
    a, b = order[:-1][same], order[1:][same]
    across = np.full(n * k, -1, dtype=np.int64)
    across[a], across[b] = b // k, a // k
    return across.reshape(n, k)


def kuhn(counts: np.ndarray) -> np.ndarray:
    """Simplices of a grid: in each cell, one for every order in which the d coordinates can be raised."""
    d = len(counts)
    strides = np.append(np.cumprod(counts[::-1])[-2::-1], 1) if d > 1 else np.array([1])
    cells = np.stack(np.meshgrid(*[np.arange(m - 1) for m in counts], indexing="ij"), axis=-1).reshape(-1, d)
    base = cells @ strides
    paths = [np.concatenate([[0], np.cumsum(strides[list(order)])]) for order in permutations(range(d))]
    return (base[:, None, None] + np.array(paths)[None]).reshape(-1, d + 1)


def _delaunay(Z: np.ndarray) -> np.ndarray:
    if Z.shape[1] == 1:
        order = np.argsort(Z[:, 0])
        return np.column_stack([order[:-1], order[1:]])
    try:
        return Delaunay(Z).simplices
    except QhullError as error:
        raise InputError(
            f"the points cannot be triangulated ({str(error).splitlines()[0]}); are inputs collinear, or of very "
            "different size? normalise with scaling=Scaling.covariance(X)"
        ) from error


def _degenerate(Z: np.ndarray, simplices: np.ndarray) -> np.ndarray:
    V = Z[simplices]
    smallest = np.linalg.svd(V[:, 1:] - V[:, :1], compute_uv=False)[:, -1]
    return smallest <= DEGENERATE * longest_edges(Z, simplices)


def _peel(Z: np.ndarray, simplices: np.ndarray) -> np.ndarray:
    """Drop degenerate simplices that lie on the boundary with one whole side, again and again.

    A flat simplex has two sides of equal measure. Where boundary facets make up one of them, the other side takes
    their place; one that touches the boundary only with its rim stands inside, and without it the mesh would tear.
    """
    while True:
        flat = np.flatnonzero(_degenerate(Z, simplices))
        if flat.size == 0:
            return simplices
        measures = _side_measures(Z, simplices[flat])
        outer = np.where(neighbors(simplices)[flat] < 0, measures, 0.0).sum(axis=1)
        lying = flat[outer >= 0.499 * measures.sum(axis=1)]
        if lying.size == 0:
            return simplices
        simplices = np.delete(simplices, lying, axis=0)


def _side_measures(Z: np.ndarray, simplices: np.ndarray) -> np.ndarray:
    """Relative measure of the facet opposite each vertex, shape (n, d + 1)."""
    columns = []
    for j in range(simplices.shape[1]):
        V = Z[np.delete(simplices, j, axis=1)]
        E = V[:, 1:] - V[:, :1]
        columns.append(np.sqrt(np.maximum(np.linalg.det(E @ E.transpose(0, 2, 1)), 0.0)))
    return np.column_stack(columns)


def triangulate(Z: np.ndarray) -> tuple[np.ndarray, np.ndarray, MeshQuality]:
    """Delaunay without degenerate simplices, by the rule in the head of this file."""
    n, d = Z.shape
    original, moved = Z, np.zeros(n, bool)
    noise = np.random.default_rng(0).uniform(-1, 1, (n, d))
    spacing = np.ptp(Z, axis=0).max() * n ** (-1.0 / d)
    for jitter in (*JITTERS, None):
        full = _delaunay(Z)
        simplices = _peel(Z, full)
        flat = _degenerate(Z, simplices)
        if not flat.any():
            largest = float(np.linalg.norm(Z - original, axis=1).max())
            return Z, simplices, MeshQuality(len(full) - len(simplices), int(moved.sum()), largest)
        if jitter is None:
            break
        if not moved.any():
            noise = _outwards(Z, full, noise)
        moved[simplices[flat]] = True
        Z = original + jitter * spacing * moved[:, None] * noise
    raise InputError(
        f"{int(flat.sum())} simplices of zero volume remain after moving points by {JITTERS[-1]:.0%} of their "
        "spacing; use fewer or less regular points, or SimplexMesh.grid"
    )


def _outwards(Z: np.ndarray, simplices: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """The noise, turned away from the centre at boundary vertices."""
    s, j = np.nonzero(neighbors(simplices) < 0)
    rim = np.zeros(len(Z), bool)
    for k in range(simplices.shape[1]):
        rim[simplices[s[j != k], k]] = True
    outwards = Z - Z.mean(axis=0)
    outwards /= np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), np.finfo(float).tiny)
    return np.where(rim[:, None], outwards * np.abs(noise[:, :1]), noise)
