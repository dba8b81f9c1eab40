"""PWA systems: exact flow, located crossings, sliding, Zeno, divergence, and clear errors."""

import dataclasses

import numpy as np
import pytest
from scipy.linalg import expm

from pwaid.dynamics.pwa_simulation import PWAStatus
from pwaid.dynamics.pwa_system import Cell, PWASystem
from pwaid.errors import InputError


def relay_with_drift():
    """ẋ = −sign(x) + u."""
    return PWASystem((Cell([[0.0]], [-1.0], [[1.0]], [[1.0]], [0.0], name="plus"),
                      Cell([[0.0]], [1.0], [[1.0]], [[-1.0]], [0.0], name="minus")))  # fmt: skip


def bilinear_spring(inside=1.0, outside=400.0, width=0.5, damping=0.0):
    """ẍ = −inside·x − outside·(|x| − width)₊ sign(x) − damping·ẋ + u."""

    def cell(k, bias, G, g):
        return Cell([[0, 1], [-k, -damping]], [0, bias], [[0], [1]], G, g)

    k = inside + outside
    return PWASystem((cell(inside, 0, [[-1, 0], [1, 0]], [width, width]),
                      cell(k, outside * width, [[1, 0]], [-width]),
                      cell(k, -outside * width, [[-1, 0]], [-width])),
                     states=("x", "v"), inputs=("u",))  # fmt: skip


def test_one_cell_is_the_matrix_exponential():
    rng = np.random.default_rng(1)
    A, B, a = rng.standard_normal((5, 5)) * 3, rng.standard_normal((5, 2)), rng.standard_normal(5)
    system = PWASystem((Cell(A, a, B),))
    t, x0 = np.array([0.0, 0.1, 0.35, 1.7]), rng.standard_normal(5)
    u = rng.standard_normal((4, 2))
    run = system.simulate(t, u, x0, limit=1e30)
    x = x0
    for k in range(3):
        full = np.zeros((6, 6))
        full[:5, :5], full[:5, 5] = A, a + B @ u[k]
        x = (expm(full * (t[k + 1] - t[k])) @ np.append(x, 1.0))[:5]
        np.testing.assert_allclose(run.states[k + 1], x, rtol=1e-11, atol=1e-11 * np.abs(x).max())
    assert run.status is PWAStatus.DONE and len(run.crossings) == 0


def test_energy_is_conserved_through_hundreds_of_crossings():
    run = bilinear_spring().simulate(np.linspace(0, 500, 2001), None, [2.0, 0.0])
    x, v = run.states.T
    energy = 0.5 * v**2 + 0.5 * x**2 + 0.5 * 400 * np.maximum(np.abs(x) - 0.5, 0) ** 2
    assert len(run.crossings) > 1000
    np.testing.assert_allclose(energy, energy[0], rtol=1e-10)
    on_guard = np.abs(np.abs(run.crossings.state[:, 0]) - 0.5)
    assert on_guard.max() < 1e-12


def test_the_motion_depends_neither_on_the_samples_nor_on_the_internal_step():
    system = bilinear_spring(damping=0.1)
    coarse = np.linspace(0, 20, 41)
    fine = np.linspace(0, 20, 4001)
    u = np.sin(coarse)[:, None]
    reference = system.simulate(coarse, u, [1.0, 0.0])
    np.testing.assert_allclose(system.simulate(fine, np.repeat(u, 100, 0)[:4001], [1.0, 0.0]).states[::100],
                               reference.states, atol=1e-11)  # fmt: skip
    for scale in (0.5, 0.23):
        refined = system.simulate(coarse, u, [1.0, 0.0], step_scale=scale)
        np.testing.assert_allclose(refined.states, reference.states, atol=1e-11)
        np.testing.assert_allclose(refined.crossings.time, reference.crossings.time, atol=1e-11)


def test_two_crossings_within_one_step_are_both_seen():
    # a swing of amplitude 1 reaches into a cell above 0.99999, where it stays for 2e-4 s of a step of 0.7 s
    top = Cell([[0, 1], [-1, 0]], [0, -50.0], G=[[1, 0]], g=[-0.99999])
    below = Cell([[0, 1], [-1, 0]], G=[[-1, 0]], g=[0.99999])
    system = PWASystem((below, top))
    run = system.simulate([0.0, 2 * np.pi * 0.99], None, [0.0, 1.0])
    assert len(run.crossings) == 2
    assert run.crossings.time[0] == pytest.approx(np.arcsin(0.99999), abs=1e-12)
    short = run.crossings.time[1] - run.crossings.time[0]
    slope = np.sqrt(1 - 0.99999**2)
    assert short == pytest.approx(2 * slope / 50.99999, rel=1e-4)


