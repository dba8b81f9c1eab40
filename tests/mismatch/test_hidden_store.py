"""A thermal mass that the simulator does not know begins at a temperature of its own in every recording."""

from __future__ import annotations

import control
import numpy as np
import pytest

from pwaid.mismatch.decide import decide
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import collect
from pwaid.recording import Recording

CAPACITY, LOSS, HIDDEN, COUPLING = 800.0, 4.0, 900.0, 6.0


def plate(t, x, u, params):
    return [(u[0] - params["loss"] * (x[0] - 20.0)) / params["capacity"]]


def recording(seed: int, hidden: float, inside: float = 0.0) -> Recording:
    """A heated plate with a mass hung on it, which begins `hidden` kelvin above it; the share `inside` of the heat goes
    into that mass."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.0, 400.0, 20), 60)
    x, y, h = np.array([60.0, 60.0 + hidden]), np.empty((u.size, 1)), 0.25
    for k in range(u.size):
        y[k] = x[0]
        for _ in range(8):
            flow = COUPLING * (x[0] - x[1])
            x = x + h * np.array([((1.0 - inside) * u[k] - LOSS * (x[0] - 20.0) - flow) / CAPACITY,
                                  (inside * u[k] + flow) / HIDDEN])
    y += 0.05 * rng.normal(size=y.shape)
    return Recording(2.0 * np.arange(u.size), u[:, None], y, ("heater",), ("T",), {"heater": "W", "T": "degC"},
                     name=f"r{seed}.csv")


def simulator():
    return control.nlsys(plate, lambda t, x, u, params: x, inputs=["heater"], outputs=["T"], states=["T"],
                         params={"capacity": 900.0, "loss": 3.6})


def test_its_start_is_fitted_in_every_recording():
    runs = [recording(1, 0.0), recording(2, -8.0), recording(3, 12.0)]
    effects = [e for i in ("second_thermal_mass", "input_delay", "radiation") for e in effect_by_id(i)]
    found = collect(simulator(), runs[:2], runs[2:], ["capacity", "loss"], effects=effects)
    decision = decide(found.problem, found.null, found.singles, found.pairs)
    assert (decision.verdict, decision.chosen.ids) == ("named", ("second_thermal_mass",))
    assert decision.chosen.values()[0] == pytest.approx([COUPLING / CAPACITY, HIDDEN / COUPLING], rel=0.05)
    first, second = decision.chosen.fit.X0
    assert [first[1] - first[0], second[1] - second[0]] == pytest.approx([0.0, -8.0], abs=0.5)
    assert np.diff(decision.chosen.test.X0[0]) == pytest.approx(12.0, abs=0.5)
    assert decision.chosen.test_error < 1.1 * found.problem.floor.level[0] ** 2 / found.problem.sigma[0] ** 2


def test_the_heat_may_go_into_the_mass_that_nothing_measures():
    runs = [recording(1, 0.0, 1.0), recording(2, 20.0, 1.0), recording(3, 35.0, 1.0)]
    effects = [e for i in ("second_thermal_mass", "actuator_lag", "input_delay", "sensor_lag") for e in effect_by_id(i)]
    plant = simulator()
    plant.params["capacity"] = CAPACITY  # with it free, only the product of conductance and capacity would be known
    found = collect(plant, runs[:2], runs[2:], ["loss"], effects=effects)
    decision = decide(found.problem, found.null, found.singles, found.pairs)
    assert (decision.verdict, decision.chosen.ids) == ("named", ("second_thermal_mass",))
    assert decision.chosen.located[0].place.channel == "input:heater"
    assert decision.chosen.values()[0] == pytest.approx([COUPLING, HIDDEN / COUPLING], rel=0.05)
    assert np.diff(decision.chosen.test.X0[0]) == pytest.approx(35.0, abs=0.5)


def test_a_lag_of_the_heater_is_not_taken_for_a_second_mass():
    def lagging(seed):
        whole = recording(seed, 0.0)
        rng, u, T, y = np.random.default_rng(seed + 10), whole.inputs[:, 0], 60.0, []
        w = u[0]
        for k in range(u.size):
            y.append(T)
            for _ in range(8):
                w += 0.25 * (u[k] - w) / 30.0
                T += 0.25 * (w - LOSS * (T - 20.0)) / CAPACITY
        return whole.replace(outputs=np.array(y)[:, None] + 0.05 * rng.normal(size=(u.size, 1)))

    effects = [e for i in ("second_thermal_mass", "actuator_lag") for e in effect_by_id(i)]
    found = collect(simulator(), [lagging(1), lagging(2)], [lagging(3)], ["capacity", "loss"], effects=effects)
    decision = decide(found.problem, found.null, found.singles, found.pairs)
    assert (decision.verdict, decision.chosen.ids) == ("named", ("actuator_lag",))
