"""M0 + kappa M1:

The pattern, the closed-form start, joint identification, and the Coriolis torque from energy.
"""

import control
import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.hinfstruct import InertiaLPV, InertiaStructure, fit_inertia, simulate_lpv


@pytest.fixture(scope="module")
def structure(arm):
    return InertiaStructure(np.abs(arm.M1) > 1e-9, arm.output, joints=2, first_gain=arm.gains[0])


def test_pattern_reproduces_the_frozen_model(arm):
    m, p = arm.matrices(0.3), arm.pattern().matrices(arm.theta(0.3))
    for mine, pattern in zip(m[:4], p[:4], strict=True):
        assert pattern == pytest.approx(mine)
    assert pytest.approx(np.eye(2), abs=1e-12) == m.at_zero()


def test_pack_and_unpack_are_inverse_up_to_the_torque_unit(arm, structure):
    assert structure.size == 20 == len(structure.names)
    back = structure.unpack(structure.pack(arm))
    for name in ("M0", "M1", "stiffness", "gains"):
        assert getattr(back, name) == pytest.approx(getattr(arm, name))
    double = InertiaLPV(2 * arm.M0, 2 * arm.M1, 2 * arm.stiffness, 2 * arm.gains, arm.output)
    assert structure.pack(double) == pytest.approx(structure.pack(arm))
    assert double.theta(0.1) == pytest.approx(arm.theta(0.1))


def test_structured_jacobian(arm, structure):
    model, p = structure.structured(0.4), structure.pack(arm)
    exact = model.differentiate(p)
    for k in range(structure.size):
        step = 1e-6 * max(abs(p[k]), 1e-3) * np.eye(p.size)[k]
        for d, plus, minus in zip(exact, model.evaluate(p + step), model.evaluate(p - step), strict=True):
            assert d[k] == pytest.approx(
                (plus - minus) / (2 * step[k]), rel=1e-4, abs=1e-5 * np.abs(d[k]).max() + 1e-9
            )


def test_closed_form_start_is_exact(arm, structure):
    kappas = [-0.6, 0.1, 0.8]
    assert structure.start(
        kappas, [arm.theta(k) for k in kappas]
    ) == pytest.approx(structure.pack(arm), rel=1e-7)


def test_joint_fit_from_wrong_parameters(arm, structure):
    kappas = [-0.9, -0.3, 0.3, 0.9]
    true = structure.pack(arm)
    start = true * np.random.default_rng(0).uniform(0.9, 1.1, true.size)
    fit = fit_inertia(structure, kappas, [arm.frozen(k) for k in kappas], start=start)
    assert structure.pack(fit.model) == pytest.approx(true, rel=1e-5)
    assert fit.worst < 1e-6 and fit.parameters["k1"] == pytest.approx(arm.stiffness[0], rel=1e-5)


def test_frozen_simulation_agrees_with_the_general_lpv_simulator(arm):
    time = 2e-4 * np.arange(1500)
    inputs = np.sign(np.random.default_rng(0).standard_normal((1500, 2)))
    angle = 0.5 + 2 * time
    mine = arm.simulate(time, inputs, angle)
    assert mine == pytest.approx(simulate_lpv(arm.stacked, time, inputs, np.cos(angle)), abs=1e-6)


def test_coriolis_torque_keeps_the_energy(arm):
    """Without loop gains and with the true angle, 1/2 dq' M dq + 1/2 v' K v is constant.

    Frozen, it is not.
    """
    free = InertiaLPV(arm.M0, arm.M1, arm.stiffness, np.zeros(2), arm.output)
    drift = {}
    for coriolis in (True, False):
        system = free.to_nlsys(coriolis=coriolis, scheduling="state")
        x0 = np.array([0.0, 0.0, 2.0, -3.0, 0.0, 0.0, 1.0])
        t = np.linspace(0, 0.2, 41)
        x = control.input_output_response(
            system, t, np.zeros((2, 41)), x0, solve_ivp_kwargs={"rtol": 1e-9, "atol": 1e-10}
        ).states
        dq = x[2:6]
        M = arm.M0[:, :, None] + np.cos(x[6]) * arm.M1[:, :, None]
        energy = 0.5 * np.einsum("it,ijt,jt->t", dq, M, dq) + 0.5 * arm.stiffness @ x[:2] ** 2
        drift[coriolis] = np.ptp(energy) / energy[0]
    assert drift[True] < 1e-6 < 1e-2 < drift[False]


def test_nlsys_with_measured_angle_agrees_with_simulate(arm):
    time = 1e-3 * np.arange(60)
    inputs = np.column_stack([np.ones(60), -np.ones(60)])
    angle = np.full(60, 0.7)
    system = arm.to_nlsys(coriolis=True)
    assert system.input_labels == ["dtheta1_ref", "dtheta2_ref", "theta2"]
    y = control.input_output_response(
        system, time, np.vstack([inputs.T, angle]), solve_ivp_kwargs={"rtol": 1e-9, "atol": 1e-10}
    ).outputs.T
    fine = 1e-4 * np.arange(591)
    mine = arm.simulate(fine, np.tile([1.0, -1.0], (591, 1)), np.full(591, 0.7), coriolis=True)
    assert y == pytest.approx(mine[::10], abs=1e-5)


def test_arrays_are_read_only(arm):
    with pytest.raises(ValueError, match="read-only"):
        arm.M0[0, 0] = 1.0


def test_bad_input(arm, structure):
    with pytest.raises(InputError, match="M0 contains NaN"):
        InertiaLPV(np.full((4, 4), np.nan), arm.M1, arm.stiffness, arm.gains, arm.output)
    with pytest.raises(InputError, match="expected 'input' or 'state'"):
        arm.to_nlsys(scheduling="guess")
    with pytest.raises(InputError, match=r"for 2 joints and 2 springs"):
        InertiaLPV(np.eye(3), np.eye(3), np.ones(2), np.ones(2), np.ones((2, 4)))
    with pytest.raises(InputError, match="two different kappa"):
        structure.start([0.1], [arm.theta(0.1)])
    with pytest.raises(InputError, match="needs local_thetas"):
        fit_inertia(structure, [0.1], [arm.frozen(0.1)])
    with pytest.raises(InputError, match="NaN"):
        arm.simulate([0, 1e-3], np.full((2, 2), np.nan), [0.1, 0.1])
