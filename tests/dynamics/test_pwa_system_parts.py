"""Borders, feedback, sampling, python-control and phase portraits of PWA systems."""

import control
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import cont2discrete

from pwaid.dynamics.phase_portrait import phase_portrait
from pwaid.dynamics.pwa_convert import cells_of_hyperplanes, from_nlsys, to_nlsys
from pwaid.dynamics.pwa_discrete import discretise
from pwaid.dynamics.pwa_feedback import close_loop
from pwaid.dynamics.pwa_system import Cell, PWASystem
from pwaid.errors import InputError
from pwaid.systems.yamada2018 import TwoInertia, closed_loop, damping, yamada2018_two_inertia


def two_pieces(gap=0.0, right=-3.0):
    """ẋ = −x left of 1, right·(x − 1) − 1 + gap right of 1."""
    return PWASystem((Cell([[-1.0]], G=[[-1.0]], g=[1.0]),
                      Cell([[right]], [-right - 1 + gap], G=[[1.0]], g=[-1.0])))


def test_a_continuous_system_has_continuous_borders():
    (border,) = two_pieces().continuity()
    assert border.continuous and border.jump == 0.0 and border.where is None
    np.testing.assert_allclose(np.append(border.normal, border.offset), [1.0, -1.0])


def test_a_jump_is_reported_with_place_and_size():
    (border,) = two_pieces(gap=0.25).continuity()
    assert not border.continuous
    assert border.jump == pytest.approx(0.25) and border.where == pytest.approx([1.0])


def test_backlash_jumps_by_its_damping_times_the_twist_speed():
    p = TwoInertia()
    borders = yamada2018_two_inertia().continuity([(-1, 1), (-5, 5), (-1, 1), (-1, 1)])
    assert [b.cells for b in borders] == [(0, 1), (0, 2)]
    for border in borders:
        assert border.jump == pytest.approx(p.D_B * 5 * (1 / p.J_M + 1 / p.J_L))
        assert abs(border.where[1]) == pytest.approx(5) and abs(border.where[3]) == pytest.approx(p.beta)
        assert border.state == 1 and border.mismatch == 0.0
    assert all(b.jump == np.inf for b in yamada2018_two_inertia().continuity())
    assert all(b.continuous for b in yamada2018_two_inertia(TwoInertia(D_B=0.0)).continuity())


def test_wrong_continuity_matrices_are_found():
    cells = list(yamada2018_two_inertia().cells)
    cells[1] = cells[1].replace(f=cells[1].f + 1e-3)
    border = PWASystem(tuple(cells)).continuity()[0]
    assert border.mismatch == pytest.approx(1e-3)


def test_closed_loop_cells_are_the_pairs():
    assert len(closed_loop("switched").cells) == 12
    assert len(closed_loop("none").cells) == len(closed_loop("linear").cells) == 3


def test_feedback_equals_the_hand_made_loop():
    plant = PWASystem((Cell([[-1.0]], B=[[1.0]]),), ("x",), ("u",), ("x",))
    integrator = PWASystem((Cell([[0.0]], B=[[1.0, -1.0]], C=[[2.0]], D=[[0.5, -0.5]]),), ("z",),
                           ("r", "x"), ("u",))
    loop = close_loop(plant, integrator)
    np.testing.assert_allclose(loop.cells[0].A, [[-1.5, 2.0], [-1.0, 0.0]])
    np.testing.assert_allclose(loop.cells[0].B, [[0.5], [1.0]])
    assert loop.inputs == ("r",) and loop.outputs == ("x", "u") and loop.states == ("x", "z")


def test_a_switching_controller_moves_its_guards_into_the_loop():
    plant = PWASystem((Cell([[0.0, 1.0], [0.0, 0.0]], B=[[0.0], [1.0]]),), ("p", "v"), ("u",), ("p", "v"))
    none = np.zeros((0, 0))
    saturated = PWASystem(tuple(
        Cell(none, B=np.zeros((0, 2)), G=np.zeros((len(H), 0)), H=H, g=g, C=np.zeros((1, 0)), c=[c], D=[D])
        for H, g, c, D in [([[1, 1], [-1, -1]], [1, 1], 0, [-1, -1]), ([[1, 1]], [-1], -1, [0, 0]),
                           ([[-1, -1]], [-1], 1, [0, 0])]
    ), (), ("p", "v"), ("u",))  # fmt: skip
    loop = close_loop(plant, saturated)
    assert len(loop.cells) == 3
    run = loop.simulate(np.linspace(0, 30, 61), None, [5.0, 0.0])
    assert np.abs(run.outputs[:, 2]).max() <= 1 + 1e-12 and np.abs(run.states[-1]).max() < 1e-4
    np.testing.assert_allclose(run.outputs[:, 2], -np.clip(run.states.sum(axis=1), -1, 1), atol=1e-12)


def test_unconnected_and_algebraic_loops_are_refused():
    plant = yamada2018_two_inertia()
    with pytest.raises(InputError, match="share no signal"):
        close_loop(plant, damping("linear"))  # its output is T_B, which the plant does not take
    through = PWASystem((Cell([[-1.0]], B=[[1.0]], C=[[1.0]], D=[[1.0]]),), ("x",), ("u",), ("y",))
    gain = PWASystem((Cell(np.zeros((0, 0)), B=np.zeros((0, 1)), C=np.zeros((1, 0)), D=[[-1.0]]),), (),
                     ("y",), ("u",))
    with pytest.raises(InputError, match="algebraic loop"):
        close_loop(through, gain)


