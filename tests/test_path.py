"""Paths: the grid, the choice of λ, and that a path never dies midway."""

from __future__ import annotations

import numpy as np
import pytest

import pwaid
from pwaid import HingeProblem, InputError, Status, cross_validate, solve_path
from pwaid.path import fold_labels, lambda_grid
from tests.conftest import pyramid


@pytest.fixture(scope="module")
def path(small):
    mesh, X, y, X_val, y_val = small
    problem = HingeProblem.from_data(mesh, X, y)
    return solve_path(problem, n_lambdas=13, start=2.0, tol=1e-3, X_val=X_val, y_val=y_val, mesh=mesh)


def test_the_grid_runs_from_twice_lambda_max_downwards(path):
    assert path.lambdas[0] == pytest.approx(2 * path.lambda_max)
    assert path.lambdas[-1] == pytest.approx(1e-4 * path.lambda_max)
    np.testing.assert_allclose(np.diff(np.log(path.lambdas)), np.log(path.lambdas[1] / path.lambdas[0]))


def test_pyramid_is_flat_above_lambda_max_and_broken_below(path):
    broken = path.n_broken
    assert np.all(broken[path.lambdas >= path.lambda_max] == 0)
    assert np.all(broken[path.lambdas < 0.9 * path.lambda_max] > 0)
    assert np.all(path.gaps <= 1e-3)


def test_loss_falls_and_penalty_rises_with_smaller_lambda(path, small):
    mesh, X, y, *_ = small
    problem = HingeProblem.from_data(mesh, X, y)
    loss = [problem.loss(s.values) for s in path.solutions]
    penalty = [problem.penalty(s.values) for s in path.solutions]
    assert np.all(np.diff(loss) < 1e-3 * loss[0]) and np.all(np.diff(penalty) > -1e-3 * penalty[-1])


def test_pyramid_reproduction_best_lambda_and_error_against_the_truth():
    """2014 Example 1 at N̂ = 2000 (full size in examples/pyramid_path.py), both penalties."""
    rng = np.random.default_rng(0)
    X, X_val, X_test = rng.uniform(-1.1, 1.1, (3, 2000, 2))
    y, y_val = (pyramid(Z) + 0.1 * rng.standard_normal(2000) for Z in (X, X_val))
    mesh = pwaid.SimplexMesh.uniform([[-1.1, 1.1]] * 2, 2000, rng)
    for weighting in ("pairs", "htv"):
        problem = HingeProblem.from_data(mesh, X, y, weighting=weighting)
        path = solve_path(problem, n_lambdas=15, start=2.0, tol=1e-3, X_val=X_val, y_val=y_val, mesh=mesh)
        error = [np.sqrt(np.mean((s.map(X_test) - pyramid(X_test)) ** 2)) for s in path.solutions]
        assert 3e-3 <= path.best.lam / path.lambda_max <= 2e-2
        assert error[path.best_index] < 0.0205
        assert error[path.best_index] < 0.2 * min(error[0], error[-1])
        assert path.validation_rmse[path.best_index] < 0.105


def test_one_standard_error_rule_prefers_a_simpler_map(path):
    from dataclasses import replace

    simpler = replace(path, rule="1se")
    assert simpler.best.lam >= path.best.lam
    limit = path.validation_rmse.min() + path.validation_se[path.best_index]
    assert simpler.validation_rmse[simpler.best_index] <= limit


def test_text_of_a_path_marks_the_choice(path):
    lines = str(path).splitlines()
    assert len(lines) == 14 and sum("← best" in line for line in lines) == 1


def test_a_failing_solve_keeps_its_place(small, monkeypatch):
    mesh, X, y, X_val, y_val = small
    problem = HingeProblem.from_data(mesh, X, y)
    true_solve, calls = pwaid.path.solve, []

    def sometimes(*args, **options):
        calls.append(args[1])
        if len(calls) == 2:
            raise RuntimeError("factor is exactly singular")
        return true_solve(*args, **options)

    monkeypatch.setattr(pwaid.path, "solve", sometimes)
    path = solve_path(problem, lambdas=[1.0, 0.1, 0.01], tol=1e-2, X_val=X_val, y_val=y_val, mesh=mesh)
    assert [s.status for s in path.solutions] == [Status.SOLVED, Status.FAILED, Status.SOLVED]
    assert "exactly singular" in path.solutions[1].message and np.isnan(path.validation_rmse[1])
    assert path.best_index == 2


def test_progress_is_called_for_every_lambda(small):
    mesh, X, y, *_ = small
    seen = []
    problem = HingeProblem.from_data(mesh, X, y)
    solve_path(problem, lambdas=[1.0, 0.5], tol=1e-2, progress=lambda i, n, s: seen.append((i, n, s.lam)))
    assert seen == [(0, 2, 1.0), (1, 2, 0.5)]


