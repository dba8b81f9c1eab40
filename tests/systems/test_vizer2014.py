"""The flexible arm:

Energy, linearisation, M0 + kappa M1, outputs, sweeps with and without the Coriolis torque.
"""

import control
import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.hinfstruct import bft, c2d, simulate_discrete
from pwaid.hinfstruct.statespace import as_matrices
from pwaid.systems.vizer2014 import (
    OPERATING_POINTS,
    FlexibleArmParameters,
    prbs,
    vizer2014_flexible_arm,
    vizer2014_flexible_arm_experiment,
    vizer2014_flexible_arm_linear,
    vizer2014_flexible_arm_lpv,
    vizer2014_flexible_arm_model,
    vizer2014_flexible_arm_structure,
    vizer2014_flexible_arm_sweep,
)
from pwaid.systems.vizer2014_dynamics import integrate, joint_rates, mass_and_forces

P = FlexibleArmParameters()


def mass(q, dq=(0, 0, 0, 0)):
    M, h = np.empty((4, 4)), np.empty(4)
    mass_and_forces(np.array(q, dtype=float), np.array(dq, dtype=float), P.packed, M, h)
    return M, h


def test_rigid_limit_is_the_textbook_two_link_arm():
    M, _ = mass([0.0, 0.9, 0.0, 0.0])
    l1, l2 = P.l1, P.l2
    outer = P.rho2 * l2**3 / 3 + P.m_tip * l2**2 + P.j_tip
    coupling = (P.rho2 * l2**2 / 2 + P.m_tip * l2) * l1 * np.cos(0.9)
    inner = P.rho1 * l1**3 / 3 + (P.m_elbow + P.rho2 * l2 + P.m_tip) * l1**2 + P.j_elbow
    assert M[0, 0] == pytest.approx(inner + outer + 2 * coupling + P.jr1)
    assert M[0, 1] == pytest.approx(outer + coupling)
    assert M[1, 1] == pytest.approx(outer + P.jr2)


def test_velocity_forces_are_those_of_lagrange():
    """h = dM/dt dq - 1/2 d(dq' M dq)/dq, with the derivatives of the mass matrix by central differences."""
    rng = np.random.default_rng(0)
    q, dq = np.array([0.3, 1.1, 0.08, -0.05]), rng.standard_normal(4)
    slopes = []
    for k in range(4):
        step = 1e-6 * np.eye(4)[k]
        slopes.append((mass(q + step)[0] - mass(q - step)[0]) / 2e-6)
    slopes = np.array(slopes)
    expected = np.einsum("k,kij,j->i", dq, slopes, dq) - 0.5 * np.einsum("kij,i,j->k", slopes, dq, dq)
    assert mass(q, dq)[1] == pytest.approx(expected, abs=1e-7)


def test_energy_is_conserved_without_the_loop():
    packed = P.packed.copy()
    packed[12:] = 0.0  # gains
    q0, dq0 = np.array([0.0, 1.0, 0.02, -0.02]), np.array([2.0, -3.0, 0.0, 0.0])
    q, dq = integrate(np.zeros((3000, 2)), 1e-4, 1, q0, dq0, packed)
    springs = 4 * np.array([P.ei1 * P.l1, P.ei2 * P.l2])
    energy = [
        0.5 * w @ mass(x)[0] @ w + 0.5 * springs @ x[2:] ** 2
        for x, w in zip(q[::100], dq[::100], strict=True)
    ]
    assert np.ptp(energy) < 1e-6 * energy[0]


def test_undeformed_mass_matrix_is_affine_in_kappa():
    lpv = vizer2014_flexible_arm_lpv()
    for theta2 in (0.3, 1.0, 2.5):
        assert mass([0.4, theta2, 0, 0])[0] == pytest.approx(lpv.M0 + np.cos(theta2) * lpv.M1, abs=1e-14)
    for i, j in ((1, 1), (1, 3), (3, 3)):
        assert abs(lpv.M1[i, j]) < 1e-14


def test_linearisation_is_the_derivative_of_the_simulation():
    theta2, n, tiny = 0.8, 200, 1e-6
    references = tiny * prbs(n, hold=10, rng=0)
    run = vizer2014_flexible_arm(references, 1e-4, theta2)
    linear = as_matrices(c2d(vizer2014_flexible_arm_linear(theta2), 1e-4))
    assert run.outputs / tiny == pytest.approx(simulate_discrete(linear, references) / tiny, abs=1e-4)


def test_linear_model_has_the_structure_of_the_paper():
    structure, lpv = vizer2014_flexible_arm_structure(), vizer2014_flexible_arm_lpv()
    assert structure.size == 16 and structure.names[:2] == ("th1", "th2")
    system = vizer2014_flexible_arm_linear(np.pi / 2)
    m = structure.matrices(lpv.theta(0.0))
    assert pytest.approx(m.A, abs=1e-6) == system.A and pytest.approx(-system.A[:, 2:4]) == system.B
    assert system.state_labels == ["v1", "v2", "dtheta1", "dtheta2", "dv1", "dv2"]


