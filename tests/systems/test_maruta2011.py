"""The stand-in for the DC motor rig of Maruta and Sugie (2011)."""

import dataclasses

import numpy as np
import pytest

from pwaid.dynamics.dry_friction import DryFriction
from pwaid.errors import InputError
from pwaid.systems.maruta2011 import DCMotor, maruta2011_dc_motor

QUIET = DCMotor(disturbance=0.0, speed_noise=0.0)


def test_the_recording_has_the_papers_shape():
    run = maruta2011_dc_motor(20_000, rng=0)
    assert run.time.size == run.acceleration.size == 20_000 and run.time[1] == pytest.approx(0.01)
    held = run.current.reshape(-1, 10)
    assert (held == held[:, :1]).all() and np.unique(held[:, 0]).size == 2000
    assert 1.4 < np.abs(run.current).max() <= 1.5
    assert 25 < np.abs(run.speed).max() < 40
    assert 0.05 < (run.true_speed == 0).mean() < 0.25


def test_acceleration_is_the_forward_difference():
    run = maruta2011_dc_motor(500, rng=1)
    np.testing.assert_allclose(run.speed[:-1] + 0.01 * run.acceleration[:-1], run.speed[1:], atol=1e-12)


def test_steady_speeds_balance_the_map():
    for i, speed in ((1.5, 40.0), (-1.5, -32.0)):
        end = QUIET.respond(np.full(400, i)).speed[-1]
        assert end == pytest.approx(speed, abs=1e-6)
        assert QUIET.acceleration(i, end) == pytest.approx(0.0, abs=1e-4)


def test_difference_approaches_the_map_as_sampling_gets_fast():
    worst = []
    for dt in (1e-3, 1e-4):
        run = QUIET.replace(dt=dt).respond(np.repeat([1.2, 0.4, -1.0], round(0.2 / dt)))
        away = np.abs(run.speed) > 1.0
        worst.append(np.abs(run.acceleration - QUIET.acceleration(run.current, run.speed))[away].max())
    assert worst[1] < 0.2 * worst[0] and worst[1] < 1.0


def test_standstill_holds_up_to_the_static_level():
    limit = QUIET.friction.static / QUIET.torque_constant
    assert (QUIET.respond(np.full(50, 0.999 * limit)).speed == 0).all()
    assert QUIET.respond(np.full(50, 1.01 * limit)).speed[-1] > 0
    np.testing.assert_array_equal(QUIET.acceleration([0.999 * limit, -0.999 * limit], 0.0), 0.0)
    assert QUIET.acceleration(1.5, 0.0) == pytest.approx((0.06 - 0.018) / 2e-4)


def test_refining_the_step_changes_nothing():
    runs = [maruta2011_dc_motor(5000, 3, QUIET, step_scale=s).speed for s in (1, 0.5, 0.2)]
    for other in runs[1:]:
        np.testing.assert_allclose(other, runs[0], atol=1e-9)


def test_noise_has_the_documented_size():
    run = maruta2011_dc_motor(20_000, 0, DCMotor(disturbance=0.0))
    assert np.std(run.speed - run.true_speed) == pytest.approx(0.03, rel=0.05)
    quiet = maruta2011_dc_motor(20_000, 0, QUIET)
    assert np.std(run.acceleration - quiet.acceleration) == pytest.approx(0.03 * np.sqrt(2) / 0.01, rel=0.05)


def test_periodic_validation_repeats_up_to_the_noise():
    t, i, omega = DCMotor().periodic_test(4, rng=0)
    assert t[-1] == pytest.approx(19.99) and omega.shape == (4, 2000) and i.shape == (2000,)
    assert 0.02 < omega.std(axis=0, ddof=1).mean() < 0.2 and 20 < np.abs(omega).max() < 40
    quiet = QUIET.periodic_test(2)[2]
    np.testing.assert_allclose(quiet[0], quiet[1], atol=1e-9)


def test_motor_is_frozen_and_repeatable():
    with pytest.raises(dataclasses.FrozenInstanceError):
        QUIET.inertia = 1.0
    one, two = (maruta2011_dc_motor(100, rng=5) for _ in range(2))
    np.testing.assert_array_equal(one.speed, two.speed)


@pytest.mark.parametrize("make, message", [
    (lambda: DCMotor(inertia=0.0), "above zero"),
    (lambda: DCMotor(asymmetry=-1.0), "not below zero"),
    (lambda: maruta2011_dc_motor(0), "n, hold >= 1"),
    (lambda: DCMotor().respond([[1.0]]), r"finite values \(N,\)"),
    (lambda: DCMotor().respond([np.nan]), "finite values"),
    (lambda: DCMotor(friction=DryFriction(-1)), "0 <= coulomb"),
])  # fmt: skip
def test_bad_input_gets_one_clear_error(make, message):
    with pytest.raises(InputError, match=message):
        make()
