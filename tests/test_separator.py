"""Separators moved to the narrowest place: they separate, and by Menger's theorem none in the band is smaller."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.csgraph import maximum_flow

from pwaid.delaunay import SimplexMesh
from pwaid.dissection import dissect
from pwaid.lerp import hinge_matrix
from pwaid.separator import narrow


def pattern(n: int, seed: int, d: int = 2):
    mesh = SimplexMesh.uniform([[-1.0, 1.0]] * d, n, np.random.default_rng(seed))
    F = hinge_matrix(mesh, "htv")
    F.data[:] = 1.0
    return sparse.csr_matrix(F.T @ F), mesh.normalised


def moved(A, parts, width):
    """`narrow` on the whole graph: parts (n,) of 0, 1 and the separator 2, and their sizes."""
    n = A.shape[0]
    chosen, sizes = parts.copy(), np.bincount(parts, minlength=3)
    where, band = np.full(n, -1), np.zeros(n, bool)
    flags, paths = [np.zeros(n, bool) for _ in range(2)], [np.full(n, -1) for _ in range(2)]
    marks = [np.zeros(n, np.int64) for _ in range(2)]
    narrow(A.indptr.astype(np.int64), A.indices.astype(np.int64), np.arange(n), chosen, sizes, where, band, *flags,
           *paths, *marks, 0, np.empty(2 * n, np.int64), np.empty(2 * n + 2, np.int64), width)
    assert np.all(where == -1) and not band.any()
    return chosen, sizes


def strip(A, x):
    """A straight separator: the unknowns left of x = 0 with a neighbour on the right."""
    below = x < 0.0
    touched = (A @ (~below).astype(float) > 0) & below
    return np.where(touched, 2, np.where(below, 0, 1))


def largest_flow(A, parts, width):
    """How many paths without a common unknown run through the band, by SciPy's maximum flow on split unknowns."""
    n, band = A.shape[0], parts == 2
    for _ in range(width):
        band = band | (A @ band.astype(float) > 0)
    rows, columns = A.nonzero()
    keep = rows != columns
    rows, columns = rows[keep], columns[keep]
    much, source, sink = n, 2 * n, 2 * n + 1
    inside = band[rows] & band[columns]
    out = ~band & (parts == 0), ~band & (parts == 1)
    first = np.unique(columns[band[columns] & out[0][rows]])
    last = np.unique(columns[band[columns] & out[1][rows]])
    members = np.flatnonzero(band)
    i = np.r_[members, rows[inside] + n, np.full(first.size, source), last + n]
    j = np.r_[members + n, columns[inside], first, np.full(last.size, sink)]
    weights = np.r_[np.ones(members.size), np.full(inside.sum() + first.size + last.size, much)].astype(np.int32)
    graph = sparse.csr_matrix((weights, (i, j)), (2 * n + 2, 2 * n + 2))
    return maximum_flow(graph, source, sink).flow_value


@pytest.mark.parametrize("seed, width", [(0, 1), (1, 2), (2, 3), (3, 4)])
def test_the_narrowest_separator_in_the_band(seed, width):
    A, points = pattern(900, seed)
    start = strip(A, points[:, 0])
    chosen, sizes = moved(A, start, width)
    rows, columns = A.nonzero()
    assert not np.any((chosen[rows] == 0) & (chosen[columns] == 1))
    np.testing.assert_array_equal(np.bincount(chosen, minlength=3), sizes)
    assert sizes[2] == largest_flow(A, start, width) < np.sum(start == 2)


def test_a_set_within_the_band_is_left_alone():
    A, points = pattern(60, 0)
    start = strip(A, points[:, 0])
    np.testing.assert_array_equal(moved(A, start, 50)[0], start)


def test_orders_need_fewer_operations():
    A, points = pattern(6000, 5)
    flops = dissect(A.indptr, A.indices, points).flops
    straight = dissect(A.indptr, A.indices, np.column_stack([points, 0.0 * points[:, 0]])).flops  # width of d = 3
    assert flops < 0.97 * straight
