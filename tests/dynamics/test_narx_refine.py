"""Free-run refinement: it lowers the objective it states, and repairs the bias of one-step fits under noise."""

from __future__ import annotations

import numpy as np
import pytest

from pwaid.dynamics.narx import NARX
from pwaid.dynamics.refine import free_run_scale, refine, refine_path
from pwaid.errors import InputError
from pwaid.recording import Recording

STRUCTURE = NARX(1, 0, True, nonlinear=("y(k-1)",))


def record(n, rng, noise=0.15):
    """A spring that stiffens for y > 0, measured with noise that does not enter the dynamics."""
    rng = np.random.default_rng(rng)
    u = np.repeat(rng.normal(size=n // 5), 5)
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = 0.9 * y[k - 1] - 0.5 * max(y[k - 1], 0) + 0.4 * u[k]
    return Recording(np.arange(n) * 1.0, u, y + noise * rng.normal(size=n), input_names="u", output_names="y")


@pytest.fixture(scope="module")
def fitted():
    train = record(800, 0)
    problem = STRUCTURE.problem(train, n_points=15, rng=0)
    return train, problem, problem.solve(0.05 * problem.lambda_max())[0].values


def objective(problem, x, lam, recording):
    model = problem.model(x[:, None])
    e = recording.outputs[1:] - model.simulate(recording).outputs[1:]
    return 0.5 * np.sum(e**2) + lam * np.abs(problem.problems[0].F @ x).sum()


def test_the_stated_objective_falls_at_every_step(fitted):
    train, problem, start = fitted
    found = refine(problem, start, train, 0.3)
    assert np.all(np.diff(found.objective) < 0) and len(found.objective) > 1
    assert found.objective[0] == pytest.approx(objective(problem, start, 0.3, train))
    assert found.objective[-1] == pytest.approx(objective(problem, found.unknowns, 0.3, train))


def test_output_noise_biases_the_one_step_fit_and_refinement_repairs_it(fitted):
    train, problem, start = fitted
    test = record(800, 1, noise=0.0)
    refined, errors = refine_path(problem, start, train, (0.3, 0.03), record(800, 2))
    assert refined[0].model.free_run_rmse([test]) < 0.5 * problem.model(start[:, None]).free_run_rmse([test])
    assert errors.shape == (2,) and np.isfinite(errors).all()


def test_the_scale_balances_loss_and_penalty(fitted):
    train, problem, start = fitted
    lam = free_run_scale(problem, start, train)
    loss = objective(problem, start, 0.0, train)
    assert lam * np.abs(problem.problems[0].F @ start).sum() == pytest.approx(loss)


def test_short_horizons_start_from_measured_outputs(fitted):
    """With a horizon of one sample the free run is the one-step prediction."""
    train, problem, start = fitted
    found = refine(problem, start, train, 0.05 * problem.lambda_max(), horizon=1, steps=3)
    e = train.outputs[1:] - problem.model(start[:, None]).predict(train)[1:]
    penalty = 0.05 * problem.lambda_max() * np.abs(problem.problems[0].F @ start).sum()
    assert found.objective[0] == pytest.approx(0.5 * np.sum(e**2) + penalty)
    assert found.objective[-1] > 0.999 * found.objective[0]  # it is already the minimum


def test_a_diverging_start_gets_one_clear_error(fitted):
    train, problem, start = fitted
    with pytest.raises(InputError, match="starting model diverges"):
        refine(problem, 3.0 * start, train, 0.1)


def test_several_outputs_are_refused():
    u = np.random.default_rng(0).normal(size=100)
    r = Recording(np.arange(100.0), u, np.column_stack([u, np.roll(u, 1)]))
    problem = NARX(1, 0, True).problem(r, n_points=40, rng=0)
    with pytest.raises(InputError, match="refine takes one"):
        refine(problem, np.zeros(problem.mesh.n_points), r, 1.0)


def test_lambda_must_be_positive():
    with pytest.raises(InputError, match="lam is 0"):
        refine(None, np.zeros(3), None, 0.0)
