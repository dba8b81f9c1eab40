"""LPV models: interpolation, ranges, export, simulation, nlsys, joint minimax."""

import control
import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.hinfstruct import LPVModel, fit_lpv_minimax, fit_polynomial, lpv_errors, simulate_lpv

KAPPAS = np.array([-0.9, -0.4, 0.1, 0.5, 0.9])


@pytest.fixture(scope="module")
def quadratic():
    rng = np.random.default_rng(0)
    A = np.stack([-np.diag([3.0, 5.0]), 0.5 * rng.standard_normal((2, 2)), 0.2 * rng.standard_normal((2, 2))])
    B, C, D = (rng.standard_normal((3, *s)) for s in ((2, 1), (2, 2), (2, 1)))
    return LPVModel(A, B, C, D, (-0.9, 0.9))


def test_interpolation_recovers_polynomials_exactly(quadratic):
    local = [quadratic.frozen(k) for k in KAPPAS]
    back = LPVModel.from_models(KAPPAS, local, 2)
    for name in "ABCD":
        assert getattr(back, name) == pytest.approx(getattr(quadratic, name))
    assert back.fit(KAPPAS, local) == pytest.approx(dict.fromkeys("ABCD", 100.0))
    assert LPVModel.from_models(KAPPAS, local, 1).fit(KAPPAS, local)["B"] < 99
    assert back.degree == 2 and back.kappa_range == (-0.9, 0.9)


def test_from_parameters_agrees_with_from_models(arm):
    thetas = np.array([arm.theta(k) for k in KAPPAS])
    coefficients = fit_polynomial(KAPPAS, thetas, 2)
    one = LPVModel.from_parameters(arm.pattern(), coefficients, (-0.9, 0.9))
    two = LPVModel.from_models(KAPPAS, [arm.frozen(k) for k in KAPPAS], 2)
    for name in "ABCD":
        assert getattr(one, name) == pytest.approx(getattr(two, name), abs=1e-6)


def test_save_and_load_round_trip(quadratic, tmp_path):
    path = tmp_path / "model.json"
    quadratic.save(path)
    back = LPVModel.load(path)
    for name in "ABCD":
        assert np.array_equal(getattr(back, name), getattr(quadratic, name))
    assert back.kappa_range == quadratic.kappa_range


def test_arrays_are_read_only(quadratic):
    with pytest.raises(ValueError, match="read-only"):
        quadratic.A[0, 0, 0] = 1.0


def test_constant_schedule_is_the_frozen_model(quadratic):
    time = 0.01 * np.arange(300)
    u = np.random.default_rng(1).standard_normal((300, 1))
    y = quadratic.simulate(time, u, np.full(300, 0.3))
    frozen = control.c2d(quadratic.frozen(0.3), 0.01, "zoh")
    reference = control.forced_response(frozen, time, u.T).outputs.T
    assert y == pytest.approx(reference, abs=1e-7)


def test_nlsys_agrees_with_simulate(quadratic):
    time = 0.01 * np.arange(200)
    kappa = 0.8 * np.sin(2 * time)
    u = np.cos(3 * time)[:, None]
    fine = 0.001 * np.arange(1991)
    y = quadratic.simulate(fine, np.cos(3 * fine)[:, None], 0.8 * np.sin(2 * fine))
    system = quadratic.to_nlsys()
    assert system.input_labels == ["u1", "kappa"]
    other = control.input_output_response(
        system, time, np.vstack([u.T, kappa]), solve_ivp_kwargs={"rtol": 1e-8, "atol": 1e-9}
    ).outputs.T
    assert other == pytest.approx(y[::10], abs=5e-3 * np.abs(y).max())


def test_runge_kutta_converges_at_fourth_order(quadratic):
    def final(steps):
        return quadratic.simulate(
            [0.0, 1.0], np.ones((2, 1)), [-0.5, 0.5], substeps=steps
        )[-1]

    exact = final(640)
    errors = [np.linalg.norm(final(s) - exact) for s in (10, 20, 40)]
    assert np.log2(errors[0] / errors[1]) > 3.5 and np.log2(errors[1] / errors[2]) > 3.5


def test_joint_minimax_beats_two_steps(arm):
    targets = [arm.frozen(k) for k in KAPPAS]
    thetas = np.array([arm.theta(k) for k in KAPPAS])
    fit = fit_lpv_minimax(arm.pattern(), KAPPAS, targets, thetas, 1, max_iterations=15)
    assert fit.worst < 0.7 * fit.two_step_worst
    errors = lpv_errors(fit.lpv, KAPPAS, targets)
    assert max(e.value for e in errors) == pytest.approx(fit.worst, rel=1e-6)
    two_step = LPVModel.from_parameters(arm.pattern(), fit_polynomial(KAPPAS, thetas, 1), (-0.9, 0.9))
    assert max(
        e.value for e in lpv_errors(two_step, KAPPAS, targets)
    ) == pytest.approx(fit.two_step_worst, rel=1e-6)


def test_bad_input(quadratic, arm, tmp_path):
    time, u = 0.01 * np.arange(3), np.ones((3, 1))
    with pytest.raises(InputError, match="1 of 1 values of kappa lie outside"):
        quadratic.frozen(2.0)
    with pytest.raises(InputError, match="extrapolate=True"):
        quadratic.simulate(time, u, [0, 1, 2])
    with pytest.raises(InputError, match="NaN"):
        quadratic.simulate(time, u, [0, np.nan, 0])
    with pytest.raises(InputError, match="constant step"):
        quadratic.simulate([0, 1, 3], u, np.zeros(3))
    with pytest.raises(InputError, match=r"expected \(N,\), \(N, 1\)"):
        quadratic.simulate(time, np.ones((3, 2)), np.zeros(3))
    with pytest.raises(InputError, match="too long for a pole"):
        quadratic.simulate(time * 100, u, np.zeros(3))
    with pytest.raises(InputError, match="at least 1"):
        simulate_lpv(quadratic.stacked, time, u, np.zeros(3), substeps=0)
    with pytest.raises(InputError, match="needs 3 different kappa"):
        fit_polynomial([0.0, 1.0], np.ones((2, 1)), 2)
    with pytest.raises(InputError, match="cannot be read"):
        LPVModel.load(tmp_path / "absent.json")
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(InputError, match="is no LPV model"):
        LPVModel.load(tmp_path / "other.json")
    with pytest.raises(InputError, match="one target and one theta"):
        fit_lpv_minimax(arm.pattern(), KAPPAS, [arm.frozen(0.0)], np.ones((5, 16)), 1)


def test_the_nlsys_stays_in_its_range_and_starts_are_checked():
    model = LPVModel(A=np.array([[[-1.0]], [[-2.0]]]), B=np.array([[[1.0]], [[0.0]]]), C=np.array([[[1.0]], [[0.0]]]),
                     D=np.zeros((2, 1, 1)), kappa_range=(0.0, 1.0))
    system, wide = model.to_nlsys(), model.to_nlsys(extrapolate=True)
    assert system.dynamics(0.0, [1.0], [0.0, -5.0])[0] == pytest.approx(-1.0)
    assert wide.dynamics(0.0, [1.0], [0.0, -5.0])[0] == pytest.approx(9.0)
    t = np.arange(20) * 0.01
    with pytest.raises(InputError, match="expected 1 finite numbers"):
        model.simulate(t, np.ones(20), np.full(20, 0.5), x0=[1.0, 2.0])
