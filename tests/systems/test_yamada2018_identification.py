"""Recordings of the bench hold what the joint's law needs: half gap, stiffness and damping."""

import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.systems.yamada2018_bench import Bench, identification_run, joint_motion


@pytest.mark.parametrize("bench", [Bench(encoder_bits=None), Bench(), Bench(torque_noise=0.02)])
def test_least_squares_in_contact_finds_the_joint(bench):
    run = identification_run(bench, rng=0)
    twist, speed, torque = joint_motion(run)
    share = np.bincount(run.contact, minlength=3) / run.contact.size
    assert share.min() > 0.1  # gap and both contacts are visited
    inside = np.abs(twist) > 7.9e-3
    X = np.column_stack([twist, speed, np.sign(twist)])[inside]
    K, D, offset = np.linalg.lstsq(X, torque[inside], rcond=None)[0]
    assert pytest.approx(300.0, rel=0.002) == K
    assert pytest.approx(0.1, rel=0.02) == D
    assert -offset / K == pytest.approx(7.8e-3, rel=0.002)


def test_speeds_are_the_true_ones():
    run = identification_run(Bench(encoder_bits=None), duration=0.5, rng=1)
    _, speed, _ = joint_motion(run)
    true = run.states[1:-1, 1] - run.states[1:-1, 3]
    assert np.sqrt(np.mean((speed - true) ** 2)) < 2e-3 * np.std(true)


def test_bad_lengths_are_refused():
    with pytest.raises(InputError, match="expected positive values"):
        identification_run(duration=0.0)
