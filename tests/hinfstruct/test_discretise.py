"""d2c undoes the hold exactly, Tustin keeps the norm, and poles without a continuous counterpart are named.
"""

import control
import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.hinfstruct import c2d, d2c, frequency_response, hinf_norm, simulate_discrete
from pwaid.hinfstruct.statespace import as_matrices, difference

from .conftest import random_stable


def test_hold_inverse_is_exact():
    system = random_stable(5, 0)
    back = as_matrices(d2c(c2d(system, 0.05)))
    for mine, true in zip(back[:4], system, strict=True):
        assert mine == pytest.approx(true, abs=1e-9)


def test_c2d_agrees_with_python_control():
    system = random_stable(4, 1)
    mine, reference = c2d(system, 0.1), control.c2d(control.ss(*system), 0.1, "zoh")
    assert pytest.approx(reference.A, abs=1e-10) == mine.A
    assert pytest.approx(reference.B, abs=1e-10) == mine.B


def test_tustin_keeps_the_norm_and_leaves_the_half_sample_delay():
    dt = 0.02
    system = random_stable(4, 2)
    discrete = c2d(system, dt)
    tustin = d2c(discrete, method="tustin")
    assert hinf_norm(tustin).value == pytest.approx(hinf_norm(discrete).value, rel=1e-9)
    omega = np.array([1.0, 2.0])
    true = frequency_response(as_matrices(system), omega) - system[3]
    found = frequency_response(as_matrices(tustin), omega) - system[3]
    phase = np.angle(np.trace(found, axis1=1, axis2=2) / np.trace(true, axis1=1, axis2=2))
    assert phase == pytest.approx(-omega * dt / 2, rel=0.05)


def test_negative_modes_may_keep_their_static_gain():
    good = c2d(random_stable(3, 3), 0.05)
    A = np.block([[good.A, np.zeros((3, 1))], [np.zeros((1, 3)), np.array([[-0.8]])]])
    rng = np.random.default_rng(0)
    T = rng.standard_normal((4, 4))
    spoiled = (
        np.linalg.solve(T, A @ T),
        np.linalg.solve(T, np.vstack([good.B, [[1e-3, 2e-3]]])),
        np.hstack([good.C, [[1e-3], [1e-3]]]) @ T,
        good.D,
    )
    with pytest.raises(InputError, match=r"pole -0\.8.*negative real axis.*negative_poles='static'"):
        d2c(spoiled, dt=0.05)
    cured = d2c(spoiled, dt=0.05, negative_poles="static")
    assert cured.nstates == 3
    distance = hinf_norm(difference(as_matrices(c2d(cured, 0.05)), as_matrices(spoiled, dt=0.05)))
    assert distance.value < 2e-5  # c b (1/(1.8) and 1/(0.2)), what the mode does at high frequency
    ones = np.ones((4000, 2))
    final = [simulate_discrete(as_matrices(g, dt=0.05), ones)[-1] for g in (spoiled, c2d(cured, 0.05))]
    assert final[0] == pytest.approx(final[1], rel=1e-9)


@pytest.mark.parametrize(
    ("pole", "options", "message"),
    [
        (-0.5, {"dt": 0.1}, "negative real axis"),
        (0.0, {"dt": 0.1}, "pole at zero"),
        (0.5, {}, "needs a discrete system"),
        (0.5, {"dt": 0.1, "method": "foh"}, "expected 'zoh' or 'tustin'"),
        (-1.0, {"dt": 0.1, "method": "tustin"}, "pole at -1"),
        (0.5, {"dt": 0.1, "negative_poles": "drop"}, "expected 'raise' or 'static'"),
    ],
)
def test_bad_input(pole, options, message):
    with pytest.raises(InputError, match=message):
        d2c(([[pole]], [[1.0]], [[1.0]], [[0.0]]), **options)


def test_c2d_bad_input():
    with pytest.raises(InputError, match="positive sampling time"):
        c2d(random_stable(2, 0), 0.0)
    with pytest.raises(InputError, match="discrete already"):
        c2d(c2d(random_stable(2, 0), 0.1), 0.1)
