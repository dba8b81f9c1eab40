"""The matching problem: gradients, lower bounds, stationarity."""

import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.hinfstruct import MatchingProblem, StructuredModel, hinf_norm
from pwaid.hinfstruct.problem import response_and_slope
from pwaid.hinfstruct.smooth import parameter_scale
from pwaid.hinfstruct.statespace import frequency_response

from .conftest import random_stable


@pytest.fixture(scope="module")
def case(arm):
    target = arm.matrices(0.3)
    theta = arm.theta(0.3) * (1 + 0.03 * np.random.default_rng(0).uniform(-1, 1, 16))
    return MatchingProblem.build(arm.pattern(), (target.A, target.B, target.C, target.D)), theta


def test_response_slope_is_the_derivative(arm):
    model, theta, omega = arm.pattern(), arm.theta(0.1), np.array([0.0, 30.0, 400.0, np.inf])
    _, slope = response_and_slope(model, theta, omega)
    for k in range(16):
        step = 1e-5 * abs(theta[k]) * np.eye(16)[k]
        ends = [frequency_response(model.matrices(theta + s), omega) for s in (step, -step)]
        assert slope[:, k] == pytest.approx(
            (ends[0] - ends[1]) / (2 * step[k]), abs=1e-6 * np.abs(slope[:, k]).max() + 1e-12
        )


def test_gradient_of_the_value(case):
    problem, theta = case
    value, active = problem.active(theta, 1 - 1e-9)
    gradient = active.gradients()[0]
    for k in range(0, 16, 3):
        step = 1e-6 * abs(theta[k]) * np.eye(16)[k]
        central = (problem.value(theta + step) - problem.value(theta - step)) / (2 * step[k])
        assert gradient[k] == pytest.approx(central, rel=1e-4, abs=1e-6 * np.abs(gradient).max())
    assert value == pytest.approx(problem.value(theta))


def test_residual_jacobian(case):
    problem, theta = case
    omega = problem.grid(20)
    J = problem.residual(theta, omega, derivative=True)
    step = 1e-6 * abs(theta[7]) * np.eye(16)[7]
    central = (problem.residual(theta + step, omega) - problem.residual(theta - step, omega)) / (2 * step[7])
    assert J[:, 7] == pytest.approx(central, rel=1e-4, abs=1e-6 * np.abs(J[:, 7]).max())


def test_lower_bound_from_the_static_gain_of_the_arm(arm):
    m = arm.matrices(0.3)
    problem = MatchingProblem.build(arm.pattern(), (m.A, m.B, 1.02 * m.C, m.D))
    bound, reason = problem.lower_bound()
    assert bound == pytest.approx(0.02, rel=1e-9) and "G(j 0)" in reason
    for seed in range(5):
        theta = arm.theta(0.3) * (1 + 0.05 * np.random.default_rng(seed).uniform(-1, 1, 16))
        assert problem.value(theta) >= bound * (1 - 1e-9)


def test_no_bound_where_everything_is_free():
    model = StructuredModel.from_pattern([["a"]], [["b"]], [[1.0]], [["d"]])
    assert MatchingProblem.build(model, ([[-1.0]], [[1.0]], [[1.0]], [[0.3]])).lower_bound()[0] == 0.0


def test_stationarity_vanishes_at_a_minimum_and_not_elsewhere():
    # min over a of || a - 1/(s + 1) ||: the best constant is 1/2, with the peaks 0 and infinity both active.
    model = StructuredModel.from_pattern([[-1.0]], [[0.0]], [[0.0]], [["a"]])
    problem = MatchingProblem.build(model, ([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    assert problem.stationarity(np.array([0.5]), np.ones(1)) < 1e-9
    assert problem.stationarity(np.array([0.8]), np.ones(1)) == pytest.approx(1 / 0.8)
    assert parameter_scale(np.array([0.0, 2.0, -4.0])).min() > 0


def test_several_models_share_the_parameters(arm):
    kappas = (0.2, 0.6)
    targets = [arm.frozen(k) for k in kappas]
    problem = MatchingProblem.build([arm.pattern()] * 2, targets)
    values = [n.value for n in problem.norms(arm.theta(0.2))]
    assert values[0] < 1e-9 and values[1] == pytest.approx(problem.value(arm.theta(0.2)))
    assert values[1] > 0.01 * hinf_norm(targets[1]).value


@pytest.mark.parametrize(
    ("targets", "message"),
    [
        ([([[0.1]], [[1.0]], [[1.0]], [[0.0]])], "target 0 is unstable"),
        ([([[-0.1]], [[1.0]], [[1.0]], [[0.0]])] * 2, "1 models and 2 targets"),
        ([random_stable(3, 0)], "outputs x inputs"),
        ([([[np.inf]], [[1.0]], [[1.0]], [[0.0]])], "target 0: A contains NaN"),
    ],
)
def test_bad_input(targets, message):
    model = StructuredModel.from_pattern([["a"]], [["b"]], [[1.0]])
    with pytest.raises(InputError, match=message):
        MatchingProblem.build([model], targets)