def test_cross_validation_chooses_like_held_out_data(small, path):
    mesh, X, y, *_ = small
    cv = cross_validate(mesh, X, y, k=3, n_lambdas=9, ratio=1e-3, tol=1e-2, rng=0)
    assert cv.validation_rmse.shape == cv.validation_se.shape == (9,)
    assert abs(np.log10(cv.best.lam / path.best.lam)) < 0.8
    assert cv.best.map is not None and 0.09 < cv.validation_rmse.min() < 0.13


def test_folds_share_the_samples():
    for kind in ("random", "blocks"):
        label = fold_labels(11, 3, kind, 0)
        assert sorted(np.bincount(label)) == [3, 4, 4]
    assert np.all(np.diff(fold_labels(11, 3, "blocks")) >= 0)


def test_affine_data_give_one_flat_map_and_a_note(small):
    mesh, X, *_ = small
    path = solve_path(HingeProblem.from_data(mesh, X, X @ [1.0, 2.0]), mesh=mesh)
    assert len(path) == 1 and path.lambda_max == 0.0 and "affine function" in path.warnings[0]


def test_held_out_samples_outside_are_counted(small):
    mesh, X, y, X_val, y_val = small
    X_val = X_val.copy()
    X_val[:7] += 10.0
    path = solve_path(HingeProblem.from_data(mesh, X, y), lambdas=[0.1], tol=1e-2, X_val=X_val, y_val=y_val, mesh=mesh)
    assert "7 of 1000 held-out samples lie outside" in path.warnings[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"X_val": np.zeros((3, 2))}, "give both X_val and y_val"),
        ({"X_val": np.zeros((3, 2)), "y_val": np.zeros(3)}, "without mesh="),
        ({"rule": "best"}, "expected one of 'min', '1se'"),
        ({"method": "magic"}, "expected one of 'auto'"),
        ({"lambdas": [1.0, -1.0]}, "positive finite"),
        ({"n_lambdas": 0}, "at least 1"),
        ({"ratio": 2.0}, "0 < ratio < start"),
        ({"mesh": pwaid.SimplexMesh.grid([[-1, 1]] * 2, 3)}, "the mesh has 9 points, the problem 500"),
    ],
)
def test_bad_calls(small, options, message):
    mesh, X, y, *_ = small
    with pytest.raises(InputError, match=message):
        solve_path(HingeProblem.from_data(mesh, X, y), **options)


def test_a_path_without_held_out_data_has_no_best(small):
    mesh, X, y, *_ = small
    path = solve_path(HingeProblem.from_data(mesh, X, y), lambdas=[1.0], tol=1e-2)
    with pytest.raises(InputError, match="no validation error"):
        _ = path.best
    with pytest.raises(InputError, match="every held-out sample lies outside"):
        solve_path(HingeProblem.from_data(mesh, X, y), lambdas=[1.0], mesh=mesh, X_val=X + 100, y_val=y)
    assert lambda_grid(2.0, 2, 0.5)[1] == 1.0


def test_folds_without_an_inputs_movement_are_left_out(rng):
    mesh = pwaid.SimplexMesh.grid([[-1, 1], [0, 1]], (5, 3))
    X = np.column_stack([rng.uniform(-1, 1, 100), np.r_[np.zeros(85), np.ones(15)]])
    y = np.abs(X[:, 0]) + X[:, 1]
    path = cross_validate(mesh, X, y, folds="blocks", n_lambdas=3)
    assert any("fold 4 is left out" in note for note in path.warnings)
    assert np.all(np.isfinite(path.validation_rmse))
    with pytest.raises(InputError, match="every fold holds"):
        cross_validate(mesh, X[75:95], y[75:95], k=2, folds="blocks", n_lambdas=3)


def test_a_mesh_without_hinges_gives_the_affine_fit(rng):
    mesh = pwaid.SimplexMesh.from_points([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    X = rng.dirichlet([1, 1, 1], 30)[:, :2]
    y = X @ [1.0, -2.0] + 0.1 * rng.normal(size=30)
    problem = HingeProblem.from_data(mesh, X, y)
    assert float(pwaid.lambda_max(problem)) == 0.0
    path = solve_path(problem, mesh=mesh, X_val=X, y_val=y)
    assert path.best.status is Status.SOLVED and "no hinge" in path.warnings[-1]
    with pytest.raises(InputError, match="y_val has 1 entries"):
        solve_path(problem, mesh=mesh, X_val=X, y_val=np.r_[np.nan, y[1:]])
