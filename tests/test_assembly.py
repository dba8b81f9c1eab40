"""Assembly: weights equal SciPy's, and sums over chunks equal the whole."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from pwaid.assembly import SampleSums
from pwaid.delaunay import SimplexMesh
from pwaid.engine import solve_engine
from pwaid.errors import InputError, OutsideMeshError
from pwaid.lerp import interpolation_matrix
from pwaid.problem import HingeProblem
from pwaid.vertices import box_corners


@pytest.mark.parametrize(("d", "n"), [(2, 500), (3, 500), (4, 100)])
def test_weights_equal_those_of_scipy(d, n):
    rng = np.random.default_rng(d)
    mesh = SimplexMesh.from_points(np.vstack([box_corners([[-1, 1]] * d), rng.uniform(-1, 1, (n, d))]))
    points = mesh.points
    X = rng.uniform(-1, 1, (5000, d))
    judge = Delaunay(points)
    simplex = judge.find_simplex(X)
    T = judge.transform[simplex]
    first = np.einsum("nij,nj->ni", T[:, :d], X - T[:, d])
    expected = np.zeros((len(X), len(points)))
    np.put_along_axis(expected, judge.simplices[simplex], np.column_stack([first, 1 - first.sum(axis=1)]), axis=1)
    assert np.abs(interpolation_matrix(mesh, X).toarray() - expected).max() <= 1e-12


def test_far_from_the_origin_the_weights_keep_their_digits():
    rng = np.random.default_rng(0)
    mesh = SimplexMesh.from_points(1e6 + np.vstack([box_corners([[0, 1]] * 2), rng.uniform(0, 1, (300, 2))]))
    X = 1e6 + rng.uniform(0.01, 0.99, (2000, 2))
    assert np.abs(interpolation_matrix(mesh, X) @ mesh.points - X).max() <= 1e-9


@pytest.mark.parametrize("d", [1, 2, 3])
def test_chunks_equal_the_whole(d):
    rng = np.random.default_rng(7)
    mesh = SimplexMesh.uniform([[-1, 1]] * d, 80, rng)
    X = rng.uniform(-1, 1, (3000, d))
    y = np.abs(X).sum(axis=1) + 0.1 * rng.standard_normal(3000)
    whole = HingeProblem.from_data(mesh, X, y)
    parts = HingeProblem.from_chunks(mesh, zip(np.array_split(X, 7), np.array_split(y, 7), strict=True))
    assert parts.A is None
    assert parts.n_samples == whole.n_samples
    assert abs(parts.H - whole.H).max() <= 1e-10
    np.testing.assert_allclose(parts.c, whole.c, atol=1e-9)
    a, b = solve_engine(whole, 0.3, tol=1e-7), solve_engine(parts, 0.3, tol=1e-7)
    assert b.status.ok
    assert a.objective == pytest.approx(b.objective, rel=3e-7)


def test_samples_outside_raise_or_are_counted():
    rng = np.random.default_rng(1)
    mesh = SimplexMesh.uniform([[-1, 1]] * 2, 40, rng)
    X, y = rng.uniform(-1, 1, (100, 2)), rng.standard_normal(100)
    X[3] = 5.0
    with pytest.raises(OutsideMeshError, match="1 of 100 points lie outside"):
        HingeProblem.from_chunks(mesh, [(X, y)])
    assert HingeProblem.from_chunks(mesh, [(X, y)], outside="drop").n_dropped == 1


def test_bad_chunks_are_refused():
    mesh = SimplexMesh.uniform([[-1, 1]] * 2, 40, 0)
    with pytest.raises(InputError, match="expected 'raise' or 'drop'"):
        SampleSums(mesh, outside="ignore")
    with pytest.raises(InputError, match="expected pairs"):
        HingeProblem.from_chunks(mesh, [np.zeros((5, 2))])
    with pytest.raises(InputError, match="expected at least 4"):
        HingeProblem.from_chunks(mesh, [])
    with pytest.raises(InputError, match="NaN"):
        HingeProblem.from_chunks(mesh, [(np.full((5, 2), np.nan), np.zeros(5))])


def test_a_short_last_chunk_counts(rng):
    mesh = SimplexMesh.grid([[-1, 1]] * 2, (6, 6))
    X = rng.uniform(-1, 1, (501, 2))
    y = np.abs(X[:, 0])
    whole = HingeProblem.from_data(mesh, X, y)
    chunks = HingeProblem.from_chunks(mesh, ((X[k:k + 100], y[k:k + 100]) for k in range(0, 501, 100)))
    np.testing.assert_allclose(chunks.Aty, whole.Aty, atol=1e-12)
