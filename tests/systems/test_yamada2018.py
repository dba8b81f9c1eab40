"""The two-inertia drive with backlash: gains, published responses, and the figures' claims."""

import numpy as np
import pytest

from pwaid.dynamics.pwa_simulation import PWAStatus
from pwaid.errors import InputError
from pwaid.systems.yamada2018 import (
    TwoInertia,
    closed_loop,
    damping,
    pd_gains,
    position_loop,
    yamada2018_two_inertia,
)

STEP = 2e-5


def respond(kind, duration, reference=0.30, loads=(), gains=None, step=STEP, **options):
    system = closed_loop(kind, gains=gains)
    t = np.arange(round(duration / step) + 1) * step
    u = np.zeros((t.size, 2))
    u[t >= 0.010 - 1e-9, 0] = reference
    for at, size in loads:
        u[t >= at - 1e-9, 1] += size
    run = system.simulate(t, u, **options)
    assert run.status is PWAStatus.DONE
    return t, dict(zip(system.outputs, run.outputs.T, strict=True)), run


def first_peak(T):
    at = np.flatnonzero((T[1:-1] > T[:-2]) & (T[1:-1] >= T[2:]) & (T[1:-1] > 0.2))
    return T[1:-1][at[0]]


@pytest.fixture(scope="module")
def steps():
    return {kind: respond(kind, 0.4) for kind in ("none", "linear", "switched")}


def test_gains_place_the_poles_on_the_rigid_drive():
    p, g = TwoInertia(), pd_gains()
    J, D = p.J_M + p.J_L, p.D_M + p.D_L
    loop = np.polyadd(np.polymul([g.tau_D, 1, 0], [J, D]), [g.K_P * g.tau_D + g.K_D, g.K_P])
    w1, w2, z = 2 * np.pi * 18, 2 * np.pi * 15, 0.7
    wanted = np.polymul([1, w1], [1, 2 * z * w2, w2**2])
    np.testing.assert_allclose(loop / loop[0], wanted, rtol=1e-12)
    assert (g.K_P, g.K_D, 1e3 * g.tau_D) == pytest.approx((10.2813, 0.054709, 5.8281), rel=1e-5)


def test_the_gap_is_equations_9_and_10_and_contact_is_12_and_13():
    p, plant = TwoInertia(), yamada2018_two_inertia()
    gap, plus, minus = plant.cells
    JM, JL = p.J_M, p.J_L
    np.testing.assert_allclose(plus.A, [
        [-p.D_L / JL, p.D_B / JL, 0, p.K / JL],
        [-p.D_M / JM + p.D_L / JL, -p.D_M / JM - p.D_B / JM - p.D_B / JL, 0, -p.K / JM - p.K / JL],
        [1, 0, 0, 0], [0, 1, 0, 0]])  # fmt: skip
    np.testing.assert_allclose(plus.a, [-p.K * p.beta / JL, p.K * p.beta / JM + p.K * p.beta / JL, 0, 0])
    np.testing.assert_array_equal(minus.A, plus.A)
    np.testing.assert_array_equal(minus.a, -plus.a)
    np.testing.assert_array_equal(gap.a, 0)
    assert (gap.A[:2, 3] == 0).all()


def test_first_impact_is_reduced_by_43_percent(steps):
    impact = {kind: first_peak(y["T_s"]) for kind, (_, y, _) in steps.items()}
    assert impact["none"] == pytest.approx(2.4352, abs=2e-4)
    assert 100 * (1 - impact["linear"] / impact["none"]) == pytest.approx(42.7, abs=0.1)
    assert impact["switched"] == pytest.approx(impact["linear"], abs=1e-9)  # until then the switch is on
    gains = pd_gains(viscous=TwoInertia().D_M)
    low, high = (first_peak(respond(kind, 0.05, gains=gains)[1]["T_s"]) for kind in ("linear", "none"))
    assert 100 * (1 - low / high) == pytest.approx(44.1, abs=0.1)


def test_overshoots_and_their_order(steps):
    over = {kind: 1e3 * (y["theta_L"].max() - 0.30) for kind, (_, y, _) in steps.items()}
    assert over["switched"] < over["none"] < over["linear"]
    assert (over["switched"], over["none"], over["linear"]) == pytest.approx((6.97, 16.72, 69.11), abs=0.02)


