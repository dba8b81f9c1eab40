"""Meshes: they cover what they should, find points, and survive slivers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from pwaid import InputError, OutsideMeshError, Scaling, SimplexMesh

BOX = {d: [[-1.0, 1.0]] * d for d in range(1, 6)}


@pytest.mark.parametrize(("d", "n"), [(1, 30), (2, 300), (3, 300), (4, 150), (5, 60)])
def test_a_uniform_mesh_covers_its_box_and_locates_points(d, n, rng):
    mesh = SimplexMesh.uniform(BOX[d], n, rng)
    assert mesh.n_points == n
    X = rng.uniform(-1, 1, (500, d))
    simplex, weights = mesh.locate(X)
    assert np.all(simplex >= 0)
    assert weights.min() >= -1e-9
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("kj,kjd->kd", weights, mesh.points[mesh.simplices[simplex]]), X, atol=1e-10)
    volume = mesh.volumes.sum()  # from d = 4 on the corners stand up to 5 % outside the box
    assert volume == pytest.approx(2.0**d, rel=1e-9) if d < 4 else 2.0**d < volume < (2.0 * 1.1) ** d
    assert mesh.quality.worst_aspect_ratio < 1e6
    assert np.isfinite(mesh.quality.worst_aspect_ratio)


def test_location_agrees_with_scipy(rng):
    P = rng.uniform(-1, 1, (400, 3))
    mesh, other = SimplexMesh.from_points(P), Delaunay(P)
    X = rng.uniform(-1.2, 1.2, (5000, 3))
    simplex, weights = mesh.locate(X)
    theirs = other.find_simplex(X)
    np.testing.assert_array_equal(simplex < 0, theirs < 0)
    inside = simplex >= 0
    transform = other.transform[theirs[inside]]
    b = np.einsum("kij,kj->ki", transform[:, :3], X[inside] - transform[:, 3])
    b = np.column_stack([b, 1.0 - b.sum(axis=1)])
    ours = np.zeros((inside.sum(), 400))
    np.put_along_axis(ours, mesh.simplices[simplex[inside]], weights[inside], axis=1)
    expected = np.zeros_like(ours)
    np.put_along_axis(expected, other.simplices[theirs[inside]], b, axis=1)
    np.testing.assert_allclose(ours, expected, atol=1e-10)


@pytest.mark.parametrize(("d", "shape"), [(1, 7), (2, (4, 6)), (3, 4), (4, 3), (5, 3)])
def test_a_grid_is_cut_into_factorially_many_simplices(d, shape):
    mesh = SimplexMesh.grid(BOX[d], shape)
    counts = np.broadcast_to(shape, (d,))
    assert mesh.n_points == np.prod(counts)
    assert mesh.n_simplices == np.prod(counts - 1) * np.prod(np.arange(1, d + 1))
    assert mesh.volumes.sum() == pytest.approx(2.0**d)


@pytest.mark.parametrize(("d", "shape"), [(3, 5), (4, 4)])
def test_lattice_points_leave_no_degenerate_simplex(d, shape, rng):
    lattice = SimplexMesh.grid(BOX[d], shape).points
    mesh = SimplexMesh.from_points(lattice)
    assert mesh.quality.moved > 0
    assert mesh.quality.largest_move < 0.1 * 2.0 / (shape - 1)
    assert mesh.quality.worst_aspect_ratio < 1e7
    assert np.all(mesh.contains(rng.uniform(-1, 1, (300, d))))
    assert "points moved" in str(mesh.quality)


def test_blue_noise_has_few_slivers_and_covers_the_box(rng):
    blue, random = SimplexMesh.blue_noise(BOX[2], 800, 3), SimplexMesh.uniform(BOX[2], 800, 3)
    assert blue.n_points == 800
    assert blue.quality.worst_aspect_ratio < 20 < random.quality.worst_aspect_ratio
    assert np.all(blue.contains(rng.uniform(-1, 1, (1000, 2))))


def test_gaussian_points_have_the_moments_of_the_data(rng):
    X = rng.standard_normal((4000, 2)) @ np.array([[2.0, 0.0], [1.5, 0.1]]) + [3.0, -1.0]
    mesh = SimplexMesh.gaussian(X, 3000, rng)
    np.testing.assert_allclose(mesh.points.mean(axis=0), X.mean(axis=0), atol=0.15)
    np.testing.assert_allclose(np.cov(mesh.points.T), np.cov(X.T), rtol=0.15)
    np.testing.assert_allclose(np.cov(mesh.scaling.apply(X).T), np.eye(2), atol=1e-10)


def test_data_mesh_covers_the_data_and_follows_its_density(rng):
    X = rng.standard_normal((3000, 2)) ** 3
    mesh = SimplexMesh.from_data(X, 300, rng)
    assert mesh.n_points == 300 and np.all(mesh.contains(X))
    assert np.median(np.abs(mesh.points)) < 2.0
    assert SimplexMesh.from_data(X[:50], None, rng).n_points == 54


def test_clipping_to_a_box_keeps_it_covered(rng):
    mesh = SimplexMesh.uniform([[-2, 2]] * 2, 600, rng)
    clipped = mesh.clip(bounds=BOX[2])
    assert clipped.n_points < mesh.n_points and not clipped.convex
    X = rng.uniform(-1, 1, (3000, 2))
    assert np.all(clipped.contains(X))
    # every simplex kept has a point of the box: none lies wholly outside
    corners = clipped.points[clipped.simplices]
    assert not np.any(np.all(corners[:, :, 0] > 1, axis=1) | np.all(corners[:, :, 1] < -1, axis=1))
    far = rng.uniform(-2, 2, (3000, 2))
    again, _ = clipped.locate(far)
    inside_any = np.zeros(len(far), bool)
    for s in range(clipped.n_simplices):
        V = clipped.points[clipped.simplices[s]]
        b = np.linalg.solve(np.vstack([V.T, np.ones(3)]), np.vstack([far.T, np.ones(len(far))]))
        inside_any |= b.min(axis=0) > 1e-9
    assert np.all(again[inside_any] >= 0) and np.mean((again >= 0) != inside_any) < 1e-3


def test_clipping_to_a_hull(rng):
    X = 0.3 * rng.standard_normal((200, 3))
    mesh = SimplexMesh.uniform([[-2, 2]] * 3, 400, rng).clip(hull=X)
    assert np.all(mesh.contains(X)) and mesh.n_points < 400


def test_facets_name_both_simplices(rng):
    mesh = SimplexMesh.uniform(BOX[3], 80, rng)
    facets = mesh.facets
    for s, j, other, k in zip(facets.left, facets.left_apex, facets.right, facets.right_apex, strict=True):
        mine, theirs = np.delete(mesh.simplices[s], j), np.delete(mesh.simplices[other], k)
        assert set(mine) == set(theirs)
    assert len(facets) == (mesh.neighbors >= 0).sum() // 2


def test_scalings_undo_themselves(rng):
    X = rng.standard_normal((50, 2)) * [1.0, 35.0] + [0.0, 100.0]
    for scaling in (Scaling.units([1.5, 35.0]), Scaling.covariance(X), Scaling.identity(2)):
        np.testing.assert_allclose(scaling.undo(scaling.apply(X)), X, atol=1e-10)


def test_mesh_arrays_are_read_only(rng):
    mesh = SimplexMesh.uniform(BOX[2], 20, rng)
    with pytest.raises(ValueError, match="read-only"):
        mesh.points[0, 0] = 0.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: SimplexMesh.from_points([[0, 0], [1, 0], [0, 1], [0, 0]]), "1 of 4 points are repeated"),
        (lambda: SimplexMesh.from_points([[0, 0], [1, 1], [2, 2], [3, 3]]), "collinear inputs"),
        (lambda: SimplexMesh.from_points([[0, 0], [1, 1]]), "needs at least 3"),
        (lambda: SimplexMesh.from_points([[0, np.nan], [1, 1], [0, 1]]), "points has 1 entries|points have 1|NaN"),
        (lambda: SimplexMesh.from_points(np.zeros((2, 2, 2))), r"expected \(n, d\)"),
        (lambda: SimplexMesh.uniform([[1, -1]], 10), "expected low < high"),
        (lambda: SimplexMesh.uniform([[-1, 1]] * 3, 8), "expected at least 9"),
        (lambda: SimplexMesh.grid([[-1, 1]], 1), "at least 2 points"),
        (lambda: SimplexMesh.from_data(np.column_stack([np.arange(9.0), np.ones(9)])), "column 1 of X is constant"),
        (lambda: Scaling.covariance(np.column_stack([np.arange(9.0), 2 * np.arange(9.0)])), "collinear"),
        (lambda: Scaling.units([1.0, 0.0]), "expected positive numbers"),
        (lambda: SimplexMesh.grid([[-1, 1]] * 2, 3).clip(), "either bounds= or hull="),
        (lambda: SimplexMesh.grid([[-1, 1]] * 2, 3).clip(bounds=[[5, 6]] * 2), "no simplex of the mesh meets"),
        (lambda: SimplexMesh.grid([[-1, 1]] * 2, 3).locate(np.zeros((2, 9))), "looks transposed"),
        (lambda: SimplexMesh.grid([[-1, 1]] * 2, 3).locate([0.0, 0.0]), r"pass X\[None, :\]"),
    ],
)
def test_bad_meshes(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_points_outside_raise_and_are_counted():
    mesh = SimplexMesh.grid([[-1, 1]] * 2, 3)
    X = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, -3.0]])
    np.testing.assert_array_equal(mesh.contains(X), [True, False, False])
    simplex, weights = mesh.locate(X)
    assert simplex[1] == -1 and np.all(np.isnan(weights[1]))
    with pytest.raises(OutsideMeshError, match=r"2 of 3 points lie outside the mesh, the first at index 1"):
        mesh.require_inside(simplex, X)