@pytest.mark.parametrize("force, cell", [(1.0, 1), (-1.0, 0)])
def test_a_start_on_a_guard_is_decided_by_the_flow_just_after(force, cell):
    system = bilinear_spring(inside=0.0)
    run = system.simulate([0.0, 0.05], [force, force], [0.5, 0.0])
    assert run.cells[0] == cell and len(run.crossings) == 0
    rate = np.sqrt(400.0)
    exact = 0.5 + (1 - np.cos(rate * 0.05)) / 400 if force > 0 else 0.5 - 0.05**2 / 2
    assert run.states[1, 0] == pytest.approx(exact, abs=1e-14)


def test_rest_on_a_guard_stays_at_rest():
    run = bilinear_spring(inside=0.0).simulate([0.0, 1.0, 2.0], None, [0.5, 0.0])
    np.testing.assert_array_equal(run.states, [[0.5, 0.0]] * 3)
    assert run.status is PWAStatus.DONE and len(run.crossings) == 0


def test_sliding_is_reported_and_not_stepped_over():
    run = relay_with_drift().simulate([0, 1, 2, 3], [0.5, 0.5, 2.0, 0.0], [0.3])
    assert run.status is PWAStatus.SLIDING and run.stop_time == pytest.approx(0.6, abs=1e-12)
    assert run.time.size == 1 and "between cells 0 and 1" in run.message
    slide = run.slides[0]
    assert slide.cells == (0, 1) and slide.closing == pytest.approx((0.5, 1.5)) and np.isnan(slide.stop)


def test_filippov_sliding_goes_on_and_ends_where_a_flow_turns_away():
    run = relay_with_drift().simulate([0, 1, 2, 3], [0.5, 0.5, 2.0, 0.0], [0.3], sliding="filippov")
    assert run.status is PWAStatus.DONE
    np.testing.assert_allclose(run.states.ravel(), [0.3, 0.0, 0.0, 1.0], atol=1e-14)
    assert (run.slides[0].start, run.slides[0].stop) == pytest.approx((0.6, 2.0))
    assert run.cells[1] == 2 and run.crossings.guard[-1] == -1


def test_sliding_along_a_line_follows_the_mixture():
    # v_plus = (1, -1), v_minus = (3, 2) on y = 0: share 2/3 of plus, so x' = 5/3
    system = PWASystem((Cell(np.zeros((2, 2)), [1, -1], G=[[0, 1]], g=[0]),
                        Cell(np.zeros((2, 2)), [3, 2], G=[[0, -1]], g=[0])))  # fmt: skip
    run = system.simulate([0.0, 0.5, 1.5], None, [0.0, 0.5], sliding="filippov")
    np.testing.assert_allclose(run.states[-1], [0.5 + 5 / 3, 0.0], atol=1e-14)
    np.testing.assert_allclose(run.outputs, run.states, atol=1e-14)


def test_sliding_that_is_not_affine_is_refused():
    system = PWASystem((Cell([[0, 0], [1, 0]], [1, -1], G=[[0, 1]], g=[0]),
                        Cell([[1, 0], [0, 0]], [0, 2], G=[[0, -1]], g=[0])))
    run = system.simulate([0.0, 3.0], None, [-0.5, 0.2], sliding="filippov")
    assert run.status is PWAStatus.SLIDING and "not affine" in run.message
    assert run.slides[0].cell is None


def test_two_flows_that_part_are_flagged_as_ambiguous():
    part = PWASystem((Cell([[0.0]], [1.0], G=[[1.0]], g=[0]), Cell([[0.0]], [-1.0], G=[[-1.0]], g=[0])))
    onto = PWASystem((Cell([[0.0]], [1.0], G=[[-1.0]], g=[0.0]), Cell([[0.0]], [1.0], G=[[1.0]], g=[0.0])))
    taken = part.simulate([0.0, 0.5], None, [0.0])
    assert taken.states[-1, 0] == pytest.approx(0.5)  # the first cell
    assert not onto.simulate([0.0, 2.0], None, [-1.0]).crossings.ambiguous.any()
    corner = PWASystem((Cell(np.zeros((2, 2)), [1, 0], G=[[-1, 0]], g=[0]),
                        Cell(np.zeros((2, 2)), [1, 1], G=[[1, 0], [0, 1]], g=[0, 0]),
                        Cell(np.zeros((2, 2)), [1, -1], G=[[1, 0], [0, -1]], g=[0, 0])))  # fmt: skip
    run = corner.simulate([0.0, 2.0], None, [-1.0, 0.0])
    np.testing.assert_array_equal(run.crossings.ambiguous, [True])


