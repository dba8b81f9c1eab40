"""PWAMap: values, gradients, rules outside, files."""

from __future__ import annotations

import numpy as np
import pytest

from pwaid import InputError, OutsideMeshError, PWAMap, Scaling, SimplexMesh


@pytest.fixture(params=[1, 2, 3, 4])
def affine(request, rng):
    """An affine function as a map on a scaled mesh: every answer is known."""
    d = request.param
    scaling = Scaling.units(10.0 ** np.arange(d))
    mesh = SimplexMesh.from_points(rng.uniform(-1, 1, (40, d)) * 10.0 ** np.arange(d), scaling=scaling)
    slope = rng.standard_normal(d)
    return PWAMap(mesh, mesh.points @ slope + 2.0), slope


def test_values_and_gradients_of_an_affine_map_everywhere(affine, rng):
    f, slope = affine
    d = f.mesh.dimension
    X = 2.0 * rng.uniform(-1, 1, (300, d)) * 10.0 ** np.arange(d)
    np.testing.assert_allclose(f(X, outside="affine"), X @ slope + 2.0, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(f.gradient(X, outside="affine"), np.tile(slope, (300, 1)), rtol=1e-6, atol=1e-7)
    inside = f.mesh.contains(X)
    values = f(X, outside="nan")
    np.testing.assert_array_equal(np.isfinite(values), inside)
    np.testing.assert_array_equal(f.active_simplex(X) >= 0, inside)
    with pytest.raises(OutsideMeshError, match="lie outside the mesh"):
        f(X)


def test_gradient_is_the_derivative(rng):
    mesh = SimplexMesh.uniform([[-1, 1], [-10, 10]], 100, rng)
    f = PWAMap(mesh, rng.standard_normal(100))
    X = rng.uniform(-0.9, 0.9, (50, 2)) * [1, 10]
    step = 1e-7
    same = f.active_simplex(X) == f.active_simplex(X + [step, 0])
    slope = (f(X + [step, 0]) - f(X)) / step
    np.testing.assert_allclose(f.gradient(X)[same, 0], slope[same], rtol=1e-4, atol=1e-4)


def test_outside_follows_the_nearest_facet(rng):
    """|x| on a grid: beyond the left edge the left law holds, beyond the right edge the right one."""
    mesh = SimplexMesh.grid([[-1, 1], [-1, 1]], 5)
    f = PWAMap(mesh, np.abs(mesh.points[:, 0]))
    X = np.array([[-3.0, 0.1], [2.5, -0.2], [-0.6, 4.0]])
    np.testing.assert_allclose(f(X, outside="affine"), [3.0, 2.5, 0.6], atol=1e-12)


def test_nearest_facet_agrees_with_brute_force(rng):
    from scipy.optimize import nnls

    from pwaid import nearest

    for d in (2, 3):
        mesh = SimplexMesh.from_points(rng.standard_normal((25, d)))
        X = 3.0 * rng.standard_normal((40, d))
        X = X[~mesh.contains(X)]
        simplex, weights = mesh.locate(X)
        found, _ = nearest.extend(mesh, X, simplex, weights)
        s, j = mesh.boundary
        for x, mine in zip(X, found, strict=True):
            distances = []
            for a, b in zip(s, j, strict=True):
                V = mesh.points[np.delete(mesh.simplices[a], b)]
                big = 1e5  # the row that makes the weights sum to one
                w, _ = nnls(np.vstack([V.T, big * np.ones(d)]), np.append(x, big))
                distances.append(np.linalg.norm(V.T @ w - x))
            assert distances[list(s).index(mine)] <= min(distances) * (1 + 1e-6) or mine in s[
                np.array(distances) <= min(distances) * (1 + 1e-6)
            ]


def test_save_and_load_give_the_same_map(tmp_path, rng):
    mesh = SimplexMesh.gaussian(rng.standard_normal((200, 3)) * [1, 10, 100], 80, rng)
    f = PWAMap(mesh, rng.standard_normal(80))
    path = f.save(tmp_path / "map")
    assert path.suffix == ".npz"
    g = PWAMap.load(path)
    X = rng.standard_normal((100, 3)) * [1, 10, 100]
    np.testing.assert_array_equal(f(X, outside="affine"), g(X, outside="affine"))
    assert g.mesh.quality == mesh.quality and g.mesh.convex == mesh.convex


def test_complexity_per_simplex_is_where_the_fold_is():
    mesh = SimplexMesh.grid([[-1, 1]] * 2, 9)
    f = PWAMap(mesh, np.maximum(mesh.points[:, 0], 0.0))
    error = f.extrapolation_error()
    centre = mesh.points[mesh.simplices].mean(axis=1)[:, 0]
    assert np.all(error[np.abs(centre) > 0.26] < 1e-12) and error.max() > 0.1


def test_bad_maps(tmp_path):
    mesh = SimplexMesh.grid([[-1, 1]], 3)
    with pytest.raises(InputError, match="one a vertex"):
        PWAMap(mesh, [1.0])
    with pytest.raises(InputError, match="NaN or infinite"):
        PWAMap(mesh, [1.0, np.nan, 2.0])
    f = PWAMap(mesh, [1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="expected one of 'raise', 'nan', 'affine'"):
        f([[0.0]], outside="clip")
    with pytest.raises(ValueError, match="read-only"):
        f.values[0] = 0.0
    with pytest.raises(InputError, match="is not a file"):
        PWAMap.load(tmp_path / "none.npz")
    (tmp_path / "wrong.npz").write_text("no map")
    with pytest.raises(InputError, match="is not a pwaid map"):
        PWAMap.load(tmp_path / "wrong.npz")
