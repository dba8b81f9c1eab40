"""Restructuring: right answers, certificates, continuation, agreement of the nonsmooth methods, refusals."""

import importlib

import numpy as np
import pytest

from pwaid.errors import InputError, SolverError
from pwaid.hinfstruct import (
    MatchingProblem,
    Parameter,
    StructuredModel,
    c2d,
    d2c,
    hinf_norm,
    levenberg_marquardt,
    null_space_start,
    pi_moesp,
    prox_linear,
    proximity_bundle,
    restructure,
    restructure_path,
)
from pwaid.hinfstruct.norm import gains_at
from pwaid.hinfstruct.statespace import as_matrices, difference
from pwaid.systems.vizer2014 import OPERATING_POINTS, vizer2014_flexible_arm_experiment

from .conftest import disguised


@pytest.fixture(scope="module")
def black_boxes():
    """Noisy identifications at three neighbouring points, by both inversions."""
    out = {"zoh": [], "tustin": []}
    for i, angle in enumerate(OPERATING_POINTS[4:]):
        run = vizer2014_flexible_arm_experiment(angle, rng=i)
        model = pi_moesp((run.inputs, run.noisy(30, i)), 6, dt=run.dt).system
        for method, found in out.items():
            found.append(d2c(model, method=method))
    return out


def test_noise_free_model_is_recovered(arm):
    result = restructure(arm.pattern(), disguised(arm.matrices(0.4), 0))
    assert result.value < 1e-9 and result.converged
    assert result.theta == pytest.approx(arm.theta(0.4), rel=1e-6)
    assert result.parameters["th1"] == result.theta[0]


def test_zoh_models_meet_the_certified_lower_bound(arm, black_boxes):
    results = restructure_path(arm.pattern(), black_boxes["zoh"])
    for result, angle in zip(results, OPERATING_POINTS[4:], strict=True):
        assert result.at_bound
        assert result.lower_bound * (1 - 1e-9) <= result.value <= 1.001 * result.lower_bound
        assert result.system.nstates == 6 and as_matrices(result.system).stable
        true = arm.matrices(np.cos(angle))
        assert hinf_norm(difference(as_matrices(result.system), true)).value < 0.01 * hinf_norm(true).value


def test_the_returned_norm_is_that_of_the_returned_model(arm, black_boxes):
    result = restructure(arm.pattern(), black_boxes["tustin"][1], max_iterations=8)
    error = difference(as_matrices(result.system), result.target)
    gains = gains_at(error, np.geomspace(1, 1e4, 5000))
    assert 0.999 * result.value <= gains.max() <= result.norm.upper
    assert result.trace[0] == pytest.approx(min(v for _, v in result.starts))
    assert np.all(np.diff(result.trace) <= 1e-12)


def test_nonsmooth_methods_agree_and_equalise_the_peaks(arm, black_boxes):
    problem = MatchingProblem.build(arm.pattern(), black_boxes["tustin"][2])
    start = restructure(arm.pattern(), black_boxes["tustin"][2], method="lm")
    sharp = prox_linear(problem, start.theta)
    bundle = proximity_bundle(problem, start.theta, max_iterations=150)
    assert sharp.converged and sharp.predicted < 1e-4
    assert sharp.value < 0.8 * start.value and bundle.value < 0.85 * start.value
    assert sharp.value == pytest.approx(bundle.value, rel=0.06)
    assert problem.norms(sharp.theta)[0].active(1e-3).size >= 4
    assert problem.stationarity(sharp.theta, np.abs(sharp.theta)) < 0.05 * problem.stationarity(
        start.theta, np.abs(start.theta)
    )


