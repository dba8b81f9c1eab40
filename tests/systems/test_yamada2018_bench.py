"""The simulated bench: exact plant, sampled controllers, sensors, dry friction, and the gap."""

import json
import time

import numpy as np
import pytest

from pwaid.dynamics.dry_friction import DryFriction
from pwaid.dynamics.pwa_discrete import discretise
from pwaid.errors import InputError
from pwaid.systems.yamada2018 import (
    TwoInertia,
    closed_loop,
    damping,
    pd_gains,
    position_loop,
    yamada2018_two_inertia,
)
from pwaid.systems.yamada2018_bench import Bench, LoopController, half_gap, slow_sine, step_reference
from pwaid.systems.yamada2018_loop import nominal_simulator, run_loop

IDEAL = Bench(encoder_bits=None)
REFERENCE = step_reference(0.6)


@pytest.mark.parametrize("kind", ["none", "linear", "switched"])
def test_without_friction_the_plant_is_the_pwa_system(kind):
    run = IDEAL.closed_loop(REFERENCE, LoopController(kind))
    plant = yamada2018_two_inertia()
    u = np.column_stack([run.T_M, np.zeros(run.time.size)])
    other = plant.simulate(run.time, u)
    y = dict(zip(plant.outputs, other.outputs.T, strict=True))
    for k, name in enumerate(("theta_M", "omega_M", "theta_L", "omega_L")):
        np.testing.assert_allclose(run.states[:, k], y[name], atol=1e-9)
    np.testing.assert_allclose(run.joint_torque, y["T_s"], atol=1e-8)


def test_the_sampled_controller_is_tustins():
    rng = np.random.default_rng(0)
    controller = LoopController("none")
    reference, theta_L = rng.standard_normal(300), rng.standard_normal(300)
    reference[0] = theta_L[0] = 0.0
    state, torque = controller.start(), []
    for r, y in zip(reference, theta_L, strict=True):
        state, T = controller.step(state, r, 0.0, y)
        torque.append(T)
    sampled = discretise(position_loop(pd_gains(), damping("none")), 1 / 2500, "tustin")
    _, outputs = sampled.simulate(np.column_stack([reference, theta_L, np.zeros((300, 2))]))
    np.testing.assert_allclose(torque, outputs[:, 0], rtol=1e-9, atol=1e-9)


def test_fast_sampling_approaches_the_continuous_loop():
    errors = []
    for rate in (10_000.0, 40_000.0):
        bench, controller = Bench(encoder_bits=None, rate=rate), LoopController("none", rate=rate)
        run = bench.closed_loop(step_reference(0.12, rate), controller)
        t = run.time
        other = closed_loop("none").simulate(t, np.column_stack([run.reference, 0 * t]))
        errors.append(np.abs(run.states[:, 2] - other.states[:, 2]).max())
    assert errors[1] < 0.3 * errors[0] and errors[1] < 2e-4


def test_motor_friction_lowers_the_overshoot_and_ends_the_limit_cycle():
    reference, result = step_reference(2.0), []
    for level in (0.0, 0.08):
        run = Bench(motor_friction=DryFriction(level)).closed_loop(reference, LoopController("none"))
        result.append((1e3 * (run.theta_L.max() - 0.30), 1e3 * np.ptp(run.theta_L[-1000:]),
                       run.at_rest[-1, 0]))
    assert result[0][0] == pytest.approx(18, abs=0.5) and result[0][1] > 8 and not result[0][2]
    assert result[1][0] == pytest.approx(10, abs=0.5) and result[1][1] == 0.0 and result[1][2]


@pytest.mark.parametrize("seed", range(6))
def test_refining_the_step_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    levels = np.sort(rng.uniform(0, [0.1, 0.05], (2, 2)), axis=0).T
    frictions = [DryFriction(*level, rng.uniform(0.02, 0.5), int(rng.integers(1, 3))) for level in levels]
    plant = TwoInertia(beta=7.8e-3 * rng.uniform(0.3, 1.5), K=300 * rng.uniform(0.3, 2))
    bench = Bench(plant, *frictions, encoder_bits=None)
    controller = LoopController(("none", "linear", "switched")[seed % 3])
    runs = [bench.closed_loop(REFERENCE, controller, step_scale=s).states for s in (1, 0.5, 0.2)]
    for other in runs[1:]:
        np.testing.assert_allclose(other, runs[0], atol=1e-9)


def test_oversampling_shows_the_same_motion():
    run, fine = (Bench(motor_friction=DryFriction(0.03, 0.05, 0.2)).closed_loop(REFERENCE, oversample=k)
                 for k in (1, 4))
    np.testing.assert_allclose(fine.states[::4], run.states, atol=1e-9)
    assert fine.time[1] == pytest.approx(1e-4) and fine.time.size == 4 * run.time.size


def test_standstill_is_exact_and_slip_obeys_the_law():
    friction = DryFriction(0.05, 0.08, 0.2)
    bench = Bench(motor_friction=friction, encoder_bits=None)
    run = bench.closed_loop(step_reference(1.0), LoopController("none"), oversample=40)
    rest = run.at_rest[:, 0]
    assert rest.any() and (run.states[rest, 1] == 0).all()
    p = TwoInertia()
    assert np.abs(run.T_M - run.joint_torque)[rest].max() <= friction.static + 1e-9
    slip = ~rest & (np.abs(run.states[:, 1]) > 0.5)
    smooth = slip[1:-1] & (run.contact[2:] == run.contact[:-2]) & (run.T_M[2:] == run.T_M[:-2])
    rate = (run.states[2:, 1] - run.states[:-2, 1])[smooth] / (2 * (run.time[1] - run.time[0]))
    losses = p.D_M * run.states[:, 1] + friction.torque(run.states[:, 1])
    balance = (run.T_M - run.joint_torque - losses) / p.J_M
    np.testing.assert_allclose(rate, balance[1:-1][smooth], atol=1e-3 * np.abs(rate).max())