def test_inverse_kinematics_of_a_rigid_posture_and_of_a_moving_tip():
    q, dq = np.array([[0.2, 1.0, 0.0, 0.0]]), np.array([[0.7, -0.4, 0.0, 0.0]])
    assert joint_rates(q, dq, (P.l1, P.l2)) == pytest.approx(dq[:, :2])
    run = vizer2014_flexible_arm(0.5 * prbs(400, hold=10, rng=1), 1e-4, 1.0)
    linear = vizer2014_flexible_arm(0.5 * prbs(400, hold=10, rng=1), 1e-4, 1.0, outputs="linear")
    assert bft(run.outputs, linear.outputs).min() > 98


def test_runge_kutta_step_is_fine_enough():
    references = 0.3 * prbs(2000, hold=20, rng=2)
    one = vizer2014_flexible_arm(references, 1e-4, 1.0)
    four = vizer2014_flexible_arm(references, 1e-4, 1.0, substeps=4)
    assert one.outputs == pytest.approx(four.outputs, abs=1e-6)


def test_experiment_and_noise_level():
    run = vizer2014_flexible_arm_experiment(OPERATING_POINTS[3], rng=0)
    assert run.outputs.shape == (3000, 2) and run.dt == pytest.approx(1e-3)
    noise = run.noisy(30, 0) - run.outputs
    assert 10 * np.log10(run.outputs.var(axis=0) / noise.var(axis=0)) == pytest.approx([30, 30], abs=0.3)
    assert np.array_equal(run.noisy(30, 0), run.noisy(30, 0))


def test_prbs_is_a_maximum_length_sequence():
    bits = prbs(2047, channels=2, rng=0)
    assert set(np.unique(bits)) == {-1.0, 1.0} and abs(bits[:, 0].sum()) == 1
    spectrum = np.abs(np.fft.fft(bits[:, 0])) ** 2
    assert spectrum[1:] == pytest.approx(np.full(2046, 2048.0))
    assert abs(bits[:, 0] @ bits[:, 1]) == 1
    assert np.all(prbs(40, hold=4, rng=0).reshape(10, 4, 2).std(axis=1) == 0)


def test_sweeps_need_the_coriolis_torque():
    lpv = vizer2014_flexible_arm_lpv()
    run = vizer2014_flexible_arm_sweep(1.5, amplitude=0.1, rng=0)
    assert run.theta2[[0, -1]] == pytest.approx([np.pi / 8, 7 * np.pi / 8], rel=0.03)
    frozen = bft(run.outputs, lpv.simulate(run.time, run.inputs, run.theta2))
    repaired = bft(run.outputs, lpv.simulate(run.time, run.inputs, run.theta2, coriolis=True))
    assert frozen[0] < 60 and repaired.min() > 99


def test_model_as_nlsys():
    run = vizer2014_flexible_arm_sweep(0.3, amplitude=0.1, rng=0, clock=1e-2, decimation=100)
    system = vizer2014_flexible_arm_model(coriolis=True)
    assert system.state_labels[-1] == "theta2" and system.nstates == 7
    x0 = np.append(np.zeros(6), np.pi / 8)
    # Inputs are held in the recording and interpolated by python-control: repeat each sample just before the
    # next.
    time = np.ravel(np.column_stack([run.time, run.time + 1e-2 - 1e-9]))
    held = np.repeat(run.inputs, 2, axis=0)
    y = control.input_output_response(
        system, time, held.T, x0, solve_ivp_kwargs={"max_step": 1e-3, "rtol": 1e-6}
    ).outputs.T[::2]
    assert bft(run.outputs, y).min() > 98


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: vizer2014_flexible_arm(np.ones((5, 3)), 1e-4, 1.0), r"expected \(N, 2\)"),
        (lambda: vizer2014_flexible_arm(np.full((5, 2), np.nan), 1e-4, 1.0), "NaN"),
        (lambda: vizer2014_flexible_arm(np.ones((5, 2)), -1.0, 1.0), "positive step"),
        (lambda: vizer2014_flexible_arm(np.ones((5, 2)), 1e-4, 1.0, outputs="tip"), "inverse_kinematics"),
        (lambda: vizer2014_flexible_arm(np.ones((900, 2)), 0.05, 1.0), "diverged"),
        (lambda: vizer2014_flexible_arm_experiment(1.0, clock=1.5e-4), "not held"),
        (lambda: vizer2014_flexible_arm_sweep(0.0), "duration = 0.0"),
        (lambda: FlexibleArmParameters(l1=-1.0), "l1 = -1.0; expected a finite positive"),
        (lambda: prbs(10, register=12), "register = 12"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()