@pytest.mark.parametrize("method", [prox_linear, proximity_bundle])
def test_known_minimax(method):
    # The best constant for 1/(s + 1) is 1/2; the best first-order lag of a static gain 1 with the pole fixed
    # likewise.
    model = StructuredModel.from_pattern([[-1.0]], [[0.0]], [[0.0]], [["a"]])
    problem = MatchingProblem.build(model, ([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    run = method(problem, np.array([0.9]))
    assert run.theta[0] == pytest.approx(0.5, abs=1e-3) and run.value == pytest.approx(0.5, abs=1e-3)


def test_continuation_helps_a_point_with_a_bad_start(arm, black_boxes):
    good = arm.theta(np.cos(OPERATING_POINTS[4]))
    pattern = StructuredModel(arm.pattern().parameters, arm.pattern().evaluate, arm.pattern().differentiate)
    bad = -np.abs(good) * np.random.default_rng(3).uniform(0.2, 5, 16)
    results = restructure_path(pattern, black_boxes["zoh"][:2], starts=[good, bad], method="lm")
    assert results[1].value < 0.02 and "neighbour" in results[1].start


def test_physical_parameters_with_bounds():
    def spring(p):
        m, c, k = p
        return np.array(
            [[0, 1], [-k / m, -c / m]]
        ), np.array([[0], [1 / m]]), np.array([[k, 0]]), np.zeros((1, 1))

    parameters = [
        Parameter("m", 1.0, "kg", 0.1, 10),
        Parameter("c", 1.0, "N s/m", 0.01, 5),
        Parameter("k", 10.0, "N/m", 1, 99),
    ]
    model = StructuredModel.from_function(spring, parameters)
    truth = model.statespace(np.array([2.0, 0.3, 30.0]))
    result = restructure(model, truth)
    # k x / F has unit static gain: m, c, k are known up to a common factor only.
    assert result.value < 1e-6
    assert result.theta / result.theta[2] == pytest.approx(np.array([2.0, 0.3, 30.0]) / 30.0, rel=1e-4)


def test_static_gain_can_be_matched(arm):
    m = arm.matrices(0.1)
    skewed = (m.A, m.B @ np.array([[1.01, 0.005], [0.0, 0.99]]), m.C, m.D)
    plain = restructure(arm.pattern(), skewed, method="lm")
    matched = restructure(arm.pattern(), skewed, match_static_gain=True)
    true = arm.theta(0.1)
    assert matched.theta == pytest.approx(true, rel=1e-5)
    assert np.abs(plain.theta / true - 1).max() > 1e-3


def test_an_unstable_random_start_is_drawn_again(arm, monkeypatch):
    drawn = []

    def unlucky_first(*args, **options):
        theta = null_space_start(*args, **options)
        drawn.append(theta)
        return theta if len(drawn) > 1 else 1e9 * np.linspace(-1.0, 1.0, theta.size)

    module = importlib.import_module("pwaid.hinfstruct.restructure")  # the package's name is the function
    monkeypatch.setattr(module, "null_space_start", unlucky_first)
    result = restructure(arm.pattern(), arm.frozen(0.1), method="lm", rng=0)
    assert len(drawn) > 1
    assert result.theta == pytest.approx(arm.theta(0.1), rel=1e-5)


def test_levenberg_marquardt_reaches_a_noise_free_optimum(arm):
    problem = MatchingProblem.build(arm.pattern(), arm.frozen(0.2))
    start = arm.theta(0.2) * (1 + 0.03 * np.random.default_rng(1).uniform(-1, 1, 16))
    assert problem.value(levenberg_marquardt(problem, start)) < 1e-6 * problem.value(start)


def test_results_are_read_only(arm):
    result = restructure(arm.pattern(), arm.frozen(0.1), start=arm.theta(0.1), method="lm")
    for array in (result.theta, result.norm.gains, result.trace):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_bad_input(arm):
    pattern = arm.pattern()
    with pytest.raises(InputError, match="method = 'newton'"):
        restructure(pattern, arm.frozen(0.1), method="newton")
    with pytest.raises(InputError, match="is discrete"):
        restructure(pattern, c2d(arm.frozen(0.1), 1e-3))
    with pytest.raises(InputError, match="this model has 16 parameters"):
        restructure(pattern, arm.frozen(0.1), start=np.ones(3))
    with pytest.raises(InputError, match="1 models, 1 targets, 2 starts"):
        restructure_path(pattern, [arm.frozen(0.1)], starts=[None, None])
    free = StructuredModel.from_function(
        lambda p: (
            np.array([[p[0]]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1))
        ), [Parameter("a", -1.0)]
    )
    with pytest.raises(InputError, match="match_static_gain needs"):
        restructure(free, ([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), match_static_gain=True)
    stuck = StructuredModel.from_function(
        lambda p: (
            np.array([[p[0]]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1))
        ), [Parameter("a", 2.0, "", 1.0, 3.0)]
    )
    with pytest.raises(InputError, match=r"violates the bounds of \['a'\]"):
        restructure(stuck, ([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), start=[9.0])
    with pytest.raises(SolverError, match="every start ended in an unstable model"):
        restructure(stuck, ([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))


@pytest.mark.parametrize("stiffness", [1.0, 1e5, 1e9])
def test_the_size_of_the_gain_does_not_matter(stiffness):
    """A compliance in m/N is 1e-9 beside others in nm/N: the same fit."""
    def compliance(theta):
        k, tau = theta
        return np.array([[-1 / tau]]), np.array([[1 / tau]]), np.array([[1 / k]]), np.array([[0 * k]])

    parameters = [Parameter("k", stiffness, "N/m", low=0.1 * stiffness, high=10 * stiffness),
                  Parameter("tau", 1e-3, "s", low=1e-4, high=1e-2)]
    model = StructuredModel.from_function(compliance, parameters)
    truth = np.array([2 * stiffness, 2e-3])
    for method in ("prox-linear", "bundle", "lm"):
        found = restructure(model, model.statespace(truth), rng=0, method=method)
        np.testing.assert_allclose(found.theta, truth, rtol=1e-6)
        assert not found.at_bound


def test_the_unit_of_a_parameter_does_not_matter():
    from pwaid.hinfstruct.smooth import parameter_scale

    np.testing.assert_allclose(parameter_scale(np.array([1e5, 2e5, 3e5, 2.0])), [1e5, 2e5, 3e5, 2.0])
    np.testing.assert_allclose(parameter_scale(np.array([1.0, 2.0, 0.0])), [1.0, 2.0, 1e-3])
