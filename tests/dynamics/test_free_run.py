"""Free-run simulation: against a step-by-step route, outside the mesh, divergence, batches, derivative, speed."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.spatial import Delaunay

from pwaid.delaunay import SimplexMesh
from pwaid.dynamics import free_run
from pwaid.dynamics.narx import NARX
from pwaid.errors import InputError, OutsideMeshError
from pwaid.pwa_map import PWAMap
from pwaid.recording import Recording

THREE = NARX(output_lags=2, input_lags=0, direct=True)


def actuator_map(n_points, rng=0, box=4.0):
    """A stable nonlinear map of (y(k−1), y(k−2), u(k))."""
    mesh = SimplexMesh.uniform([[-box, box]] * 3, n_points, rng)
    p = mesh.points
    return PWAMap(mesh, 1.2 * np.tanh(p[:, 0]) - 0.4 * p[:, 1] + 0.3 * p[:, 2] - 0.1 * np.abs(p[:, 0]))


def inputs(n, rng=1):
    return np.repeat(np.random.default_rng(rng).normal(size=-(-n // 10)), 10)[:n]


def by_find_simplex(pwa, delaunay, u, n):
    """The plain route: SciPy's find_simplex and its barycentric transform at every step."""
    scaling = pwa.mesh.scaling
    y = np.zeros(n)
    for k in range(2, n):
        z = scaling.apply(np.array([[y[k - 1], y[k - 2], u[k]]]))
        s = delaunay.find_simplex(z)[0]
        T = delaunay.transform[s]
        b = T[:-1] @ (z[0] - T[-1])
        y[k] = np.append(b, 1 - b.sum()) @ pwa.values[delaunay.simplices[s]]
    return y


def test_the_trajectory_is_that_of_find_simplex_per_step():
    pwa, u = actuator_map(800), inputs(1500)
    run = THREE.wrap(pwa).free_run(u, np.zeros((2, 1)), outside="raise")
    assert run.n_outside == 0 and run.n_steps == 1498
    slow = by_find_simplex(pwa, Delaunay(pwa.mesh.normalised), u, 1500)
    np.testing.assert_allclose(run.outputs[:, 0], slow, atol=1e-9)


def test_the_trajectory_is_that_of_the_map_with_a_linear_part():
    rng = np.random.default_rng(3)
    mesh = SimplexMesh.uniform([[-9, 9]], 30, 0)
    narx = NARX(1, 1, True, nonlinear=[[1.0, 0.0, 0.0]])
    pwa = PWAMap(mesh, np.tanh(mesh.points[:, 0]))
    theta = np.array([[0.0, 0.5, -0.2]])
    model = narx.wrap(pwa, theta=theta)
    u = rng.normal(size=200)
    y = np.zeros(200)
    for k in range(1, 200):
        y[k] = pwa(np.array([y[k - 1]]))[0] + 0.5 * u[k] - 0.2 * u[k - 1]
    np.testing.assert_allclose(model.free_run(u, [0.0]).outputs[:, 0], y, atol=1e-12)


def test_a_batch_equals_its_members_and_starts_where_it_is_told():
    model = THREE.wrap(actuator_map(200))
    U = np.stack([inputs(300, s) for s in range(4)])[:, :, None]
    starts = np.random.default_rng(0).normal(size=(4, 2, 1))
    runs = model.free_run(U, starts)
    for u, start, run in zip(U, starts, runs, strict=True):
        np.testing.assert_array_equal(run.outputs[:2], start)
        np.testing.assert_array_equal(run.outputs, model.free_run(u, start).outputs)


def test_initial_conditions_come_from_the_recording():
    u = inputs(100)
    r = Recording(np.arange(100.0), u, np.random.default_rng(0).normal(size=100))
    run = THREE.wrap(actuator_map(100)).simulate(r)
    np.testing.assert_array_equal(run.outputs[:2], r.outputs[:2])


# -- outside the mesh ----------------------------------------------------------------------------------------------


def small(slope):
    mesh = SimplexMesh.uniform([[-1, 1], [-1, 1]], 40, 0)
    return mesh, NARX(1, 0, True).wrap(PWAMap(mesh, slope * mesh.points[:, 0] + mesh.points[:, 1]), limit=1e6)


def test_affine_extends_the_nearest_facet_and_counts():
    _, model = small(0.5)
    u = np.full(20, 3.0)
    run = model.free_run(u, [0.0])
    y = np.zeros(20)
    for k in range(1, 20):
        y[k] = 0.5 * y[k - 1] + u[k]
    np.testing.assert_allclose(run.outputs[:, 0], y, atol=1e-9)
    assert run.n_outside == 19 and run.fraction_outside == 1.0 and "19 outside the mesh" in str(run)


def test_affine_agrees_with_the_map_on_a_bent_map():
    mesh = SimplexMesh.uniform([[-1, 1]] * 2, 50, 1)
    pwa = PWAMap(mesh, np.random.default_rng(1).normal(size=50))
    model = NARX(1, 0, True).wrap(pwa)
    for start, u in np.random.default_rng(2).uniform(-3, 3, (40, 2)):
        expected = pwa(np.array([[start, u]]), outside="affine")[0]
        assert model.free_run([0.0, u], [start]).outputs[1, 0] == pytest.approx(expected, abs=1e-9)


def test_clip_stays_in_the_range_of_the_map():
    mesh, model = small(1.5)
    run = model.free_run(np.full(50, 3.0), [0.0], outside="clip")
    assert run.diverged_at is None
    highest = 1.5 * np.abs(mesh.points[:, 0]).max() + np.abs(mesh.points[:, 1]).max()
    assert np.abs(run.outputs).max() <= highest + 1e-12


