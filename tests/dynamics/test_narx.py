"""NARX models: regressors, the convex fit, and what it must reproduce."""

from __future__ import annotations

import numpy as np
import pytest

from pwaid.delaunay import SimplexMesh
from pwaid.dynamics.fit_measures import explained_percent, fit_percent, rmse
from pwaid.dynamics.narx import NARX
from pwaid.dynamics.regressors import Lags
from pwaid.errors import InputError, OutsideMeshError
from pwaid.pwa_map import PWAMap
from pwaid.recording import Recording


def record(n=600, rng=0, noise=0.0, kink=0.4, name="r"):
    """y(k) = 0.6 y(k−1) − kink·max(y(k−1), 0) + 0.5 u(k) + 0.2 u(k−1)."""
    rng = np.random.default_rng(rng)
    u = np.repeat(rng.normal(size=-(-n // 5)), 5)[:n]
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = 0.6 * y[k - 1] - kink * max(y[k - 1], 0) + 0.5 * u[k] + 0.2 * u[k - 1]
        y[k] += noise * rng.normal()
    return Recording(0.1 * np.arange(n), u, y, input_names="u", output_names="y", name=name)


# -- regressors ----------------------------------------------------------------------------------------------------


def test_regressors_are_the_lags_they_are_named_after():
    n = 12
    r = Recording(np.arange(n), np.column_stack([np.arange(n), 100 + np.arange(n)]), 1000 + np.arange(n))
    lags = Lags(2, 1, True)
    names = lags.names(r.output_names, r.input_names)
    assert names == ("y0(k-1)", "y0(k-2)", "u0(k)", "u0(k-1)", "u1(k)", "u1(k-1)")
    phi, y = lags.build(r)
    k = np.arange(2, n)
    np.testing.assert_array_equal(
        phi, np.column_stack([1000 + k - 1, 1000 + k - 2, k, k - 1, 100 + k, 100 + k - 1])
    )
    np.testing.assert_array_equal(y[:, 0], 1000 + k)


def test_regressors_never_straddle_recordings():
    a, b = record(50, 1), record(40, 2)
    phi, y = Lags(3, 2, False).build([a, b])
    assert len(phi) == len(y) == 47 + 37
    np.testing.assert_array_equal(phi[47:], Lags(3, 2, False).build(b)[0])


def test_the_structure_of_2014_example_2_has_its_three_regressors():
    assert NARX(output_lags=2, input_lags=0, direct=True).names(record()) == ("y(k-1)", "y(k-2)", "u(k)")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: NARX(output_lags=-1), "output_lags is -1; expected a whole number"),
        (lambda: NARX(output_lags=1.5), "expected a whole number"),
        (lambda: NARX(output_lags=0, input_lags=0, direct=False), "the model has no regressors"),
        (lambda: NARX(nonlinear=("z(k)",)).select(record()), "expected different names out of"),
        (lambda: NARX(2, 0, True, nonlinear=[[1.0, 0.0]]).select(record()), r"nonlinear has shape \(1, 2\)"),
        (lambda: NARX(30, 1, True).problem(record(20)), "lags of 30 need at least 31"),
        (lambda: NARX().problem([]), "non-empty list"),
        (lambda: NARX().problem([record(), record().decimate(2)]), "expected one sample time"),
        (lambda: NARX(1, 0, True).problem(record(), SimplexMesh.uniform([[0, 1]] * 3, 30, 0)), "the mesh has 3 dim"),
        (lambda: NARX(1, 0, True).problem(record(), SimplexMesh.uniform([[90, 91]] * 2, 30, 0)), "same units"),
    ],
)
def test_bad_structures_get_one_clear_error(make, message):
    with pytest.raises(InputError, match=message):
        make()


# -- fit -----------------------------------------------------------------------------------------------------------


def test_an_affine_system_is_found_exactly_and_every_lambda_agrees():
    r = record(kink=0.0)
    linear = NARX(1, 1, True, nonlinear=("y(k-1)",)).fit(r, np.inf, n_points=10, rng=0)
    kinked = NARX(1, 1, True, nonlinear=("y(k-1)",)).fit(r, 1e-3, n_points=10, rng=0)
    for model in (linear, kinked):
        np.testing.assert_allclose(model.predict(r), r.outputs, atol=1e-8)
        assert model.simulate(r).rmse(r.outputs) < 1e-8


def test_partially_linear_equals_least_squares_when_the_hinge_is_free():
    """With a mesh that has a vertex at the kink and λ → 0, the fit is least squares on the true structure."""
    r = record(2000, 3, noise=0.02)
    mesh = SimplexMesh.from_points(np.array([-6.0, 0.0, 6.0]))
    model = NARX(1, 1, True, nonlinear=("y(k-1)",)).fit(r, 1e-6, mesh, tol=1e-8)
    phi, y = Lags(1, 1, True).build(r)
    basis = np.column_stack([phi[:, 0], np.maximum(phi[:, 0], 0), phi[:, 1:], np.ones(len(phi))])
    truth = np.linalg.lstsq(basis, y[:, 0], rcond=None)[0]
    np.testing.assert_allclose(model.predict(r)[1:, 0], basis @ truth, atol=1e-5)
    np.testing.assert_allclose(model.theta[0], [0, truth[2], truth[3]], atol=1e-5)


