"""The engine: certified, in agreement with other routes, indifferent to scale, warm-started, and clear about misuse."""

import numpy as np
import pytest

from pwaid.admm import solve_admm
from pwaid.delaunay import SimplexMesh
from pwaid.engine import solve_engine
from pwaid.errors import InputError
from pwaid.lambda_max import lambda_max
from pwaid.lerp import WEIGHTINGS
from pwaid.problem import HingeProblem
from pwaid.solution import Status


def make(d=2, n=300, N=1000, *, weighting="pairs", scale=1.0, seed=0, X=None):
    rng = np.random.default_rng(seed)
    mesh = SimplexMesh.uniform([[-1.0, 1.0]] * d, n, rng)
    X = rng.uniform(-1, 1, (N, d)) if X is None else X
    y = scale * (np.abs(X).sum(axis=1) + 0.1 * rng.standard_normal(len(X)))
    return HingeProblem.from_data(mesh, X, y, weighting=weighting)


@pytest.fixture(scope="module")
def problem():
    return make()


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize(("d", "n", "N"), [(1, 60, 300), (2, 200, 1000), (2, 300, 60), (3, 150, 600)])
def test_certified_for_every_dimension_weighting_and_rank(d, n, N, weighting):
    problem = make(d, n, N, weighting=weighting)
    top = lambda_max(problem)
    for ratio in (1.0, 0.1, 1e-3):
        s = solve_engine(problem, ratio * top, tol=1e-6)
        assert s.status is Status.SOLVED
        # The certificate once more, from the parts of the solution alone: P − D bounds the distance to any optimum.
        assert s.gap <= 1e-6
        assert s.objective == pytest.approx(problem.objective(s.values, ratio * top), rel=1e-12)
        assert np.abs(s.nu).max() <= ratio * top * (1 + 1e-3)


def test_agrees_with_admm(problem):
    lam = 0.05 * lambda_max(problem)
    mine = solve_engine(problem, lam, tol=1e-9)
    other = solve_admm(problem, lam, tol=1e-5, max_iterations=20000)
    assert mine.objective == pytest.approx(other.objective, rel=1e-5)
    assert mine.objective <= other.objective * (1 + 1e-9)


def test_flat_above_lambda_max_and_bent_below(problem):
    top = lambda_max(problem)
    flat = solve_engine(problem, 1.5 * top, tol=1e-8)
    assert flat.n_broken == 0
    assert flat.objective == pytest.approx(problem.affine_loss, rel=1e-8)
    assert solve_engine(problem, 0.9 * top.lower, tol=1e-8).objective < problem.affine_loss * (1 - 1e-6)


@pytest.mark.parametrize("scale", [1e9, 1e-9])
def test_follows_the_scale_of_y(scale):
    one = solve_engine(make(), 0.1, tol=1e-8)
    other = solve_engine(make(scale=scale), 0.1 * scale, tol=1e-8)
    assert other.status.ok
    assert other.objective == pytest.approx(scale**2 * one.objective, rel=1e-6)


def test_clustered_samples(problem):
    rng = np.random.default_rng(3)
    X = np.vstack([rng.normal(0.3, 1e-3, (1000, 2)), rng.uniform(-1, 1, (100, 2))])
    clustered = make(X=X)
    for ratio in (0.3, 1e-3):
        assert solve_engine(clustered, ratio * lambda_max(clustered), tol=1e-6).status.ok


def test_warm_start_reaches_the_same_answer_in_fewer_iterations(problem):
    lambdas = lambda_max(problem) * np.geomspace(0.5, 0.005, 8)
    cold, warm, state = 0, 0, None
    for lam in lambdas:
        a = solve_engine(problem, lam, tol=1e-5)
        b = solve_engine(problem, lam, tol=1e-5, warm_start=state)
        assert b.status.ok
        assert b.objective == pytest.approx(a.objective, rel=2e-5)
        cold, warm, state = cold + a.iterations, warm + b.iterations, b.state
    assert warm < cold


def test_affine_data():
    rng = np.random.default_rng(5)
    X = rng.uniform(-1, 1, (200, 2))
    mesh = SimplexMesh.uniform([[-1, 1]] * 2, 60, rng)
    s = solve_engine(HingeProblem.from_data(mesh, X, 3.0 + X @ [2.0, -1.0]), 0.1)
    assert s.status.ok
    assert s.n_broken == 0


def test_from_statistics_agrees_without_coordinates(problem):
    other = HingeProblem.from_statistics(
        problem.H, problem.A.T @ problem.y, problem.y @ problem.y, problem.F, problem.n_samples
    )
    a, b = solve_engine(problem, 0.3, tol=1e-8), solve_engine(other, 0.3, tol=1e-8)
    assert b.status.ok
    assert a.objective == pytest.approx(b.objective, rel=1e-7)


def test_gives_up_honestly(problem):
    s = solve_engine(problem, 0.1, tol=1e-9, max_iterations=3)
    assert s.status is Status.MAX_ITERATIONS
    assert s.gap > 1e-9
    assert "raise max_iterations" in s.status.value


def test_an_impossible_tolerance_stalls_with_a_certificate(problem):
    s = solve_engine(problem, 0.1, tol=1e-17)
    assert s.status is Status.STALLED
    assert s.gap < 1e-8


@pytest.mark.parametrize(
    ("lam", "message"), [(0.0, "lam is 0"), (-1.0, "finite number"), (np.nan, "finite number"), ("x", "number > 0")]
)
def test_a_bad_lambda_is_refused(problem, lam, message):
    with pytest.raises(InputError, match=message):
        solve_engine(problem, lam)


def test_a_bad_tolerance_is_refused(problem):
    with pytest.raises(InputError, match="tol is 0"):
        solve_engine(problem, 0.1, tol=0)


def test_a_foreign_warm_start_is_refused(problem):
    with pytest.raises(InputError, match="not a state of this problem"):
        solve_engine(problem, 0.1, warm_start=solve_engine(make(n=50), 0.1).state)
    with pytest.raises(InputError, match="not a state of this problem"):
        solve_engine(problem, 0.1, warm_start="yesterday")