def test_limit_cycle_without_damping_and_none_with_it():
    t, y, _ = respond("none", 5.0, step=1e-4)
    late = t > 4
    angle = y["theta_L"][late] - 0.30
    assert 1e3 * np.ptp(angle) == pytest.approx(8.67, rel=0.01)
    up = np.flatnonzero((angle[:-1] < 0) & (angle[1:] >= 0))
    assert 1e3 * np.diff(t[late][up]).mean() == pytest.approx(102.4, abs=0.2)
    for kind in ("linear", "switched"):
        t, y, _ = respond(kind, 5.0, step=1e-3)
        assert np.ptp(y["theta_L"][t > 4.5]) < 0.01 * 8.67e-3


def test_disturbance_responses():
    """Figs. 6-7: linear damping lowers the impact at the price of a larger angle; switched beats none."""
    loads = {kind: respond(kind, 0.3, 0.0, [(0.010, -0.5), (0.15, 1.0)])[:2]
             for kind in ("none", "linear", "switched")}
    early = {kind: 1e3 * -y["theta_L"][t < 0.15].min() for kind, (t, y) in loads.items()}
    late = {kind: 1e3 * y["theta_L"].max() for kind, (_, y) in loads.items()}
    assert (early["none"], early["linear"], early["switched"]) == pytest.approx((49.9, 67.3, 49.5), abs=0.06)
    assert (late["none"], late["linear"], late["switched"]) == pytest.approx((51.1, 97.3, 49.8), abs=0.06)
    impact = {kind: first_peak(y["T_s"]) for kind, (_, y) in loads.items()}
    assert (impact["none"], impact["linear"]) == pytest.approx((1.175, 0.701), abs=1e-3)
    assert impact["switched"] == pytest.approx(impact["none"], abs=1e-6)


@pytest.mark.parametrize("twist", [0.0, 0.010])
def test_the_free_motions_of_figure_8_converge(twist):
    system = closed_loop("switched")
    for w_B, w_L in [(1, 1), (1, -1), (-1, -1), (-1, 1)]:
        x0 = np.zeros(len(system.states))
        x0[0], x0[1], x0[3] = w_L, w_B, twist
        run = system.simulate(np.linspace(0, 2, 401), None, x0)
        assert run.status is PWAStatus.DONE
        assert np.abs(run.states[-1, :2]).max() < 0.03 and np.abs(run.states[-1, 2]) <= 1.2e-4


@pytest.mark.parametrize("kind", ["none", "linear", "switched"])
def test_refining_the_step_changes_nothing(kind):
    _t, _, run = respond(kind, 0.5, step=1e-3)
    for scale in (0.5, 0.2):
        other = respond(kind, 0.5, step=1e-3, step_scale=scale)[2]
        np.testing.assert_allclose(other.states, run.states, atol=1e-9)
        assert len(other.crossings) == len(run.crossings)


def test_switched_damping_follows_its_condition(steps):
    _, y, _ = steps["switched"]
    on = y["omega_B"] * y["omega_L"] > 0
    off = y["omega_B"] * y["omega_L"] < 0
    np.testing.assert_allclose(y["T_B"][on], -0.8 * y["omega_B"][on], atol=1e-12)
    np.testing.assert_array_equal(y["T_B"][off], 0)
    np.testing.assert_allclose(y["T_M"], y["T_PD"] + y["T_B"], atol=1e-12)


def test_torque_is_the_springs_and_the_dampers(steps):
    p = TwoInertia()
    _, y, _ = steps["linear"]
    dead = np.sign(y["theta_B"]) * np.maximum(np.abs(y["theta_B"]) - p.beta, 0)
    expected = np.where(dead != 0, p.K * dead + p.D_B * y["omega_B"], 0)
    np.testing.assert_allclose(y["T_s"], expected, atol=1e-9)


def test_reference_filter_can_be_left_out():
    assert position_loop(pd_gains(), damping("none"), None).states == ("z_D",)


@pytest.mark.parametrize("make, message", [
    (lambda: TwoInertia(K=0.0), "K = 0.0; expected a finite number, positive"),
    (lambda: TwoInertia(D_B=-1.0), "zero or more"),
    (lambda: TwoInertia(beta=np.nan), "finite"),
    (lambda: damping("cubic"), "expected one of"),
    (lambda: pd_gains(omega_1=1.0, omega_2=1.0), "place the poles faster"),
])  # fmt: skip
def test_bad_parameters_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
