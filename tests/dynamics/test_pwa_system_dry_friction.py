"""Dry friction with a true standstill: closed forms, an ODE solver, and Filippov sliding as judges."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pwaid.dynamics.dry_friction import DryFriction, advance, check_events, drive_tables
from pwaid.dynamics.pwa_system import Cell, PWASystem
from pwaid.errors import InputError, SolverError


def run(drive, x0, torques, dt):
    """States after each interval; also the modes."""
    x, mode = np.array(x0, dtype=float), np.zeros(1 + drive.inertia.size, dtype=np.int64)
    states, modes = [x.copy()], []
    for torque in torques:
        check_events(advance(drive, mode, x, np.array([torque]), dt))
        states.append(x.copy())
        modes.append(mode.copy())
    return np.array(states), np.array(modes)


def mass(friction, stiffness=0.0, viscous=0.0, inertia=1.0, step_scale=1.0):
    """x, v with J v̇ = u − k x − d v − F(v)."""
    A = [[[0, 1], [-stiffness / inertia, -viscous / inertia]]]
    return drive_tables(A, [[0, 0]], [[0], [1 / inertia]], [[]], (1,), (inertia,), (friction,), step_scale)


def test_braking_is_linear_and_ends_in_standstill():
    states, modes = run(mass(DryFriction(2.0)), [0.0, 3.0], np.zeros(20), 0.1)
    t = 0.1 * np.arange(21)
    np.testing.assert_allclose(states[:, 1], np.maximum(3 - 2 * t, 0.0), atol=1e-14)
    assert states[-1, 0] == pytest.approx(9 / 4, abs=1e-14)
    assert (modes[15:, 1] == 0).all() and (modes[:14, 1] == 1).all()


def test_a_spring_loses_twice_the_friction_per_half_swing():
    k, F = 100.0, 0.7
    half = np.pi / np.sqrt(k)
    states, modes = run(mass(DryFriction(F), k), [1.0, 0.0], np.zeros(200), half)
    turning = np.abs(states[:, 0])
    swings = int(np.floor((k * 1.0 / F - 1) / 2)) + 1
    np.testing.assert_allclose(turning[: swings + 1], 1 - 2 * F / k * np.arange(swings + 1), atol=1e-12)
    assert (modes[swings:, 1] == 0).all() and turning[-1] * k <= F


def test_release_waits_for_the_static_level():
    drive = mass(DryFriction(0.4, 1.0, 0.1, 1))
    states, _ = run(drive, [0, 0], [0.5, 0.99, -0.99, 1.0, 1.01, 1.01], 0.1)
    assert (states[:5] == 0).all() and states[5, 1] > 0 and states[6, 1] > states[5, 1]


@pytest.mark.parametrize("exponent", [1, 2])
def test_stribeck_slip_agrees_with_an_ode_solver(exponent):
    friction = DryFriction(0.5, 1.5, 0.3, exponent)
    states, _ = run(mass(friction, stiffness=30.0, viscous=0.2), [0.5, 0.0], np.zeros(1), 0.3)

    def rhs(t, x):
        level = 0.5 + np.exp(-(abs(x[1] / 0.3) ** exponent))
        return [x[1], -30 * x[0] - 0.2 * x[1] + level]  # moves in the negative direction throughout

    solution = solve_ivp(rhs, (0, 0.3), [0.5, -1e-300], method="DOP853", rtol=1e-12, atol=1e-13)
    assert solution.y[1, -1] < 0
    np.testing.assert_allclose(states[-1], solution.y[:, -1], atol=1e-10)


def test_standstill_equals_filippov_sliding():
    """Two inertias with backlash, Coulomb friction on one: the event scheme against `PWASystem`."""
    J, d, K, D, beta, F = 1e-3, 0.05, 300.0, 0.1, 5e-3, 0.06
    push, torque = np.array([0, -1 / J, 0, 1 / J]), np.array([K, D, -K, -D])
    free = np.array([[0, 1, 0, 0], [0, -d / J, 0, 0], [0, 0, 0, 1], [0, 0, 0, -d / J]])
    closed, twist = free + np.outer(push, torque), np.array([1.0, 0, -1, 0])
    bias = K * beta * push
    guards = [[(-twist, beta, 1), (twist, beta, 2)], [(twist, -beta, 0)], [(-twist, -beta, 0)]]
    B = [[0], [1 / J], [0], [0]]
    drive = drive_tables([free, closed, closed], [0 * bias, -bias, bias], B, guards, (1,), (J,),
                         (DryFriction(F),))
    cells = []
    for A, a, rows in zip((free, closed, closed), (0 * bias, -bias, bias), guards, strict=True):
        for sign in (1, -1):
            G = np.array([r[0] for r in rows] + [[0, sign, 0, 0]])
            cells.append(Cell(A, a + np.array([0, -sign * F / J, 0, 0]), B, G, [r[1] for r in rows] + [0.0]))
    system = PWASystem(tuple(cells))
    t = np.arange(401) * 1e-3
    u = 0.12 * np.sin(2 * np.pi * 6 * t)
    states, modes = run(drive, np.zeros(4), u[:-1], 1e-3)
    other = system.simulate(t, u, np.zeros(4), sliding="filippov")
    assert (modes[:, 1] == 0).sum() > 10 and len(other.slides) > 3
    np.testing.assert_allclose(states, other.states, atol=1e-10)


def test_refining_the_step_changes_nothing():
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(60), 5)
    results = [run(mass(DryFriction(0.4, 0.9, 0.2, 1), 20.0, 0.1, step_scale=s), [0, 0], u, 0.02)[0]
               for s in (1, 0.5, 0.2)]
    for other in results[1:]:
        np.testing.assert_allclose(other, results[0], atol=1e-10)


def test_rest_at_exactly_the_limit_does_not_chatter():
    states, modes = run(mass(DryFriction(1.0, 1.0), 10.0), [0.1, 0.0], np.zeros(5), 0.1)
    assert (states == states[0]).all() and (modes[:, 1] == 0).all()


@pytest.mark.parametrize("arguments, message", [
    ((-1.0,), "0 <= coulomb <= static"), ((1.0, 0.5), "0 <= coulomb <= static"), ((np.nan,), "0 <= coulomb"),
    ((1.0, 2.0, 0.0), "positive velocity"), ((1.0, 2.0, 1.0, 3), "1 or 2"),
])  # fmt: skip
def test_bad_friction_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        DryFriction(*arguments)


def test_accumulating_events_raise():
    with pytest.raises(SolverError, match="accumulate"):
        check_events(-1001)


def test_friction_curve():
    f = DryFriction(1.0, 3.0, 0.5, 2)
    np.testing.assert_allclose(f.torque([0.0, 0.5, -0.5, 50.0]), [0, 1 + 2 / np.e, -1 - 2 / np.e, 1.0])
