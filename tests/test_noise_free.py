"""Noise-free samples: the fewest hinges are recovered, and the certificate says when that is proved."""

from __future__ import annotations

import numpy as np
import pytest

from pwaid import HingeProblem, InputError, SimplexMesh, solve_noise_free


def fold(X):
    return np.maximum(X[:, 0], 0.0) + 0.5 * X[:, 1]


@pytest.fixture
def mesh():
    return SimplexMesh.grid([[-1, 1]] * 2, 21)


@pytest.mark.parametrize("n_samples", [150, 1200])
def test_a_fold_on_the_mesh_is_recovered_and_proved_unique(mesh, rng, n_samples):
    X = rng.uniform(-1, 1, (n_samples, 2))
    found = solve_noise_free(HingeProblem.from_data(mesh, X, fold(X)))
    assert found.unique and found.n_broken == 20
    np.testing.assert_allclose(found.values, fold(mesh.points), atol=1e-7)
    assert abs(found.gap) < 1e-6 and found.residual < 1e-9


def test_an_unseen_corner_is_not_called_unique(rng):
    """Two folds explain samples on three lines equally well: the certificate must not claim uniqueness."""
    mesh = SimplexMesh.grid([[-1, 1]], 21)
    X = np.array([[-0.95], [-0.55], [0.55], [0.95]])
    found = solve_noise_free(HingeProblem.from_data(mesh, X, np.abs(X[:, 0])))
    assert not found.unique
    assert found.penalty == pytest.approx(2 * 2.0 * 0.1, rel=1e-6)  # jump 2 times (h + h′), wherever it bends


def test_noisy_samples_are_refused(mesh, rng):
    X = np.repeat(rng.uniform(-1, 1, (60, 2)), 2, axis=0)
    with pytest.raises(InputError, match="no map on this mesh meets the 120 samples exactly"):
        solve_noise_free(HingeProblem.from_data(mesh, X, rng.standard_normal(120)))


def test_an_affine_function_needs_no_hinge(rng):
    mesh = SimplexMesh.grid([0, 1], 9)
    x = rng.uniform(0, 1, 12)
    found = solve_noise_free(HingeProblem.from_data(mesh, x, 2 * x + 1))
    assert found.penalty == 0.0 and found.residual < 1e-12 and found.n_broken == 0
