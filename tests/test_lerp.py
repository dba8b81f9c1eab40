"""The identities of A and F, and agreement with the papers' formula written out."""

from __future__ import annotations

import numpy as np
import pytest

from pwaid import InputError, OutsideMeshError, SimplexMesh, hinge_matrix, interpolation_matrix
from pwaid.lerp import WEIGHTINGS, extrapolation_error

CASES = [(1, 15), (2, 40), (3, 40), (4, 30)]


def literal_lerp(x, V, y):
    """2011 eq. 3, 2014 eq. 2, as printed."""
    return np.append(x, 1.0) @ np.linalg.inv(np.column_stack([V, np.ones(len(V))])) @ y


def literal_pairs(mesh):
    """Every neighbouring simplex–vertex pair (s, p) by comparing vertex sets (2014 eq. 7)."""
    sets = [set(s) for s in mesh.simplices.tolist()]
    for s, mine in enumerate(sets):
        for other in sets:
            if len(mine & other) == mesh.dimension:
                yield s, (other - mine).pop()


@pytest.fixture(params=CASES, ids=lambda c: f"d={c[0]}")
def mesh(request, rng):
    d, n = request.param
    return SimplexMesh.uniform([[-1.0, 2.0]] * d, n, rng)


def test_rows_of_A_sum_to_one_and_reproduce_affine_functions(mesh, rng):
    X = rng.uniform(-1, 2, (200, mesh.dimension))
    A = interpolation_matrix(mesh, X)
    assert A.shape == (200, mesh.n_points) and np.all(np.diff(A.indptr) == mesh.dimension + 1)
    np.testing.assert_allclose(A.sum(axis=1), 1.0, atol=1e-12)
    slope = rng.standard_normal(mesh.dimension)
    np.testing.assert_allclose(A @ (mesh.points @ slope + 3.0), X @ slope + 3.0, atol=1e-10)


def test_A_is_the_papers_lerp(mesh, rng):
    X = rng.uniform(-1, 2, (20, mesh.dimension))
    values = rng.standard_normal(mesh.n_points)
    simplex, _ = mesh.locate(X)
    corners = mesh.simplices[simplex]
    expected = [literal_lerp(x, mesh.points[v], values[v]) for x, v in zip(X, corners, strict=True)]
    np.testing.assert_allclose(interpolation_matrix(mesh, X) @ values, expected, rtol=1e-7, atol=1e-9)


def test_A_at_the_vertices_is_the_identity(mesh):
    A = interpolation_matrix(mesh, mesh.points)
    np.testing.assert_allclose(A.toarray(), np.eye(mesh.n_points), atol=1e-8)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_F_annihilates_affine_functions(mesh, rng, weighting):
    F = hinge_matrix(mesh, weighting)
    assert F.shape == (len(mesh.facets), mesh.n_points)
    assert np.all(np.diff(F.indptr) == mesh.dimension + 2)
    affine = mesh.points @ rng.standard_normal(mesh.dimension) + 1.0
    size = np.sqrt(np.asarray(F.multiply(F).sum(axis=1)).ravel()) * np.abs(affine).max()
    assert np.max(np.abs(F @ affine) / size) < 1e-9


def test_one_weighted_row_equals_the_two_sided_pairs_of_the_papers(mesh, rng):
    values = rng.standard_normal(mesh.n_points)
    total = sum(
        abs(values[p] - literal_lerp(mesh.points[p], mesh.points[mesh.simplices[s]], values[mesh.simplices[s]]))
        for s, p in literal_pairs(mesh)
    )
    assert np.abs(hinge_matrix(mesh, "pairs") @ values).sum() == pytest.approx(total, rel=1e-7)
    assert extrapolation_error(mesh, values).sum() == pytest.approx(total, rel=1e-7)


def test_pairs_hinge_and_htv_rows_are_proportional_with_the_documented_weights(mesh):
    pairs, hinge, htv = (hinge_matrix(mesh, w) for w in WEIGHTINGS)
    f = mesh.facets
    h, g = mesh.heights[f.left, f.left_apex], mesh.heights[f.right, f.right_apex]
    ratio = np.abs(pairs).max(axis=1).toarray().ravel() / np.abs(hinge).max(axis=1).toarray().ravel()
    np.testing.assert_allclose(ratio, (h + g) / np.minimum(h, g), rtol=1e-9)
    d = mesh.dimension
    measure = mesh.volumes[f.left] * d / h if d > 1 else np.ones_like(h)
    ratio = np.abs(htv).max(axis=1).toarray().ravel() / np.abs(hinge).max(axis=1).toarray().ravel()
    np.testing.assert_allclose(ratio, measure / np.minimum(h, g), rtol=1e-9)


def test_htv_of_a_fold_is_jump_times_length_on_any_mesh_that_holds_it(rng):
    totals = []
    for n in (5, 9, 17):
        mesh = SimplexMesh.grid([[-1, 1]] * 2, n)
        totals.append(np.abs(hinge_matrix(mesh, "htv") @ np.maximum(mesh.points[:, 0], 0.0)).sum())
    np.testing.assert_allclose(totals, 2.0, rtol=1e-9)  # slope jumps by 1 along a line of length 2


def test_unknown_weighting_and_outside_samples(rng):
    mesh = SimplexMesh.grid([[-1, 1]] * 2, 3)
    with pytest.raises(InputError, match="expected one of 'pairs', 'hinge', 'htv'"):
        hinge_matrix(mesh, "paper")
    with pytest.raises(OutsideMeshError, match="1 of 1 points lie outside"):
        interpolation_matrix(mesh, [[3.0, 0.0]])
