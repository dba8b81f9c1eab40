"""Closed-form and null-space starts are exact on noise-free models.

The printed system (34) is rank-deficient.
"""

import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.hinfstruct import (
    StructuredModel,
    balance,
    null_space_start,
    printed_start_system,
    velocity_loop_start,
)
from pwaid.systems.vizer2014 import OPERATING_POINTS

from .conftest import disguised, random_stable


def relative(theta, true):
    return np.linalg.norm(theta - true) / np.linalg.norm(true)


@pytest.mark.parametrize("angle", OPERATING_POINTS)
def test_both_starts_are_exact(arm, angle):
    kappa = np.cos(angle)
    black_box = disguised(balance(arm.frozen(kappa)).system, 3)
    true = arm.theta(kappa)
    assert relative(velocity_loop_start(black_box, arm.output), true) < 1e-10
    assert relative(null_space_start(arm.pattern(), balance(black_box).system, rng=0), true) < 1e-7


def test_printed_system_fixes_28_of_36_unknowns(arm):
    matrix, right = printed_start_system(balance(arm.frozen(0.2)).system, arm.output)
    assert matrix.shape == (28, 36) and np.linalg.matrix_rank(matrix) == 28
    # It is consistent: the true similarity solves it; the minimum-norm solution is another one.
    result = balance(arm.frozen(0.2))
    assert matrix @ result.T.ravel(order="F") == pytest.approx(right, abs=1e-9 * np.abs(right).max())
    shortest = np.linalg.pinv(matrix) @ right
    assert np.linalg.norm(shortest - result.T.ravel(order="F")) > 0.5 * np.linalg.norm(result.T)


def test_null_space_start_on_another_structure():
    model = StructuredModel.from_pattern(
        [[0, 1, 0], ["a1", "a2", "a3"], [0, 1, "a4"]], [[0], ["b"], [0]], [[1, 0, 0], [0, 0, 1]]
    )
    true = np.array([-4.0, -1.0, 0.5, -2.0, 3.0])
    black_box = disguised(model.matrices(true), 1)
    assert null_space_start(model, black_box, rng=0) == pytest.approx(true, rel=1e-6)


def test_bad_input(arm):
    with pytest.raises(InputError, match="needs order 6"):
        velocity_loop_start(random_stable(5, 0), arm.output)
    with pytest.raises(InputError, match="structure 6; balance"):
        null_space_start(arm.pattern(), random_stable(5, 0))
    with pytest.raises(InputError, match="affine pattern"):
        bent = arm.pattern().reparametrise(arm.pattern().parameters, lambda p: p**3)
        null_space_start(bent, arm.frozen(0.1))
