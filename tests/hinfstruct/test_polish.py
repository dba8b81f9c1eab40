"""Output-error polish: derivative, improvement on noisy data, honest standard errors, refusals."""

import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.hinfstruct import StructuredModel, c2d, polish_output_error, simulate_discrete
from pwaid.hinfstruct.polish import _hold, _sensitivities
from pwaid.hinfstruct.statespace import as_matrices

MODEL = StructuredModel.from_pattern([[0, 1], ["-k", "-c"]], [[0], ["b"]], [["g", 0]], [["d"]])
TRUE = np.array([40.0, 2.0, 5.0, 1.0, 0.1])  # k, c, b, g, d; b g is one number
FREE = StructuredModel.from_pattern([[0, 1], ["-k", "-c"]], [[0], ["b"]], [[1, 0]])
DT = 0.05


def test_sensitivities_are_derivatives():
    u = np.random.default_rng(0).standard_normal((80, 1))
    exact = _sensitivities(MODEL, TRUE, u, DT)
    for k in range(5):
        step = 1e-6 * TRUE[k] * np.eye(5)[k]
        ends = [simulate_discrete(_hold(MODEL.matrices(TRUE + s), DT), u) for s in (step, -step)]
        assert exact[:, :, k] == pytest.approx((ends[0] - ends[1]) / (2 * step[k]), abs=1e-6)


def test_polish_recovers_parameters_within_its_standard_errors():
    rng = np.random.default_rng(1)
    true = TRUE[:3]
    u = rng.standard_normal((2000, 1))
    y = simulate_discrete(as_matrices(c2d(FREE.statespace(true), DT)), u)
    noisy = y + 0.05 * y.std() * rng.standard_normal(y.shape)
    result = polish_output_error(FREE, true * [1.1, 0.8, 1.2], u, noisy, DT)
    assert np.all(np.abs(result.theta - true) < 4 * result.standard_error)
    assert result.rmse < 0.5 * result.rmse_start
    assert result.rmse[0] == pytest.approx(0.05 * y.std(), rel=0.05)


@pytest.mark.parametrize(
    ("theta", "u", "y", "message"),
    [
        ([40.0, 2.0], np.ones((9, 1)), np.ones((9, 1)), "3 parameters"),
        ([40.0, 2.0, 1.0], np.ones((9, 2)), np.ones((9, 1)), r"expected \(N, 1\)"),
        ([40.0, 2.0, 1.0], np.full((9, 1), np.nan), np.ones((9, 1)), "NaN"),
        ([40.0, 2.0, 1.0], np.ones((3, 1)), np.ones((3, 1)), "too few"),
        ([40.0, -2.0, 1.0], np.ones((9, 1)), np.ones((9, 1)), "unstable at the starting theta"),
    ],
)
def test_bad_input(theta, u, y, message):
    with pytest.raises(InputError, match=message):
        polish_output_error(FREE, theta, u, y, DT)
