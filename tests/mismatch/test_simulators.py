"""Every kind of control system is taken: transfer functions, static gains, discrete and MIMO systems."""

from __future__ import annotations

import control
import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.mismatch import explain
from pwaid.mismatch.built import with_arguments
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.model import Model, Settings
from pwaid.mismatch.plant import as_plant
from pwaid.recording import Recording

DT = 0.05
FIRST = control.tf([1.0], [0.2, 1.0])
MATRIX = control.tf([[[1.0], [0.5]], [[0.2], [1.0]]], [[[0.2, 1.0], [0.3, 1.0]], [[0.4, 1.0], [0.1, 1.0]]])


def recording(seed, n_inputs, n_outputs, respond=None, samples=120):
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * DT
    U = np.stack([np.sin(2 * np.pi * np.outer(t, rng.uniform(0.1, 1.5, 6)) + rng.uniform(0, 6, 6)).sum(axis=1)
                  for _ in range(n_inputs)], axis=1)
    Y = np.zeros((samples, n_outputs)) if respond is None else respond(U)
    return Recording(t, U, Y + 1e-3 * rng.standard_normal(Y.shape), name=f"s{seed}")


def dead(u):
    return np.sign(u) * np.maximum(np.abs(u) - 0.3, 0.0)


@pytest.mark.parametrize("system", [
    FIRST, control.ss(FIRST), control.sample_system(FIRST, DT), control.ss([], [], [], [[2.0]]),
    control.tf([2.0], [1.0]), control.ss([], [], [], [[2.0, 0.5], [0.0, 1.0]], DT), MATRIX,
    control.tf([1.0], [1.0, 0.0, 0.0, 0.0], DT),
], ids=["tf", "ss", "discrete", "gain", "gain tf", "MIMO gain", "MIMO tf", "delay"])
def test_the_simulation_is_that_of_the_control_package(system):
    plant = as_plant(system)
    nx, nu, ny = plant.sizes
    rec = recording(1, nu, ny)
    data = Dataset.from_recordings([rec])
    model = Model(Settings(plant, np.full(nx, -1), np.zeros(nx), (), np.zeros(0), substeps=8))
    Y, _ = model.simulate(np.zeros(0), np.zeros((1, nx)), data)
    want = np.zeros_like(Y)
    entries = [(i, j, control.ss(system[i, j] if (nu, ny) != (1, 1) else system)) for i in range(ny) for j in range(nu)]
    for i, j, e in entries:  # every entry sampled with held inputs, stepped by hand
        e = e if plant.dt or not e.nstates else control.sample_system(e, DT)
        x = np.zeros(e.nstates)
        for k, u in enumerate(rec.inputs[:, j]):
            want[k, i] += float(e.C[0] @ x + e.D[0, 0] * u)
            x = e.A @ x + e.B[:, 0] * u
    np.testing.assert_allclose(Y, want, atol=1e-6)


def static(t, x, u, params):
    return np.array([params["gain"] * u[0] + 0.1 * u[0] ** 3])


@pytest.mark.filterwarnings("ignore::pwaid.mismatch.access.SlowSimulationWarning")  # said on a busy machine
@pytest.mark.parametrize("system", [control.ss([], [], [], [[2.0]]),
                                    control.nlsys(None, static, inputs=1, outputs=1, params={"gain": 2.0})],
                         ids=["matrices", "function"])
def test_a_simulator_without_states_is_explained(system):
    def respond(u):
        return 2.0 * dead(u) + (0.0 if isinstance(system, control.StateSpace) else 0.1 * dead(u) ** 3)

    recs = [recording(s, 1, 1, respond) for s in (1, 2, 3)]
    report = explain(system, recs[:2], recs[2:],
                     effects=effect_by_id("actuator_deadzone") + effect_by_id("constant_load"))
    assert [e["id"] for e in report.effects] == ["actuator_deadzone"]
    assert report.effects[0]["parameters"]["half_width"]["value"] == pytest.approx(0.3, rel=0.02)


