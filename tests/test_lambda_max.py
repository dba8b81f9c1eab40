"""λmax: both bounds hold, the flat solution begins there, and every scale and rank is served."""

import pickle

import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import linprog

from pwaid.admm import solve_admm
from pwaid.delaunay import SimplexMesh
from pwaid.errors import InputError
from pwaid.lambda_max import LambdaMax, lambda_max
from pwaid.lerp import WEIGHTINGS, hinge_matrix, interpolation_matrix
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
    assert found.width <= 1e-6


@pytest.mark.parametrize("d", [1, 2, 3])
def test_bounds_hold_against_the_solver(d):
    problem = make(d, 60, 400)
    found = lambda_max(problem)
    flat = solve_admm(problem, 1.01 * found.upper, tol=1e-7, max_iterations=20000)
    assert flat.objective == pytest.approx(problem.affine_loss, rel=1e-6)
    bent = solve_admm(problem, 0.9 * found.lower, tol=1e-7, max_iterations=20000)
    assert bent.objective < problem.affine_loss * (1 - 1e-5)


def lp_value(mesh, X, y):
    """min t subject to Fᵀz = c, −t ≤ z ≤ t by HiGHS, c from a plain least-squares fit (2014 eq. 13–15)."""
    A, F = interpolation_matrix(mesh, X), hinge_matrix(mesh)
    affine = np.column_stack([np.ones(len(X)), X])
    c = A.T @ (y - affine @ np.linalg.lstsq(affine, y, rcond=None)[0])
    size, m = np.linalg.norm(c), F.shape[0]
    cost = np.append(np.zeros(m), 1.0)
    equal = sparse.hstack([F.T, sparse.csr_array((F.shape[1], 1))])
    t = np.ones((m, 1))
    box = sparse.vstack([sparse.hstack([sparse.eye_array(m), -t]), sparse.hstack([-sparse.eye_array(m), -t])])
    found = linprog(
        cost, A_ub=box, b_ub=np.zeros(2 * m), A_eq=equal, b_eq=c / size, bounds=(None, None), method="highs-ds",
        options={"primal_feasibility_tolerance": 1e-9, "dual_feasibility_tolerance": 1e-9},
    )  # fmt: skip
    assert found.status == 0, found.message
    return found.fun * size


@pytest.mark.parametrize(("d", "n", "N"), [(1, 40, 200), (2, 60, 300), (3, 40, 200)])
def test_bounds_hold_the_value_of_the_linear_programme(d, n, N):
    rng = np.random.default_rng(4)
    mesh = SimplexMesh.uniform([[-1.0, 1.0]] * d, n, rng)
    X = rng.uniform(-1, 1, (N, d))
    y = np.abs(X).sum(axis=1) + 0.1 * rng.standard_normal(N)
    value, found = lp_value(mesh, X, y), lambda_max(HingeProblem.from_data(mesh, X, y))
    judge = 1e-7  # relative; what HiGHS may be off by
    assert found.lower <= value * (1 + judge)
    assert found.upper >= value * (1 - judge)
    assert found.width <= 1e-6


def test_a_large_uniform_mesh_keeps_its_width():
    # Slivers and nearly equal optima: FᵀDF alone is singular to rounding along the optimal v long before 1e-6.
    rng = np.random.default_rng(3)
    mesh = SimplexMesh.uniform([[-1.0, 1.0]] * 2, 4000, rng)
    X = rng.uniform(-1, 1, (1000, 2))
    y = np.maximum(0.5 - np.abs(X).sum(axis=1), 0.0) + 0.1 * rng.standard_normal(1000)
    assert lambda_max(HingeProblem.from_data(mesh, X, y)).width <= 1e-6


def test_one_input_has_one_multiplier_however_uneven_the_mesh():
    # d = 1: v = max(t_k − t, 0) bends at vertex k alone, so cᵀv = zᵀFv gives z at that vertex.
    rng = np.random.default_rng(5)
    points = np.sort(rng.uniform(-1, 1, 400))
    assert np.diff(points).min() < 1e-4 * np.diff(points).max()
    X = rng.uniform(points[0], points[-1], (150, 1))
    mesh = SimplexMesh.from_points(points)
    problem = HingeProblem.from_data(mesh, X, rng.standard_normal(150))
    t, c = mesh.points[:, 0], problem.c
    bends = np.maximum(np.sort(t)[1:-1] - t[:, None], 0.0)
    z = (c @ bends) / np.abs(problem.F @ bends).max(axis=0)
    found = lambda_max(problem)
    assert found.width <= 1e-6
    assert found == pytest.approx(np.abs(z).max(), rel=1e-6)


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


def test_more_than_rounding_allows_gives_what_was_reached():
    found, strict = (lambda_max(make(2, 300, 900), tol=tol) for tol in (1e-6, 1e-14))
    assert strict.width <= found.width
    assert found.lower <= strict.lower * (1 + 1e-12) and strict.upper <= found.upper * (1 + 1e-12)


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