def test_encoders_round_down_to_twenty_bits():
    bench = Bench(torque_noise=0.01)
    run = bench.closed_loop(REFERENCE, rng=1)
    assert bench.quantum == 2 * np.pi / 2**20
    counts = run.theta_M / bench.quantum
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    low = run.states[:, 0] - run.theta_M
    assert low.min() >= 0 and low.max() <= bench.quantum
    assert np.std(run.T_s - run.joint_torque) == pytest.approx(0.01, rel=0.1)
    again = bench.closed_loop(REFERENCE, rng=1)
    np.testing.assert_array_equal(again.T_s, run.T_s)


def test_the_slow_sine_shows_the_half_gap():
    run = slow_sine()
    assert half_gap(run.theta_M, run.theta_L) == pytest.approx(7.80e-3, rel=0.005)
    assert half_gap(run.theta_M, run.theta_L, run.T_s) == pytest.approx(7.80e-3, rel=0.001)
    wide = slow_sine(Bench(TwoInertia(beta=5e-3), DryFriction(0.01), DryFriction(0.01)), amplitude=0.1)
    assert half_gap(wide.theta_M, wide.theta_L, wide.T_s) == pytest.approx(5.0e-3, rel=0.005)
    with pytest.raises(InputError, match="two plateaus"):
        half_gap(np.zeros(100), np.zeros(100))
    with pytest.raises(InputError, match="at least 10 samples"):
        half_gap([0.0], [0.0])


def test_any_plant_can_stand_in_the_loop():
    run = IDEAL.closed_loop(REFERENCE[:400], LoopController("linear"))
    system = nominal_simulator()
    assert system.input_labels == ["T_M"] and system.output_labels == ["theta_M", "theta_L", "T_s"]
    _t, T_M, y = run_loop(system, LoopController("linear"), REFERENCE[:400], substeps=40)
    np.testing.assert_allclose(y[:, 1], run.theta_L, atol=1e-4)
    np.testing.assert_allclose(T_M, run.T_M, atol=2e-2)

    def rhs(t, x, u):
        return system.dynamics(t, x, u, {})

    def output(t, x, u):
        return system.output(t, x, u, {})

    _, same, _ = run_loop((rhs, output), LoopController("linear"), REFERENCE[:100], np.zeros(4))
    _, named, _ = run_loop(system, LoopController("linear"), REFERENCE[:100])
    np.testing.assert_array_equal(same, named)
    _, stiffer, _ = run_loop(system, LoopController("linear"), REFERENCE[:100], params={"K": 600.0})
    assert np.abs(stiffer - named).max() > 1e-3
    with pytest.raises(InputError, match="needs x0"):
        run_loop((rhs, output), LoopController(), REFERENCE)


def test_recordings_are_read_only_and_can_be_fed_back():
    run = IDEAL.closed_loop(REFERENCE[:200], LoopController("none"))
    with pytest.raises(ValueError, match="read-only"):
        run.T_M[0] = 1.0
    again = IDEAL.open_loop(run.T_M)
    np.testing.assert_allclose(again.states, run.states, atol=1e-12)


def test_description_is_plain_and_complete():
    run = Bench(motor_friction=DryFriction(0.08)).closed_loop(REFERENCE[:50])
    told = json.loads(json.dumps(run.description))
    assert told["parameters"]["K"] == 300.0 and told["motor_friction"]["coulomb"] == 0.08
    assert set(run.columns()) == set(told["units"]) and told["controller"]["kind"] == "switched"


def test_one_second_takes_well_under_a_second():
    bench, reference = Bench(motor_friction=DryFriction(0.03, 0.06, 0.1)), step_reference(1.0)
    bench.closed_loop(reference[:10])
    taken = []
    for _ in range(5):
        start = time.perf_counter()
        bench.closed_loop(reference)
        taken.append(time.perf_counter() - start)
    assert min(taken) < 0.3


@pytest.mark.parametrize("make, message", [
    (lambda: LoopController("odd"), "expected one of"),
    (lambda: LoopController(rate=0.0), "must be positive"),
    (lambda: Bench(encoder_bits=0), "1 to 40"),
    (lambda: Bench(torque_noise=-1.0), "expected >= 0"),
    (lambda: Bench().closed_loop(REFERENCE, LoopController(rate=1000.0)), "both the same rate"),
    (lambda: Bench().closed_loop([0.0, np.nan]), "finite values"),
    (lambda: Bench().open_loop([0.0, 1.0], x0=[0, 0]), "4 finite states"),
    (lambda: Bench().closed_loop(REFERENCE, LoopController("linear", gain=50.0)), "diverged"),
    (lambda: run_loop(nominal_simulator(), LoopController(), [[1.0]]), "one per control sample"),
])  # fmt: skip
def test_bad_input_gets_one_clear_error(make, message):
    with pytest.raises(InputError, match=message):
        make()
