"""λmax: both bounds hold, the flat solution begins there, and every scale and rank is served."""

import pickle

import numpy as np
import pytest

from pwaid.admm import solve_admm
from pwaid.delaunay import SimplexMesh
from pwaid.errors import InputError
from pwaid.lambda_max import LambdaMax, lambda_max
from pwaid.lerp import WEIGHTINGS
from pwaid.problem import HingeProblem


def make(d, n, N, *, weighting="pairs", scale=1.0, seed=0):
    rng = np.random.default_rng(seed)
    mesh = SimplexMesh.uniform([[-1.0, 1.0]] * d, n, rng)
    X = rng.uniform(-1, 1, (N, d))
    y = scale * (np.abs(X).sum(axis=1) + 0.1 * rng.standard_normal(N))
    return HingeProblem.from_data(mesh, X, y, weighting=weighting)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize(
    ("d", "n", "N"), [(1, 40, 200), (2, 200, 1000), (2, 200, 60), (3, 120, 500), (3, 150, 60)]
)
def test_bounds_are_tight_and_ordered(d, n, N, weighting):
    found = lambda_max(make(d, n, N, weighting=weighting))
    assert isinstance(found, float)
    assert 0.0 < found.lower <= found.upper == float(found)
    assert found.width <= 1e-5


@pytest.mark.parametrize("d", [1, 2, 3])
def test_bounds_hold_against_the_solver(d):
    problem = make(d, 60, 400)
    found = lambda_max(problem)
    flat = solve_admm(problem, 1.01 * found.upper, tol=1e-7, max_iterations=20000)
    assert flat.objective == pytest.approx(problem.affine_loss, rel=1e-6)
    bent = solve_admm(problem, 0.9 * found.lower, tol=1e-7, max_iterations=20000)
    assert bent.objective < problem.affine_loss * (1 - 1e-5)


def test_follows_the_scale_of_y():
    one = lambda_max(make(2, 150, 600))
    for scale in (1e9, 1e-9):
        assert lambda_max(make(2, 150, 600, scale=scale)) == pytest.approx(scale * one, rel=2e-6)


def test_a_kink_at_one_vertex_has_a_known_value():
    # One inner vertex in d = 1: λmax = |cᵀv| / ‖Fv‖₁ for the only v that is not affine.
    mesh = SimplexMesh.from_points(np.array([0.0, 0.4, 1.0]))
    rng = np.random.default_rng(1)
    x = rng.uniform(0, 1, 50)
    problem = HingeProblem.from_data(mesh, x[:, None], rng.standard_normal(50))
    v = np.array([0.0, 1.0, 0.0])
    assert lambda_max(problem) == pytest.approx(abs(problem.c @ v) / np.abs(problem.F @ v).sum(), rel=1e-6)


def test_affine_data_give_zero():
    rng = np.random.default_rng(2)
    mesh = SimplexMesh.uniform([[-1, 1]] * 2, 50, rng)
    X = rng.uniform(-1, 1, (200, 2))
    found = lambda_max(HingeProblem.from_data(mesh, X, 3.0 + X @ [2.0, -1.0]))
    assert (found, found.lower, found.upper, found.width) == (0.0, 0.0, 0.0, 0.0)


def test_a_bad_tolerance_is_refused():
    with pytest.raises(InputError, match="expected a relative width"):
        lambda_max(make(1, 10, 50), tol=0.0)


def test_it_pickles():
    found = LambdaMax(1.0, 1.5)
    copy = pickle.loads(pickle.dumps(found))
    assert (copy, copy.lower, copy.upper) == (1.5, 1.0, 1.5)
    assert "lower=1" in repr(copy)