def test_a_free_run_chooses_lambda_and_beats_the_linear_model():
    train, validation, test = (record(800, s, noise=0.05) for s in (4, 5, 6))
    problem = NARX(1, 1, True, nonlinear=("y(k-1)",)).problem(train, n_points=25, rng=0)
    path = problem.path(problem.lambda_max() * np.logspace(0.1, -3, 6), validation)
    assert path.free_run_rmse[0] == pytest.approx(problem.linear().free_run_rmse([validation]), rel=0.02)
    assert path.best_index == np.argmin(path.free_run_rmse) > 0
    assert path.best.free_run_rmse([test]) < 0.5 * problem.linear().free_run_rmse([test])
    assert all(s.gap <= 1e-4 for (s,) in path.solutions)


def test_every_regressor_meshed_gives_the_same_affine_model_as_the_partially_linear_one():
    r = record(500, 7, noise=0.1)
    whole = NARX(1, 0, True).fit(r, np.inf, n_points=30, rng=0)
    partly = NARX(1, 0, True, nonlinear=("u(k)",)).fit(r, np.inf, n_points=10, rng=0)
    np.testing.assert_allclose(whole.predict(r), partly.predict(r), atol=1e-9)


def test_samples_outside_a_given_mesh_are_left_out_and_counted():
    r = record(500, 8)
    mesh = SimplexMesh.uniform([[-0.5, 0.5], [-1, 1]], 40, 0)
    problem = NARX(1, 0, True).problem(r, mesh)
    X, _ = NARX(1, 0, True).regressors(r)
    assert problem.n_dropped == np.sum(~mesh.contains(X)) > 0


def test_two_outputs_share_a_mesh_and_keep_their_own_maps():
    rng = np.random.default_rng(9)
    u = rng.normal(size=400)
    y = np.zeros((400, 2))
    for k in range(1, 400):
        y[k] = [0.5 * y[k - 1, 0] + u[k], 0.3 * y[k - 1, 1] - 0.2 * y[k - 1, 0]]
    r = Recording(np.arange(400.0), u, y)
    model = NARX(1, 0, True).fit(r, np.inf, n_points=40, rng=0)
    assert model.n_outputs == 2 and len(model.maps) == 2 and model.n_inputs == 1
    np.testing.assert_allclose(model.simulate(r).outputs, y, atol=1e-8)


# -- prediction ----------------------------------------------------------------------------------------------------


def test_wrap_predicts_what_the_map_says():
    r = record(200, 10)
    mesh = SimplexMesh.uniform([[-3, 3], [-4, 4]], 60, 0)
    pwa = PWAMap(mesh, np.abs(mesh.points[:, 0]) + mesh.points[:, 1])
    model = NARX(1, 0, True).wrap(pwa)
    X, _ = NARX(1, 0, True).regressors(r)
    np.testing.assert_array_equal(model.predict(r)[1:, 0], pwa(X, outside="affine"))
    np.testing.assert_array_equal(model.predict(r)[:1], r.outputs[:1])


def test_wrap_needs_one_mesh_and_no_names():
    a, b = SimplexMesh.uniform([[0, 1]] * 2, 20, 0), SimplexMesh.uniform([[0, 1]] * 2, 20, 1)
    maps = [PWAMap(m, m.points[:, 0]) for m in (a, b)]
    with pytest.raises(InputError, match="same mesh object"):
        NARX(1, 0, True).wrap(maps)
    with pytest.raises(InputError, match="not names"):
        NARX(1, 0, True, nonlinear=("y(k-1)",)).wrap(maps[0])


def test_predicting_outside_the_mesh_can_raise():
    r = record(200, 11)
    mesh = SimplexMesh.uniform([[-0.1, 0.1], [-0.1, 0.1]], 20, 0)
    model = NARX(1, 0, True).wrap(PWAMap(mesh, mesh.points[:, 0]))
    with pytest.raises(OutsideMeshError):
        model.predict(r, outside="raise")


def test_models_are_read_only():
    model = NARX(1, 0, True).fit(record(100), np.inf, n_points=20, rng=0)
    for array in (model.values, model.select, model.theta, model.simulate(record(100)).outputs):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


# -- measures ------------------------------------------------------------------------------------------------------


def test_measures_of_fit():
    y = np.array([1.0, -1.0, 1.0, -1.0])
    assert rmse(y, y) == 0 and fit_percent(y, y) == 100 and explained_percent(y, 0 * y) == 0
    assert fit_percent(y, np.zeros(4)) == 0
    assert rmse(y, [1, np.nan, 1, 1]) == np.inf
    with pytest.raises(InputError, match="constant"):
        fit_percent(np.ones(3), np.ones(3))
    with pytest.raises(InputError, match="same number"):
        rmse(y, y[:2])
    with pytest.raises(InputError, match="zero throughout"):
        explained_percent(np.zeros(3), np.zeros(3))