def test_clip_at_a_point_inside_is_no_change():
    _, model = small(0.5)
    u = np.full(30, 0.2)
    np.testing.assert_array_equal(
        model.free_run(u, [0.0], outside="clip").outputs, model.free_run(u, [0.0], outside="raise").outputs
    )


def test_raise_says_when():
    _, model = small(0.9)
    with pytest.raises(OutsideMeshError, match="left the mesh at sample 3"):
        model.free_run([0.0, 0.9, 0.9, 0.9, 0.9], [0.0], outside="raise")


def test_holes_of_a_clipped_mesh_are_crossed():
    """In a mesh that is not convex a walk may meet a boundary though the goal is inside."""
    P = np.array([(x, y) for x in np.linspace(-1, 1, 9) for y in np.linspace(-1, 1, 9)])
    P += np.random.default_rng(0).normal(0, 0.02, P.shape)
    whole = SimplexMesh.from_points(P)
    centre = whole.points[whole.simplices].mean(axis=1)
    keep = ~((np.abs(centre[:, 0]) < 0.3) & (centre[:, 1] > -0.6))
    mesh = SimplexMesh._assemble(whole.points, whole.simplices[keep], whole.scaling, whole.quality, convex=False)
    pwa = PWAMap(mesh, mesh.points[:, 0] ** 2 + mesh.points[:, 1])
    model = NARX(0, 1, True).wrap(pwa)
    u = np.random.default_rng(1).uniform(-0.9, 0.9, 300)
    run = model.free_run(u, [0.0])
    X = np.column_stack([u[1:], u[:-1]])
    np.testing.assert_allclose(run.outputs[1:, 0], pwa(X, outside="affine"), atol=1e-9)
    assert run.n_outside == np.sum(~mesh.contains(X)) > 0


# -- divergence ----------------------------------------------------------------------------------------------------


def test_divergence_is_reported_and_never_overflows():
    _, model = small(3.0)
    run = model.free_run(np.full(5000, 0.1), [0.1])
    assert run.diverged_at is not None and run.diverged_at < 40
    assert np.isnan(run.outputs[run.diverged_at :]).all()
    assert np.abs(run.outputs[: run.diverged_at]).max() <= 1e6
    assert run.rmse(np.zeros(5000)) == np.inf and "diverged" in str(run)
    unlimited = NARX(1, 0, True).wrap(model.maps[0]).free_run(np.full(5000, 0.1), [0.1])
    assert np.isfinite(unlimited.outputs[: unlimited.diverged_at]).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros((5, 2)), [0.0]), r"inputs have shape \(5, 2\); expected \(N, 1\)"),
        ((np.zeros(5), [0.0, 0.0]), "initial outputs have shape"),
        ((np.zeros(1), [0.0]), "1 input samples came"),
        ((np.array([0.0, np.nan, 0.0]), [0.0]), "inputs has 1 entries that are NaN"),
        ((np.zeros(5), [np.inf]), "initial has 1 entries"),
    ],
)
def test_bad_input_gets_one_clear_error(arguments, message):
    with pytest.raises(InputError, match=message):
        small(0.5)[1].free_run(*arguments)


def test_unknown_rule():
    with pytest.raises(InputError, match="expected one of 'affine', 'clip', 'raise'"):
        small(0.5)[1].free_run(np.zeros(5), [0.0], outside="nan")


# -- derivative ----------------------------------------------------------------------------------------------------


def test_the_derivative_is_that_of_finite_differences():
    rng = np.random.default_rng(5)
    mesh = SimplexMesh.uniform([[-5, 5]], 12, 0)
    select, W = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    x = np.concatenate([0.6 * np.tanh(mesh.points[:, 0]), [0.5, -0.3]])
    u = rng.normal(size=(60, 1))

    def simulate(x):
        t = free_run.tables(mesh, x[:12, None], select, (W @ x[12:])[None])
        y, S = np.zeros((60, 1)), np.zeros((60, 14))
        assert free_run.run_sensitivity(t, y, u, (1, 1, 1), 0, 1e6, W, S)[0] == free_run.COMPLETE
        return y[:, 0], S

    _, S = simulate(x)
    step = 1e-6
    numeric = np.column_stack(
        [(simulate(x + step * e)[0] - simulate(x - step * e)[0]) / (2 * step) for e in np.eye(14)]
    )
    np.testing.assert_allclose(S, numeric, atol=1e-7)


# -- speed ---------------------------------------------------------------------------------------------------------


def test_a_million_steps_a_second_and_fifty_times_find_simplex():
    """d = 3, N̂ = 10 000; both routes in one run of CPU time, at most three runs (other work may disturb one)."""
    pwa = actuator_map(10_000)
    n = 100_000
    u = inputs(n)
    model = THREE.wrap(pwa)
    run = model.free_run(u, np.zeros((2, 1)))
    delaunay = Delaunay(pwa.mesh.normalised)
    delaunay.find_simplex(pwa.mesh.normalised[:1])  # builds its tables once, outside the timing
    _ = delaunay.transform
    for _ in range(3):
        began = time.process_time()
        slow = by_find_simplex(pwa, delaunay, u, 1000)
        per_step = (time.process_time() - began) / 998
        seconds = []
        for _ in range(5):
            began = time.process_time()
            model.free_run(u, np.zeros((2, 1)))
            seconds.append(time.process_time() - began)
        rate = n / min(seconds)
        print(f"{rate:.3g} steps/s, {rate * per_step:.0f} times find_simplex per step")
        if rate >= 1e6 and rate * per_step >= 50:
            break
    np.testing.assert_allclose(run.outputs[:1000, 0], slow, atol=1e-9)
    assert rate >= 1e6
    assert rate * per_step >= 50
