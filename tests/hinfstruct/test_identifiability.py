"""The identifiability report:

Groups that cannot be told apart, spread, and the warning that a residual proves little.
"""

import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.hinfstruct import Parameter, StructuredModel, identifiability, restructure

PARAMETERS = [Parameter("m", 2.0), Parameter("c", 0.5), Parameter("k", 8.0), Parameter("g", 3.0)]


def spring(p):
    m, c, k, g = p
    return np.array(
        [[0, 1], [-k / m, -c / m]]
    ), np.array([[0], [g / m]]), np.array([[1.0, 0]]), np.zeros((1, 1))


def test_a_common_factor_is_found_as_one_group():
    report = identifiability(StructuredModel.from_function(spring, PARAMETERS), [2.0, 0.5, 8.0, 3.0])
    assert not report.identifiable and report.rank == 3
    assert report.groups == (("m", "c", "k", "g"),)
    assert any("no response tells these parameters apart" in w for w in report.warnings)


def test_two_separate_groups():
    model = StructuredModel.from_pattern([["-a"]], [["b1", 0]], [[1.0]])
    two = model.reparametrise(
        [Parameter(n, 1.0) for n in ("p", "q", "r", "s")], lambda x: np.array([x[0] * x[1], x[2] / x[3]])
    )
    report = identifiability(two, [1.0, 2.0, 3.0, 4.0])
    assert set(report.groups) == {("p", "q"), ("r", "s")}


def test_the_arm_is_locally_identifiable(arm):
    report = identifiability(arm.pattern(), arm.theta(np.cos(np.pi / 8)))
    assert report.identifiable and not report.groups
    assert 1e3 < report.condition < 1e5
    assert report.spread is None and report.slack is None


def test_restarts_agree_on_an_exact_target_and_slack_is_small(arm):
    result = restructure(arm.pattern(), arm.frozen(0.2))
    report = identifiability(result, restarts=2, perturbation=0.01, rng=0)
    assert max(report.slack.values()) < 1e-4
    assert not any("does not prove" in w for w in report.warnings)


def test_static_error_and_left_out_damping_raise_warnings(arm):
    m = arm.matrices(0.2)
    skewed = restructure(arm.pattern(), (m.A, m.B, 1.02 * m.C, m.D))
    report = identifiability(skewed, restarts=3, rng=0)
    assert skewed.at_bound
    assert any("equals its structural lower bound" in w for w in report.warnings)
    # Structural damping that the pattern cannot hold: a small error, and wrong parameters all the same.
    A = m.A.copy()
    A[2:, 4:6] = 2e-4 * A[2:, :2]
    damped = restructure(arm.pattern(), (A, m.B, m.C, m.D))
    report = identifiability(damped)
    assert damped.value < 0.05
    wrong = np.abs(damped.theta / arm.theta(0.2) - 1)
    assert wrong.max() > 0.05
    assert any("does not prove the parameters" in w for w in report.warnings)
    assert max(report.slack.values()) > 0.05


def test_bad_input(arm):
    with pytest.raises(InputError, match="needs theta="):
        identifiability(arm.pattern())
    with pytest.raises(InputError, match="restarts need a Restructured"):
        identifiability(arm.pattern(), arm.theta(0.1), restarts=3)
    with pytest.raises(InputError, match="unstable at this theta"):
        identifiability(arm.pattern(), -arm.theta(0.1))