def test_a_law_without_parameters_is_named_where_nothing_else_may_change():
    system = control.sample_system(control.ss(FIRST), DT)

    def respond(u):
        return np.abs(control.forced_response(system, U=u.T).outputs.reshape(-1, 1))

    recs = [recording(s, 1, 1, respond) for s in (1, 2, 3)]
    report = explain(system, recs[:2], recs[2:], free_parameters=[], effects=effect_by_id("sensor_rectification"))
    assert [e["id"] for e in report.effects] == ["sensor_rectification"]


@pytest.mark.parametrize(("system", "message"), [
    (control.tf([1.0, 1.0, 0.0], [0.2, 1.0]), "no state space"),
    (control.frd([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]), "fit a model to frequency data first"),
    (control.tf([1.0], [1.0, -0.5], True), "unspecified step"),
])
def test_what_cannot_be_simulated_gets_one_line(system, message):
    with pytest.raises(InputError, match=message):
        as_plant(system)


def test_texts_and_arrays_in_params_are_kept():
    def update(t, x, u, params):
        force = np.interp(x[0], params["place"], params["force"])
        return np.array([u[0] - force if params["mode"] == "on" else 0.0])

    plant = as_plant(control.nlsys(update, None, inputs=1, states=1, params={
        "place": np.array([-1.0, 1.0]), "force": np.array([-2.0, 3.0]), "mode": "on", "spare": 1.0}))
    assert list(plant.parameters) == ["spare"] and plant.rhs is not None
    assert plant.derivative([0.5], [1.0])[0] == pytest.approx(1.0 - 1.75)
    assert sum("kept as it is" in n for n in plant.notes) == 3


def test_whole_numbers_that_count_something_are_kept():
    def update(t, x, u, params):
        return [u[0] - params["k"] * sum(x[0] ** i for i in range(1, params["order"]))]

    plant = as_plant(control.nlsys(update, lambda t, x, u, params: x, inputs=["u"], outputs=["x"], states=["x"],
                                   params={"order": 4, "k": 3}))
    assert dict(plant.parameters) == {"k": 3.0} and plant.constants == {"order": 4}

    def build(n=2, k=3.0):
        A = np.diag(np.full(n - 1, 1.0), 1) - k * np.eye(n)
        return control.ss(A, np.ones((n, 1)), np.ones((1, n)), 0, inputs=["u"], outputs=["y"])

    plant = with_arguments(as_plant(build()), build, ["k"])
    assert dict(plant.parameters) == {"k": 3.0} and plant.sizes == (2, 1, 1)


def test_the_sampling_time_that_build_takes_is_no_parameter():
    def build(k=2.0, dt=DT):
        def update(t, x, u, params):
            level, h = float(x[0]), dt / 2
            for _ in range(2):
                level += h * (u[0] - k * level)
            return [level]

        return control.nlsys(update, lambda t, x, u, params: x, inputs=["u"], outputs=["x"], states=["x"], dt=dt)

    plant = with_arguments(as_plant(build()), build, ["k"])
    assert dict(plant.parameters) == {"k": 2.0} and plant.rhs is not None


def test_a_simulator_that_divides_by_a_flow_is_taken():
    """No flow, no answer: a heat exchanger's derivatives are not finite at inputs of zero."""
    def warmed(t, x, u, params):
        flow, inlet = u
        k = params["k"] * (flow / 0.3) ** 0.4 / (0.5 * (flow / 0.3) ** 0.4 + 0.5)
        return np.array([(flow * (inlet - x[0]) - k * x[0] / flow * flow**0.5) / params["m"]])

    system = control.nlsys(warmed, None, inputs=["w", "T_in"], states=["T"], params={"k": 0.2, "m": 1.5})
    assert as_plant(system).rhs is not None
    rng, time = np.random.default_rng(0), np.arange(400) * 0.5
    found = []
    for k in range(3):
        U = np.column_stack([0.3 + 0.1 * np.sin(0.3 * time + k), 60 + 10 * np.sin(0.17 * time + 2 * k)])
        Y = control.input_output_response(system, time, U.T, [20.0]).outputs.reshape(-1, 1)
        found.append(Recording(time, U, Y + 0.05 * rng.standard_normal(Y.shape), ("w", "T_in"), ("T",), name=f"{k}"))
    report = explain(system, found[:2], found[2:], free_parameters=["k", "m"],
                     effects=effect_by_id("sensor_offset"), hold="first")
    assert report.verdict == "agreement"
