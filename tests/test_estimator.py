"""PWARegressor speaks scikit-learn."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import parametrize_with_checks

from pwaid import InputError, PWARegressor
from tests.conftest import pyramid

QUICK = {"n_points": 60, "cv": 3, "n_lambdas": 6, "random_state": 0}


@parametrize_with_checks([PWARegressor(**QUICK)])
def test_scikit_learn_conventions(estimator, check):
    check(estimator)


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(3)
    X = rng.uniform(-1, 1, (500, 2))
    return X, pyramid(X) + 0.02 * rng.standard_normal(500)


def test_learns_the_pyramid_and_scores_above_a_linear_model(data):
    X, y = data
    model = PWARegressor(200, cv=3, n_lambdas=8, random_state=0).fit(X[:400], y[:400])
    assert model.score(X[400:], y[400:]) > 0.95
    assert model.cv_rmse_[0].shape == (8,) and model.gaps_[0] <= 1e-3


def test_pipeline_and_grid_search(data):
    X, y = data
    pipe = make_pipeline(StandardScaler(), PWARegressor(60, lam_ratio=0.01, random_state=0))
    search = GridSearchCV(pipe, {"pwaregressor__lam_ratio": [0.5, 0.01]}, cv=2).fit(X, y)
    assert search.best_params_ == {"pwaregressor__lam_ratio": 0.01}


def test_several_outputs_and_linear_inputs(data):
    X, y = data
    rng = np.random.default_rng(0)
    extra = rng.standard_normal((500, 3))
    Y = np.column_stack([y, X[:, 0] - 2.0 * extra[:, 1]])
    wide = np.column_stack([X, extra])
    model = PWARegressor(100, lam_ratio=3e-3, random_state=0).fit(wide, Y)
    assert {0, 1} <= set(model.hinge_features_) and len(model.hinge_features_) == 3
    assert model.predict(wide).shape == (500, 2)
    assert model.score(wide, Y) > 0.95


def test_outside_rule_is_the_callers(data):
    X, y = data
    model = PWARegressor(60, lam_ratio=0.01, outside="nan", random_state=0).fit(X, y)
    assert np.isnan(model.predict([[9.0, 9.0]])[0])
    assert np.isfinite(model.set_params(outside="affine").predict([[9.0, 9.0]])[0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lam": "best"}, "expected 'cv' or a positive number"),
        ({"lam": -1.0}, "positive finite"),
        ({"weighting": "paper"}, "expected one of"),
        ({"folds": "odd"}, "expected 'random' or 'blocks'"),
        ({"rule": "odd"}, "expected one of 'min', '1se'"),
        ({"outside": "odd"}, "expected one of 'raise', 'nan', 'affine'"),
        ({"hinge_features": [7]}, "expected columns 0 to 1"),
        ({"hinge_features": "some"}, "expected 'auto' or column numbers"),
    ],
)
def test_bad_options(data, options, message):
    X, y = data
    with pytest.raises(InputError, match=message):
        PWARegressor(**{**QUICK, **options}).fit(X, y)


def test_collinear_inputs_are_refused(data):
    X, y = data
    with pytest.raises(InputError, match="collinear"):
        PWARegressor(60).fit(np.column_stack([X[:, 0], 2 * X[:, 0]]), y)


@pytest.mark.parametrize("constant", [0.1, 25.7, 293.15])
def test_an_input_that_never_moved_counts_for_nothing(rng, constant):
    X = np.column_stack([rng.uniform(-1, 1, (200, 1)), np.full(200, constant)])
    model = PWARegressor(30, lam_ratio=0.01, random_state=0).fit(X, np.abs(X[:, 0]) + 100.0)
    moved = X[:5] + [0.0, 0.1]
    np.testing.assert_array_equal(model.predict(moved), model.predict(X[:5]))


def test_a_switch_bends_nothing(rng):
    """An input with two values: the affine fit is best at every λ."""
    x = np.repeat([0.0, 1.0], 40)
    for noise in (0.0, 0.3):
        y = 2.0 * x - 1.0 + noise * rng.normal(size=x.size)
        model = PWARegressor(20, random_state=0).fit(x[:, None], y)
        np.testing.assert_allclose(model.predict([[0.0], [1.0]]), [y[x == 0].mean(), y[x == 1].mean()], atol=1e-9)


def test_inputs_that_rounding_parted_are_one(rng):
    x = np.r_[np.linspace(0, 1, 11), np.cumsum(np.full(11, 0.1)) - 0.1]
    y = np.abs(x - 0.5) + 0.02 * rng.standard_normal(22)
    model = PWARegressor(random_state=0, n_lambdas=5).fit(x[:, None], y)
    assert model.mesh_.n_points == 13  # eleven and two corners outside
    assert model.gaps_[0] <= 1e-4


def test_an_input_that_moves_in_one_fold_only_leaves_that_fold_out(rng):
    X = np.column_stack([rng.uniform(-1, 1, 100), np.r_[np.zeros(85), np.ones(15)]])
    y = np.abs(X[:, 0]) + X[:, 1] + 0.01 * rng.normal(size=100)
    with pytest.warns(UserWarning, match="fold 4 is left out"):
        model = PWARegressor(40, folds="blocks", n_lambdas=5, random_state=0).fit(X, y)
    assert model.cv_rmse_[0].min() < 0.2


def test_a_mask_chooses_hinge_features(data):
    X, y = data
    models = [PWARegressor(**{**QUICK, "hinge_features": chosen}).fit(X, y) for chosen in ([1], [False, True])]
    np.testing.assert_array_equal(models[0].hinge_features_, models[1].hinge_features_)