def nested_relays():
    """Two relays that turn round each other: a classic with infinitely many crossings in a finite time."""
    cells = [Cell(np.zeros((2, 2)), [-s + 2 * r, -2 * s - r], G=[[s, 0], [0, r]], g=[0, 0])
             for s in (1, -1) for r in (1, -1)]
    return PWASystem(tuple(cells))


def test_zeno_is_detected_at_its_accumulation_point():
    run = nested_relays().simulate(np.linspace(0, 5, 50), None, [1.0, 0.3])
    assert run.status is PWAStatus.ZENO and "accumulate" in run.message
    # |x| + |y| falls at the rate 2 in every quadrant, so everything ends at (1 + 0.3) / 2
    assert run.stop_time == pytest.approx(0.65, abs=1e-7)
    assert np.abs(run.stop_state).max() < 1e-6 and run.time[-1] < run.stop_time


def test_divergence_is_detected_before_overflow():
    run = PWASystem((Cell([[50.0]]),)).simulate(np.linspace(0, 100, 1001), None, [1.0])
    assert run.status is PWAStatus.DIVERGED and np.isfinite(run.states).all()
    assert run.stop_time == pytest.approx(np.log(1e9) / 50, abs=0.05)


def test_leaving_the_partition_is_reported():
    run = PWASystem((Cell([[0.0]], [1.0], G=[[-1.0]], g=[1.0]),)).simulate([0.0, 2.0], None, [0.0])
    assert run.status is PWAStatus.OUTSIDE and run.stop_time == pytest.approx(1.0)


def test_a_full_buffer_is_reported():
    run = bilinear_spring().simulate([0, 100.0], None, [2.0, 0.0], max_events=10)
    assert run.status is PWAStatus.TOO_MANY_EVENTS and len(run.crossings) == 10


def test_cells_are_read_only_and_replace_copies():
    cell = Cell([[1.0]], name="one")
    with pytest.raises(ValueError, match="read-only"):
        cell.A[0, 0] = 2.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        cell.name = "two"
    run = PWASystem((cell,)).simulate([0.0, 1.0], None, [1.0])
    for array in (run.states, run.outputs, run.crossings.time):
        assert not array.flags.writeable
    again = PWASystem((cell,)).simulate(run.time, run.inputs, run.states[0])
    np.testing.assert_array_equal(again.states, run.states)
    assert cell.replace(name="two").name == "two" and cell.name == "one"


@pytest.mark.parametrize("make, message", [
    (lambda: Cell([[1.0, 2.0]]), "square matrix"),
    (lambda: Cell([[np.nan]]), "NaN or infinity"),
    (lambda: Cell([[1.0]], [1.0, 2.0]), r"expected \(1\)"),
    (lambda: Cell([[1.0]], G=[[1.0]]), "without g"),
    (lambda: PWASystem(()), "without cells"),
    (lambda: PWASystem((Cell([[1.0]]), Cell(np.eye(2)))), "the same sizes"),
    (lambda: PWASystem((Cell([[1.0]]),), states=("a", "b")), "expected 1 different names"),
    (lambda: relay_with_drift().simulate([0.0]), "at least two"),
    (lambda: relay_with_drift().simulate([0.0, 0.0]), "strictly increasing"),
    (lambda: relay_with_drift().simulate([0, 1], [[1, 2], [3, 4]]), r"expected \(2, 1\)"),
    (lambda: relay_with_drift().simulate([0, 1], [np.nan, 0]), "must be finite"),
    (lambda: relay_with_drift().simulate([0, 1], x0=[1, 2]), "one value per state"),
    (lambda: relay_with_drift().simulate([0, 1], sliding="on"), "'stop' or 'filippov'"),
    (lambda: PWASystem((Cell([[1.0]], G=[[1.0]], g=[0.0]),)).velocity([-1.0]), "lies in no cell"),
])  # fmt: skip
def test_bad_input_gets_one_clear_error(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_the_last_sample_sees_its_own_input():
    """Two cells that the input switches: a sample does not depend on whether another one follows."""
    cells = [Cell(A=[[-1.0]], a=[0.0], B=[[0.0]], C=[[0.0]], c=[out], G=[[0.0]], H=[[sign]], g=[-0.5 * sign])
             for out, sign in ((10.0, -1.0), (0.0, 1.0))]
    system = PWASystem(cells)
    short = system.simulate([0.0, 1.0, 2.0], [0.0, 0.0, 1.0], [0.3])
    long = system.simulate([0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 1.0, 1.0], [0.3])
    np.testing.assert_allclose(short.outputs, long.outputs[:3])
    assert short.cells[-1] != short.cells[0]
