"""Output error and Hammerstein–Wiener models: derivatives, recovery of known systems, orders, errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from pwaid.dynamics.compare import BlockModel, fit_block_model, search_orders
from pwaid.dynamics.fit_measures import fit_percent, rmse
from pwaid.errors import InputError


def signal(n=3000, rng=0):
    return np.repeat(np.random.default_rng(rng).normal(size=n // 5), 5)


def test_the_derivative_is_that_of_finite_differences():
    breaks = np.linspace(-2, 2, 4)
    linear = np.array([0.4, 0.2]), np.array([-0.6, 0.1]), 1, 0.3
    model = BlockModel(*linear, breaks, np.tanh(breaks), breaks - 0.1, breaks + 0.2 * breaks**2)
    u, p = signal(200), model._pack()
    numeric = np.column_stack(
        [
            (model._unpack(p + 1e-6 * e).simulate(u) - model._unpack(p - 1e-6 * e).simulate(u)) / 2e-6
            for e in np.eye(len(p))
        ]
    )
    error = np.abs(model._jacobian(u) - numeric)
    # a sample within the step of a breakpoint has no derivative: a handful of 200 at most
    assert np.mean(error.max(axis=1) > 1e-5) < 0.02


def test_a_linear_system_with_an_offset_is_found_under_output_noise():
    u = signal()
    truth = lfilter([0, 0.5, 0.2], [1, -1.2, 0.5], u) + 3.0
    y = truth + 0.1 * np.random.default_rng(1).normal(size=len(u))
    model = fit_block_model(u, y, (2, 2, 1))
    np.testing.assert_allclose(model.f, [-1.2, 0.5], atol=0.02)
    np.testing.assert_allclose(model.b, [0.5, 0.2], atol=0.02)
    assert model.offset == pytest.approx(3.0, abs=0.02)
    assert rmse(truth, model.simulate(u)) < 0.02


def test_a_hammerstein_wiener_system_is_found_where_the_linear_model_fails():
    u, test = signal(4000, 2), signal(2000, 3)

    def system(u):
        x = lfilter([0.5], [1, -0.7], np.clip(u, -0.5, 1.0))
        return np.where(x > 0, x, 0.3 * x)

    linear = fit_block_model(u, system(u), (1, 1, 0))
    block = fit_block_model(u, system(u), (1, 1, 0), units=10)
    assert fit_percent(system(test), linear.simulate(test)) < 70
    assert fit_percent(system(test), block.simulate(test)) > 90


def test_orders_are_searched_on_validation_data():
    u = signal()
    y = lfilter([0, 0, 1.0], [1, -0.8], u) + 0.05 * np.random.default_rng(4).normal(size=len(u))
    half = len(u) // 2
    found = search_orders(
        (u[:half], y[:half]), (u[half:], y[half:]), n_b=(1, 2), n_f=(1, 2), n_k=range(4), start=(1, 1, 0)
    )
    assert found.model.delay == 2 and min(found.tried, key=found.tried.get) == found.model.orders
    assert len(found.tried) < 16


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros(100), np.zeros(100), (0, 1, 0)), "expected n_b, n_f ≥ 1"),
        ((np.zeros(100), np.zeros(90), (1, 1, 0)), "100 inputs and 90 outputs"),
        ((np.full(100, np.nan), np.zeros(100), (1, 1, 0)), "u has 100 entries that are NaN"),
    ],
)
def test_bad_input_gets_one_clear_error(arguments, message):
    with pytest.raises(InputError, match=message):
        fit_block_model(*arguments)
