"""The certificate: a true lower bound, whatever comes in; the statistics say what the data say."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

import pwaid
from pwaid import HingeProblem, InputError, SimplexMesh, solve


@pytest.fixture
def problem(small):
    mesh, X, y, *_ = small
    return HingeProblem.from_data(mesh, X, y)


@pytest.fixture
def optimum(problem):
    return solve(problem, 0.05, method="clarabel", tol=1e-7)


def test_affine_fit_is_ordinary_least_squares(small, problem):
    mesh, X, y, *_ = small
    design = np.column_stack([X, np.ones(len(X))])
    beta = np.linalg.lstsq(design, y, rcond=None)[0]
    np.testing.assert_allclose(problem.affine_values, mesh.points @ beta[:2] + beta[2], atol=1e-9)
    assert problem.affine_loss == pytest.approx(0.5 * np.sum((y - design @ beta) ** 2))
    assert problem.objective(problem.affine_values, 7.0) == pytest.approx(problem.affine_loss)


def test_null_space_without_points_is_the_affine_functions(small, problem):
    mesh, X, y, *_ = small
    bare = HingeProblem(problem.A, problem.F, y)
    assert bare.affine_basis.shape == (mesh.n_points, 3)
    np.testing.assert_allclose(bare.affine_values, problem.affine_values, atol=1e-8)


def test_no_multiplier_proves_more_than_the_optimum(problem, optimum, rng):
    for size in (1e-3, 1e-1, 10.0):
        nu = optimum.nu + size * rng.standard_normal(problem.n_hinges)
        certificate, repaired = problem.certify(optimum.values, nu, optimum.lam)
        assert certificate.dual <= optimum.objective * (1 + 1e-9)
        residual = problem.c - problem.F.T @ repaired
        assert np.isfinite(residual).all()
    assert optimum.gap <= 1e-7


def test_an_inconsistent_multiplier_is_charged(problem, optimum):
    wrong = optimum.nu.copy()
    wrong[:50] = 0.0
    certificate = problem.certificate(optimum.values, optimum.values, wrong, optimum.lam)
    assert certificate.dual < optimum.objective


def test_certificate_of_a_worse_point_covers_the_distance(problem, optimum, rng):
    worse = optimum.values + 0.01 * rng.standard_normal(problem.n_points)
    certificate, _ = problem.certify(worse, optimum.nu, optimum.lam)
    truth = (problem.objective(worse, optimum.lam) - optimum.objective) / problem.objective(worse, optimum.lam)
    assert certificate.gap >= truth > 0


def test_statistics_give_the_same_problem(small, problem):
    mesh, X, y, *_ = small
    A = problem.A
    bare = HingeProblem.from_statistics(A.T @ A, A.T @ y, y @ y, problem.F, len(y), points=mesh.normalised)
    values = np.cos(mesh.points[:, 0])
    assert bare.objective(values, 0.3) == pytest.approx(problem.objective(values, 0.3), rel=1e-10)
    a, b = solve(bare, 0.05, tol=1e-6), solve(problem, 0.05, tol=1e-6)
    assert a.objective == pytest.approx(b.objective, rel=2e-6)


def test_offset_and_trend_change_nothing_but_the_affine_part(small):
    mesh, X, y, *_ = small
    trend = 1e6 + 1e4 * X[:, 0]
    a = HingeProblem.from_data(mesh, X, y)
    b = HingeProblem.from_data(mesh, X, y + trend)
    assert b.affine_loss == pytest.approx(a.affine_loss, rel=1e-8)
    np.testing.assert_allclose(b.c, a.c, atol=1e-6)
    assert not b.is_affine and HingeProblem.from_data(mesh, X, trend).is_affine


def test_constant_output_is_affine(small):
    mesh, X, *_ = small
    problem = HingeProblem.from_data(mesh, X, np.full(len(X), 3.0))
    assert problem.is_affine and pwaid.lambda_max(problem) == 0.0
    solution = solve(problem, 1.0)
    np.testing.assert_allclose(solution.values, 3.0, atol=1e-12)
    assert solution.gap == 0.0 and solution.n_broken == 0


def test_samples_outside_are_dropped_and_counted_on_request(small, rng):
    mesh, X, y, *_ = small
    X = np.vstack([X, [[5.0, 5.0], [6.0, 0.0]]])
    y = np.append(y, [0.0, 0.0])
    with pytest.raises(pwaid.OutsideMeshError, match="2 of 1002"):
        HingeProblem.from_data(mesh, X, y)
    assert HingeProblem.from_data(mesh, X, y, outside="drop").n_dropped == 2
    with pytest.raises(InputError, match="0 of 1002 samples lie inside"):
        HingeProblem.from_data(mesh, X + 100.0, y, outside="drop")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda A, F, y: (A, F, y[:-1]), "one output a row of A"),
        (lambda A, F, y: (A, F[:, :-1], y), "for the same mesh"),
        (lambda A, F, y: (A, F, np.r_[np.nan, y[1:]]), "y has 1 entries that are NaN"),
        (lambda A, F, y: (A, F * np.nan, y), "F has"),
        (lambda A, F, y: (A[:2], F, y[:2]), "2 samples came"),
    ],
)
def test_bad_problems(problem, change, message):
    with pytest.raises(InputError, match=message):
        HingeProblem(*change(problem.A, problem.F, problem.y))


def test_a_matrix_without_null_space_is_refused(problem):
    bare = HingeProblem(problem.A, sparse.eye_array(problem.n_points), problem.y)
    with pytest.raises(InputError, match="no null space"):
        _ = bare.affine_basis


def test_transposed_samples_and_one_bad_option(small):
    mesh, X, y, *_ = small
    with pytest.raises(InputError, match="transposed"):
        HingeProblem.from_data(mesh, X.T, y)
    with pytest.raises(InputError, match="expected 'raise' or 'drop'"):
        HingeProblem.from_data(mesh, X, y, outside="ignore")
    with pytest.raises(InputError, match="need at least 4"):
        HingeProblem.from_data(mesh, X[:3], y[:3])


def test_n_broken_counts_a_fold():
    mesh = SimplexMesh.grid([[-1, 1]] * 2, 9)
    X = mesh.points[:, :] * 0.999
    fold = np.maximum(mesh.points[:, 0], 0.0)
    problem = HingeProblem.from_data(mesh, X, np.maximum(X[:, 0], 0.0))
    assert problem.n_broken(fold) == 8 and problem.n_broken(problem.affine_values) == 0
