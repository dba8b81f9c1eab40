"""The pyramid and the stand-in for the rotary actuator of Maruta and Ohlsson (2014)."""

import numpy as np
import pytest
from scipy.signal import lsim

from pwaid.dynamics.dry_friction import DryFriction
from pwaid.errors import InputError
from pwaid.systems.maruta2014 import RotaryActuator, maruta2014_pyramid, maruta2014_rotary_actuator, pyramid

QUIET = RotaryActuator(disturbance=0.0, counts=None)


def test_pyramid_is_equation_20():
    np.testing.assert_allclose(pyramid([[0, 0], [0.5, 0.25], [-0.5, 0.5], [1, 1]]), [1, 0.25, 0, 0])
    X, y = maruta2014_pyramid(4000, rng=0)
    assert X.shape == (4000, 2) and np.abs(X).max() < 1.1 and np.abs(X).max() > 1.09
    assert np.std(y - pyramid(X)) == pytest.approx(0.1, rel=0.05)
    X, y = maruta2014_pyramid(10, rng=0, noise=0.0, bound=0.5)
    np.testing.assert_array_equal(y, pyramid(X))
    np.testing.assert_array_equal(X, maruta2014_pyramid(10, rng=0, noise=0.0, bound=0.5)[0])


def test_the_recording_has_the_papers_shape_and_size():
    u, omega = maruta2014_rotary_actuator(60_000, rng=0)
    held = u.reshape(-1, 10)
    assert (held == held[:, :1]).all() and np.std(held[:, 0]) == pytest.approx(1.0, abs=0.03)
    assert np.std(omega) == pytest.approx(8.4, abs=0.4)
    assert 0.2 < (maruta2014_rotary_actuator(20_000, 0, QUIET)[1] == 0).mean() < 0.5


def test_without_friction_it_is_linear():
    free = QUIET.replace(friction=DryFriction())
    u = np.repeat(np.random.default_rng(0).standard_normal(20), 10)
    A = np.array([[-1 / free.lag, 0, 0], [1 / free.inertia, -free.viscous / free.inertia, 0], [0, 1, 0]])
    t = np.arange(u.size + 1) * free.dt
    _, theta, _ = lsim((A, [[1 / free.lag], [0], [0]], [[0, 0, 1]], [[0]]), np.append(u, 0), t, interp=False)
    np.testing.assert_allclose(free.respond(u), np.diff(theta) / free.dt, atol=1e-9)


def test_standstill_and_steady_speed():
    assert (QUIET.respond(np.full(100, 0.79)) == 0).all()
    assert QUIET.respond(np.full(300, 1.5))[-1] == pytest.approx((1.5 - 0.4) / QUIET.viscous, rel=1e-5)


def test_refining_the_step_changes_nothing():
    runs = [maruta2014_rotary_actuator(5000, 1, QUIET, step_scale=s)[1] for s in (1, 0.5, 0.2)]
    for other in runs[1:]:
        np.testing.assert_allclose(other, runs[0], atol=1e-9)


def test_the_encoder_rounds_the_angle():
    u = np.repeat(np.random.default_rng(2).standard_normal(50), 10)
    coarse = QUIET.replace(counts=10_000).respond(u)
    quantum = 2 * np.pi / 10_000 / QUIET.dt
    np.testing.assert_allclose(coarse / quantum, np.round(coarse / quantum), atol=1e-6)
    assert np.abs(coarse - QUIET.respond(u)).max() <= quantum + 1e-9


def test_the_disturbance_limits_what_any_model_can_explain():
    u = np.repeat(np.random.default_rng(3).standard_normal(2000), 10)
    error = np.std(RotaryActuator().respond(u, 1) - QUIET.respond(u)) / np.std(QUIET.respond(u))
    assert 0.005 < error < 0.05


def test_cyclic_test_repeats_up_to_the_disturbance():
    t, u, omega = RotaryActuator().cyclic_test(6, rng=0)
    assert t.shape == u.shape == (400,) and omega.shape == (6, 400)
    assert 0.02 < omega.std(axis=0, ddof=1).mean() < 1.0
    quiet = QUIET.cyclic_test(2)[2]
    np.testing.assert_allclose(quiet[0], quiet[1], atol=1e-8)


@pytest.mark.parametrize("make, message", [
    (lambda: maruta2014_pyramid(0), "expected n >= 1"),
    (lambda: maruta2014_pyramid(5, noise=-1), "noise >= 0"),
    (lambda: RotaryActuator(lag=0.0), "lag, dt > 0"),
    (lambda: RotaryActuator(counts=0), "positive number of encoder counts"),
    (lambda: maruta2014_rotary_actuator(10, hold=0), "at least 1"),
    (lambda: RotaryActuator().respond([np.inf]), "finite commands"),
])  # fmt: skip
def test_bad_input_gets_one_clear_error(make, message):
    with pytest.raises(InputError, match=message):
        make()
