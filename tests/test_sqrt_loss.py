"""The square-root loss of 2011 is a re-labelling of the same path."""

from __future__ import annotations

import numpy as np
import pytest

import pwaid
from pwaid import HingeProblem, SimplexMesh, solve, solve_sqrt
from pwaid.reference import solve_sqrt_reference
from pwaid.sqrt_loss import sqrt_gap, sqrt_weight


@pytest.fixture(params=[1, 2, 3])
def problem(request):
    d, rng = request.param, np.random.default_rng(request.param)
    mesh = SimplexMesh.uniform([[-1, 1]] * d, 60, rng)
    X = rng.uniform(-1, 1, (200, d))
    return HingeProblem.from_data(mesh, X, np.abs(X).sum(axis=1) + 0.1 * rng.standard_normal(200))


def test_every_lambda_has_its_weight_and_back(problem):
    solution = solve(problem, 0.2, tol=1e-8)
    w = sqrt_weight(problem, solution)
    assert sqrt_gap(problem, solution, w) < 1e-4
    found = solve_sqrt(problem, w, tol=1e-5)
    assert sqrt_gap(problem, found, w) <= 1e-5
    _, objective = solve_sqrt_reference(problem, w)
    mine = np.sqrt(2 * problem.loss(found.values)) + w * problem.penalty(found.values)
    assert mine == pytest.approx(objective, rel=2e-5)


def test_the_weight_does_not_depend_on_the_unit_of_y(problem):
    scaled = HingeProblem(problem.A, problem.F, 1e3 * problem.y)
    a, b = solve_sqrt(problem, 0.05), solve_sqrt(scaled, 0.05)
    assert b.lam == pytest.approx(1e3 * a.lam, rel=1e-2)


def test_a_small_weight_interpolates_the_samples():
    mesh = SimplexMesh.grid([[-1, 1]], 41)
    X = mesh.points[1::4]
    problem = HingeProblem.from_data(mesh, X, np.random.default_rng(0).standard_normal(len(X)))
    found = solve_sqrt(problem, 1e-4)
    assert sqrt_gap(problem, found, 1e-4) <= 1e-4
    np.testing.assert_allclose(problem.A @ found.values, problem.y, atol=1e-5)


def test_a_weight_must_be_positive(problem):
    with pytest.raises(pwaid.InputError, match="positive finite"):
        solve_sqrt(problem, -1.0)