def test_zero_order_hold_is_exact_within_a_cell():
    system = two_pieces()
    sampled = discretise(system, 0.1)
    np.testing.assert_allclose(sampled.cells[0].A, expm(np.array([[-0.1]])))
    t = 0.1 * np.arange(20)
    states, _ = sampled.simulate(np.zeros((20, 0)), [-0.8])
    np.testing.assert_allclose(states, system.simulate(t, None, [-0.8]).states, atol=1e-14)


def test_tustin_is_the_bilinear_transfer_function():
    rng = np.random.default_rng(3)
    A, B = -np.eye(3) + 0.3 * rng.standard_normal((3, 3)), rng.standard_normal((3, 1))
    C, D = [[1.0, 2.0, 0.0]], [[0.4]]
    sampled = discretise(PWASystem((Cell(A, B=B, C=C, D=D),)), 0.05, "tustin")
    u = rng.standard_normal((200, 1))
    u[0] = 0.0  # both realisations then start from the same history
    _, y = sampled.simulate(u)
    Ad, Bd, Cd, Dd, _ = cont2discrete((A, B, np.array(C), np.array(D)), 0.05, "bilinear")
    x, expected = np.zeros(3), []
    for value in u:
        expected.append(Cd @ x + Dd @ value)
        x = Ad @ x + Bd @ value
    np.testing.assert_allclose(y, expected, atol=1e-12)


def test_tustin_error_falls_with_the_square_of_the_step():
    system, errors = yamada2018_two_inertia(), []
    for dt in (2e-4, 1e-4):
        t = np.arange(round(0.02 / dt) + 1) * dt
        u = np.zeros((t.size, 2))
        u[:, 0] = 0.01
        states, _ = discretise(system, dt, "tustin").simulate(u, [0.1, 0.05, 0, 0])
        errors.append(np.abs(states[-1] - system.simulate(t, u, [0.1, 0.05, 0, 0]).states[-1]).max())
    assert 3.5 < errors[0] / errors[1] < 4.5


@pytest.mark.parametrize("arguments, message", [
    ((0.0,), "positive sampling time"),
    ((0.1, "euler"), "'zoh' or 'tustin'"),
])  # fmt: skip
def test_bad_sampling_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        discretise(two_pieces(), *arguments)


def test_to_python_control_and_back_gives_the_same_system():
    plant = yamada2018_two_inertia()
    system = to_nlsys(plant)
    assert isinstance(system, control.NonlinearIOSystem) and system.input_labels == ["T_M", "d_L"]
    rebuilt = from_nlsys(system, [(c.G, c.g) for c in plant.cells])
    assert rebuilt.states == plant.states and rebuilt.outputs == plant.outputs
    for one, other in zip(plant.cells, rebuilt.cells, strict=True):
        for key in "AaBGgCcD":
            scale = np.abs(getattr(one, key)).max() + 1
            np.testing.assert_allclose(getattr(other, key), getattr(one, key), atol=1e-7 * scale, err_msg=key)


def test_python_control_simulates_the_same_motion():
    t = np.linspace(0, 0.1, 201)
    u = 0.2 * np.ones((2, t.size)) * [[1.0], [0.0]]
    plant = yamada2018_two_inertia()
    response = control.input_output_response(to_nlsys(plant), t, u,
                                             solve_ivp_kwargs={"rtol": 1e-8, "atol": 1e-10})
    ours = plant.simulate(t, u.T)
    np.testing.assert_allclose(response.outputs.T, ours.outputs, atol=2e-3)


def test_a_law_that_is_not_affine_in_a_cell_is_refused_with_its_size():
    cubic = control.nlsys(lambda t, x, u, p: -(x**3), None, states=1, inputs=1, outputs=1)
    with pytest.raises(InputError, match="cell 0: the system is not affine, off by"):
        from_nlsys(cubic, cells_of_hyperplanes([[1.0]], [0.0]))
    with pytest.raises(InputError, match="continuous-time"):
        from_nlsys(control.nlsys(lambda t, x, u, p: x, None, states=1, inputs=1, outputs=1, dt=0.1), [])


def test_hyperplanes_cut_the_space_into_cells_with_an_interior():
    assert len(cells_of_hyperplanes([[1, 0], [0, 1]], [0, 0])) == 4
    assert len(cells_of_hyperplanes([[1.0], [1.0]], [1.0, -1.0])) == 3
    with pytest.raises(InputError, match="one offset per normal"):
        cells_of_hyperplanes([[1, 0], [0, 1]], [0.0])


def test_phase_portrait_returns_curves_and_field():
    system = PWASystem((Cell([[0, 1], [-1, -0.5]]),), ("x", "v"))
    portrait = phase_portrait(system, ("x", "v"), [[1, 0], [0, 2]], np.linspace(0, 5, 51),
                              bounds=((-2, 2), (-1, 1)), shape=(5, 3))
    assert len(portrait.curves) == 2 and portrait.curves[0].shape == (51, 2)
    assert portrait.field.shape == (3, 5, 2) and (portrait.cells == 0).all()
    np.testing.assert_allclose(portrait.field[2, 4], [1, -2.5])
    with pytest.raises(InputError, match="two of the states"):
        phase_portrait(system, ("x", "w"), [[1, 0]], [0, 1])
