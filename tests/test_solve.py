"""Independent solvers agree to the gaps they report; iterative ones warm-start, stop, and say how they ended."""

from __future__ import annotations

import numpy as np
import pytest

import pwaid
from pwaid import HingeProblem, InputError, SimplexMesh, Status, lambda_max, solve
from pwaid.admm import ADMMState, solve_admm
from pwaid.lerp import WEIGHTINGS
from pwaid.solve import METHODS, SOLVERS

ITERATIVE = [m for m in METHODS if m not in SOLVERS]


def random_problem(seed):
    """d = 1…4, any weighting; every other one with fewer samples than unknowns (A rank-deficient)."""
    rng = np.random.default_rng(seed)
    d = 1 + seed % 4
    n = {1: 40, 2: 80, 3: 70, 4: 50}[d]
    mesh = SimplexMesh.uniform([[-1.0, 1.0]] * d, n, rng)
    n_samples = n // 2 if seed % 2 else 4 * n
    X = rng.uniform(-1, 1, (n_samples, d))
    y = np.abs(X).sum(axis=1) + np.maximum(X[:, 0], 0) + 0.1 * rng.standard_normal(n_samples)
    return HingeProblem.from_data(mesh, X, y, weighting=WEIGHTINGS[seed % 3])


@pytest.mark.parametrize("seed", range(20))
def test_solvers_agree_to_the_gaps_they_report(seed):
    problem = random_problem(seed)
    lam = float(lambda_max(problem)) * 10.0 ** -(1 + seed % 3)
    solutions = [solve(problem, lam, method=m, tol=1e-6) for m in (*ITERATIVE, "clarabel", "osqp")]
    for s in solutions:
        assert s.gap <= 1e-4, f"{s.method}: {s.gap}, {s.message}"
        assert s.objective == pytest.approx(problem.objective(s.values, lam), rel=1e-12)
        assert np.abs(s.nu).max() >= 0
    assert solutions[0].status.ok and solutions[-2].gap <= 1e-6
    for a in solutions:
        for b in solutions:  # b's value is at least the optimum, which is at least a's value less a's gap
            assert b.objective >= a.objective * (1 - a.gap) * (1 - 1e-9)


@pytest.mark.parametrize("method", ITERATIVE)
def test_warm_start_gives_the_same_solution_as_a_fresh_one(small, method):
    mesh, X, y, *_ = small
    problem = HingeProblem.from_data(mesh, X, y)
    first = solve(problem, 0.1, method=method, tol=1e-6)
    warm = solve(problem, 0.08, method=method, tol=1e-7, warm_start=first.state)
    cold = solve(problem, 0.08, method=method, tol=1e-7)
    assert warm.objective == pytest.approx(cold.objective, rel=2e-7)
    again = solve(problem, 0.08, method=method, tol=1e-7, warm_start=warm.state)
    assert again.iterations <= cold.iterations


@pytest.mark.parametrize("method", ITERATIVE)
@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_units_of_y_do_not_matter(small, method, scale):
    mesh, X, y, *_ = small
    base = solve(HingeProblem.from_data(mesh, X, y), 0.05, method=method, tol=1e-5)
    scaled = solve(HingeProblem.from_data(mesh, X, y * scale), 0.05 * scale, method=method, tol=1e-5)
    assert scaled.status.ok and scaled.objective / scale**2 == pytest.approx(base.objective, rel=2e-5)


def test_soft_threshold_signs_and_flat_solution_above_lambda_max(small):
    mesh, X, y, *_ = small
    problem = HingeProblem.from_data(mesh, X, y)
    bounds = lambda_max(problem)
    flat = solve(problem, 1.01 * bounds.upper, tol=1e-7)
    just_below = solve(problem, 0.97 * bounds.lower, tol=1e-7)
    assert flat.n_broken == 0 and flat.objective == pytest.approx(problem.affine_loss, rel=1e-7)
    assert just_below.n_broken > 0 and just_below.objective < problem.affine_loss * (1 - 1e-6)


def test_giving_up_is_said(small):
    mesh, X, y, *_ = small
    solution = solve_admm(HingeProblem.from_data(mesh, X, y), 0.05, tol=1e-9, max_iterations=3)
    assert solution.status is Status.MAX_ITERATIONS and "raise max_iterations" in solution.status.value
    assert solution.iterations == 3 and solution.gap > 1e-9
    with pytest.raises(pwaid.SolverError, match="ended with gap"):
        solution.require_ok()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lam": 0.0}, "plain least squares"),
        ({"lam": -1.0}, "positive finite"),
        ({"lam": np.nan}, "positive finite"),
        ({"lam": "a"}, "expected a positive number"),
        ({"lam": 1.0, "method": "magic"}, "expected one of 'auto'"),
        ({"lam": 1.0, "tol": 0.0}, "between 0 and 1"),
        ({"lam": 1.0, "method": "admm", "warm_start": 3}, "does not belong to this problem"),
        ({"lam": 1.0, "warm_start": 3}, "not a state of this problem"),
        ({"lam": 1.0, "method": "admm", "warm_start": ADMMState(np.zeros(2), np.zeros(2), 1.0, 1.0)}, "same mesh"),
    ],
)
def test_bad_calls(small, options, message):
    mesh, X, y, *_ = small
    with pytest.raises(InputError, match=message):
        solve(HingeProblem.from_data(mesh, X, y), **options)


def test_solution_arrays_are_read_only(small):
    mesh, X, y, *_ = small
    solution = solve(HingeProblem.from_data(mesh, X, y), 1.0)
    with pytest.raises(ValueError, match="read-only"):
        solution.values[0] = 1.0
