"""The sparse Cholesky factorisation: it solves, whatever the order came from, and says when it cannot."""

import numpy as np
import pytest
from scipy import sparse

from pwaid.cholesky import NormalMatrix
from pwaid.delaunay import SimplexMesh
from pwaid.dissection import dissect
from pwaid.lerp import hinge_matrix
from pwaid.problem import HingeProblem


def make(d, n, N=200, seed=0):
    rng = np.random.default_rng(seed)
    mesh = SimplexMesh.uniform([[-1, 1]] * d, n, rng)
    X = rng.uniform(-1, 1, (N, d))
    return HingeProblem.from_data(mesh, X, rng.standard_normal(N)), mesh


def left_of_b(K, H, F, weights, rng):
    """What a solve with the last factorisation leaves of a random right-hand side, as a fraction of it."""
    b = rng.standard_normal(F.shape[1])
    full = H + F.T @ sparse.diags_array(weights) @ F
    return np.linalg.norm(full @ K.solve(b) - b) / np.linalg.norm(b)


@pytest.mark.parametrize("with_coordinates", [True, False])
@pytest.mark.parametrize(("d", "n"), [(1, 30), (1, 500), (2, 20), (2, 600), (3, 200)])
def test_solves_for_one_diagonal_after_another(d, n, with_coordinates):
    problem, mesh = make(d, n)
    rng = np.random.default_rng(1)
    K = NormalMatrix(problem.H, problem.F, mesh.normalised if with_coordinates else None)
    for spread in (0, 3):
        weights = 10.0 ** rng.uniform(-spread, spread, problem.n_hinges) / problem.row_norms**2
        assert K.factorise(weights)
        assert left_of_b(K, problem.H, problem.F, weights, rng) <= 1e-8


def test_parts_that_do_not_touch():
    problem, _ = make(2, 80)
    F = sparse.block_diag([problem.F, problem.F]).tocsr()
    H = sparse.block_diag([problem.H, problem.H]).tocsr()
    weights = 1.0 / np.tile(problem.row_norms, 2) ** 2
    K = NormalMatrix(H, F)
    assert K.factorise(weights)
    assert left_of_b(K, H, F, weights, np.random.default_rng(0)) <= 1e-8


def test_a_diagonal_takes_the_place_of_H():
    problem, mesh = make(2, 100)
    K = NormalMatrix(problem.H, problem.F, mesh.normalised)
    weights = 1.0 / problem.row_norms**2
    assert K.factorise(weights, diagonal=np.full(problem.n_points, 2.0))
    b = np.ones(problem.n_points)
    assert K.solve(b) == pytest.approx(np.full(problem.n_points, 0.5), rel=1e-9)  # F annihilates constants


def test_single_precision_solves_to_its_own_accuracy_and_leaves_the_double_one_alone():
    problem, mesh = make(2, 200)
    K = NormalMatrix(problem.H, problem.F, mesh.normalised)
    weights = 1.0 / problem.row_norms**2
    # A diagonal as heavy as that of FᵀDF keeps the scaled matrix well conditioned: what is left is rounding alone.
    heavy = np.asarray(problem.F.multiply(problem.F).T @ weights).ravel()
    H = sparse.diags_array(heavy)
    assert K.factorise(weights, diagonal=heavy, single=True)
    rounding = left_of_b(K, H, problem.F, weights, np.random.default_rng(0))
    assert 10 * np.finfo(float).eps < rounding < 100 * np.finfo(np.float32).eps
    assert K.factorise(weights, diagonal=heavy)
    assert left_of_b(K, H, problem.F, weights, np.random.default_rng(0)) < 100 * np.finfo(float).eps


def test_single_precision_says_when_it_is_not_enough():
    problem, mesh = make(2, 200)
    K = NormalMatrix(problem.H, problem.F, mesh.normalised)
    weights = 1.0 / problem.row_norms**2
    # FᵀDF annihilates affine functions; 1e-9 of its diagonal cures that in double precision (eps 2e-16), not in
    # single (6e-8).
    slight = 1e-9 * np.asarray(problem.F.multiply(problem.F).T @ weights).ravel()
    assert not K.factorise(weights, diagonal=slight, single=True)
    assert K.factorise(weights, diagonal=slight)


def test_breakdown_is_reported_and_a_shift_cures_it():
    problem, mesh = make(2, 100)
    K = NormalMatrix(problem.H, problem.F, mesh.normalised)
    assert not K.factorise(np.full(problem.n_hinges, -1.0))
    assert K.factorise(1.0 / problem.row_norms**2, diagonal=np.zeros(problem.n_points), shift=1e-8)


@pytest.mark.parametrize(("d", "n"), [(2, 1000), (3, 300)])
def test_the_order_is_a_permutation_with_sparse_fronts(d, n):
    F = hinge_matrix(SimplexMesh.uniform([[-1, 1]] * d, n, 0))
    pattern = (abs(F).T @ abs(F)).tocsr()
    mesh = SimplexMesh.uniform([[-1, 1]] * d, n, 0)
    tree = dissect(pattern.indptr, pattern.indices, mesh.normalised)
    assert np.array_equal(np.sort(tree.order), np.arange(n))
    assert np.all((tree.parents > np.arange(tree.parents.size)) | (tree.parents < 0))
    assert tree.n_stored < 0.3 * n * n


def test_a_problem_pickles_without_its_factorisation():
    import pickle

    problem, _ = make(2, 100)
    before = len(pickle.dumps(problem))
    assert problem.normal_matrix.factorise(1.0 / problem.row_norms**2)
    assert len(pickle.dumps(problem)) < 1.5 * before
