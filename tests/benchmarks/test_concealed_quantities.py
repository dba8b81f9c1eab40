"""The key's numbers in the catalogue's words: names agree with `pwaid effects`, and both laws give the same force."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "benchmarks"))

from concealed import vector
from concealed.catalogue import FAMILY, IDS
from concealed.drawn import Scene
from concealed.effects import draw
from concealed.integrate import N_STATES, rates
from concealed.plants import PLANTS
from concealed.quantities import _DERIVED, compare, expected

from pwaid import cli
from pwaid.mismatch.effects import friction, position, stores, time_effects, transmission

DERIVED_NAMES = {"difference", "outlet", "level"}


def drawn(effect, plant=None):
    """One draw of an effect at typical sizes: the draw, its key truth, the key entry, the plant's parameters."""
    plant = PLANTS[plant] if plant else next(p for p in PLANTS.values() if effect in p.effects)
    p = np.array([q.typical for q in plant.params])
    two = np.array([1.0, 1.0])
    scene = Scene(plant=plant, p=p, force=0.5, q_rms=0.6, q_max=1.7, v_rms=2.0, u_rms=0.5, u_mean=0.1, u_max=1.2,
                  slope=3.0, y_std=two, y_mean=0.0 * two, y_max=2.0 * two, x_max=90.0 * np.ones(4),
                  x_mean=40.0 * np.ones(4), seconds=20.0, measured=next(iter(plant.measured.values())))
    d = draw(effect, scene, np.random.default_rng(7))
    truth = {"id": effect, "equivalents": [],
             "parameters": {k: {"value": float(v), "unit": u} for k, (v, u) in d.parameters.items()}}
    entry = {"plant": plant.name, "parameters_true": {q.name: float(v) for q, v in zip(plant.params, p, strict=True)}}
    return d, truth, entry, p, plant


@pytest.fixture(scope="module")
def catalogue():
    """{id: names} as the command `pwaid effects` prints them."""
    import contextlib
    import io

    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        assert cli.main(["effects"]) in (0, None)
    names, current = {}, ""
    for line in text.getvalue().splitlines():
        if not line.startswith(" "):
            current = line.split()[0]
            names[current] = set()
        elif line.strip().startswith("parameters:"):
            names[current] = set(line.split(":")[1].replace(",", " ").split())
    return names


@pytest.mark.parametrize("effect", IDS)
def test_the_names_are_those_that_the_command_effects_prints(effect, catalogue):
    assert set(FAMILY) <= set(catalogue)
    _, truth, entry, *_ = drawn(effect)
    names = set(expected(truth, entry))
    known = catalogue[effect] | (DERIVED_NAMES if effect in _DERIVED else set())
    assert names <= known
    assert names or effect == "sensor_rectification"
    assert all(np.isfinite(v) for v in expected(truth, entry).values())


@pytest.mark.parametrize("effect", sorted(set(IDS) - set(_DERIVED)))
def test_a_report_with_the_true_numbers_has_no_error(effect):
    _, truth, entry, *_ = drawn(effect)
    numbers = {n: {"value": v, "low": v - abs(v), "high": v + abs(v)} for n, v in expected(truth, entry).items()}
    found = compare(truth, entry, {"effects": [{"id": effect, "law": "y^3", "parameters": numbers}]})
    assert not found.unmatched
    assert all(e == pytest.approx(0.0, abs=1e-12) for e in found.errors.values())
    assert all(found.covered.values())


def truth_rates(plant, p, e, x):
    """Rates of the truth in the state x (hidden states included), zero input."""
    dx = np.zeros(len(x))
    rates(plant.kind, np.asarray(x, float), np.zeros(len(plant.inputs)), p, e, 0.0, 2, dx)
    return dx


def catalogue_force(kernel, x, ii, q):
    """What a catalogue law adds to a derivative in phase 2, without an inertia."""
    dx = np.zeros(len(x))
    kernel(2, 0.3, 0.0, np.asarray(x, float), np.zeros(len(x)), np.zeros(1), np.ones(1), dx, np.array(ii), np.array(q))
    return dx


def added(effect, name, x):
    """What an effect adds to the rates of the truth, and its numbers in the catalogue's words."""
    d, truth, entry, p, plant = drawn(effect, name)
    x = np.concatenate([x, np.zeros(vector.N_HIDDEN)])
    assert len(x) == N_STATES[plant.kind] + vector.N_HIDDEN
    without = vector.neutral(**plant.switches)
    gain = truth_rates(plant, p, vector.with_values(without, d.slots), x) - truth_rates(plant, p, without, x)
    return gain, expected(truth, entry), p, d, plant


II = [0, 1, 0, -1, 0, -1, -1, -1, -1, -1, 0, 0]


def test_radiation_leak_and_second_store_add_the_same_rate():
    gain, q, *_ = added("radiation", "thermal_plant", [81.0])
    law = catalogue_force(stores.radiation, [81.0], II, [q["coefficient"], q["ambient"], 273.15])
    assert law[0] == pytest.approx(gain[0], rel=1e-9)
    gain, q, *_ = added("leakage", "cascaded_tanks", [0.3, 0.2])
    assert catalogue_force(stores.leak, [0.3, 0.2], II, [q["coefficient"]])[0] == pytest.approx(gain[0], rel=1e-9)
    gain, q, *_ = added("second_thermal_mass", "thermal_plant", [81.0])
    ii = [1, *II[1:]]
    law = catalogue_force(stores.second_mass, [81.0, 0.0], ii, [q["coupling_rate"], q["time_constant"]])
    assert law[0] == pytest.approx(gain[0], rel=1e-9)
    assert law[1] == pytest.approx(gain[1 + vector.SECOND_STORE], rel=1e-9)


def test_a_hydraulic_leak_is_a_rate_of_the_pressure():
    _, truth, entry, p, plant = drawn("leakage", "hydraulic_cylinder")
    x = np.concatenate([[0.0, 0.0, 2e6], np.zeros(vector.N_HIDDEN)])
    tight = p.copy()
    leaky = p.copy()
    tight[5], leaky[5] = 0.0, truth["parameters"]["coefficient"]["value"]
    e = vector.neutral(**plant.switches)
    gain = truth_rates(plant, leaky, e, x) - truth_rates(plant, tight, e, x)
    law = catalogue_force(stores.leak, x[:3], [0, 1, 2, -1, 2, *II[5:]], [expected(truth, entry)["coefficient"]])
    assert law[2] == pytest.approx(gain[2], rel=1e-9)


def test_a_hidden_mode_has_the_same_eigenvalues():
    d, truth, entry, p, plant = drawn("compliance", "mass_spring_damper")
    e = vector.with_values(vector.neutral(**plant.switches), d.slots)
    q = expected(truth, entry)
    true = np.array([truth_rates(plant, p, e, row) for row in np.eye(2 + vector.N_HIDDEN)]).T
    keep = [0, 1, 2 + vector.MODE_POSITION, 2 + vector.MODE_VELOCITY]
    columns = []
    for row in np.eye(4):  # x, v, twist, rate of the twist
        dx = np.array([row[1], (-p[3] * row[0] - p[1] * row[1]) / p[0], 0.0, 0.0])
        transmission.hidden_mode(2, 0.0, 0.0, row, row, np.zeros(1), p, dx, np.array([2, 1, 1, 0, 1, *II[5:]]),
                                 np.array([q["load_share"], q["frequency"], q["damping_ratio"]]))
        columns.append(dx)
    # the twist counts load behind motor: the same system in other coordinates
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(np.array(columns).T)),
                               np.sort_complex(np.linalg.eigvals(true[np.ix_(keep, keep)])), rtol=1e-6)


def test_stribeck_gravity_and_bouc_wen_give_the_same_force():
    d, truth, entry, *_ = drawn("stribeck_friction")
    q = expected(truth, entry)
    v = 0.4
    s = d.slots
    want = s["level_positive"] + s["static_extra"] * math.exp(-(v / s["stribeck_velocity"]) ** 2)
    dx = np.zeros(1)
    friction.stribeck(5, 0.0, 1e-3, np.array([v]), np.array([1.0]), np.zeros(1), np.ones(1), dx, np.array(II),
                      np.array([q["level"], q["excess"], q["stribeck_speed"]]))
    assert -dx[0] == pytest.approx(want, rel=1e-9)
    gain, q, p, d, _ = added("gravity_torque", "rotary_drive", [0.7, 0.2])
    law = catalogue_force(position.gravity, [0.7, 0.2], [0, 1, 1, -1, 1, 0, *II[6:]], [q["torque"], q["phase"], 1.0])
    assert law[1] / p[0] == pytest.approx(gain[1], rel=1e-9)


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_the_bouc_wen_variable_is_scaled_by_its_yield(order):
    d, truth, entry, p, plant = drawn("hysteretic_spring", "mass_spring_damper")
    slots = d.slots | {"bouc_order": order}
    e = vector.with_values(vector.neutral(**plant.switches), slots)
    q = expected(truth, entry)
    for v, z in ((0.3, 0.6), (-0.3, 0.6), (0.3, -0.2)):
        x = np.zeros(2 + vector.N_HIDDEN)
        x[1], x[2 + vector.BOUC] = v, z * slots["bouc_yield"]
        true = truth_rates(plant, p, e, x)
        law = catalogue_force(position.bouc_wen, [0.0, v, z], [2, 1, 1, -1, 1, 0, *II[6:]],
                              [q["force"], q["yield_displacement"], order, 0.5])
        assert true[2 + vector.BOUC] == pytest.approx(law[2] * slots["bouc_yield"], rel=1e-9)
        assert true[1] * p[0] + p[1] * v == pytest.approx(law[1], rel=1e-9)


def test_a_tone_is_two_amplitudes_and_an_angular_frequency():
    d, truth, entry, *_ = drawn("periodic_disturbance")
    q = expected(truth, entry)
    s, t = d.slots, 0.3
    want = s["tone"] * math.sin(2.0 * math.pi * s["tone_frequency"] * t + s["tone_phase"])
    law = catalogue_force(time_effects.periodic, [0.0], II, [q["angular_frequency"], q["amplitude_sin"],
                                                             q["amplitude_cos"]])
    assert law[0] == pytest.approx(want, rel=1e-9)
    got = {n: {"value": v} for n, v in q.items() if n != "level"}
    found = compare(truth, entry, {"effects": [{"id": "periodic_disturbance", "parameters": got}]})
    assert found.errors["periodic_disturbance.level"] == pytest.approx(0.0, abs=1e-12)


def test_numbers_that_are_only_determined_together_are_compared_together():
    _, truth, entry, *_ = drawn("asymmetric_viscous_friction")
    want = expected(truth, entry)["difference"]
    got = {"coefficient_positive": {"value": 5.0 + 1.1 * want}, "coefficient_negative": {"value": 5.0}}
    found = compare(truth, entry, {"effects": [{"id": "asymmetric_viscous_friction", "parameters": got}]})
    assert found.errors == {"asymmetric_viscous_friction.difference": pytest.approx(0.1)}
    _, truth, entry, *_ = drawn("square_root_outflow", "single_tank")
    c = truth["parameters"]["coefficient"]["value"]
    answer = {"effects": [{"id": "square_root_outflow", "where": {"signal": "h"},
                           "parameters": {"reference": {"value": 0.25}}}],
              "parameters": {"c": {"refitted": 2.0 * c * 1.03}}}
    found = compare(truth, entry, answer)
    assert found.errors == {"square_root_outflow.outlet": pytest.approx(0.03)}


def test_a_stop_seen_from_below_counts_with_its_distance_and_its_interval():
    _, truth, entry, *_ = drawn("end_stop")
    place = truth["parameters"]["position"]["value"]
    got = {"position": {"value": -place, "low": -1.1 * place, "high": -0.9 * place}}
    found = compare(truth, entry, {"effects": [{"id": "end_stop", "parameters": got}]})
    assert found.errors["end_stop.position"] == pytest.approx(0.0)
    assert found.covered["end_stop.position"]
    assert set(found.unmatched) == {"end_stop.stiffness", "end_stop.damping"}


def test_a_load_is_compared_in_the_unit_in_which_it_is_reported():
    truth = {"id": "constant_load", "equivalents": [],
             "parameters": {"level": {"value": 70.0, "unit": "N", "also": [{"value": 2.0, "unit": "V"}]}}}
    entry = {"plant": "linear_drive", "parameters_true": {}}
    for value, unit in ((70.0, "N"), (2.0, "V")):
        got = {"effects": [{"id": "constant_load", "parameters": {"level": {"value": value, "unit": unit}}}]}
        assert compare(truth, entry, got).errors["constant_load.level"] == pytest.approx(0.0)
    truth = {"id": "load_dependent_friction", "equivalents": [],
             "parameters": {"factor": {"value": 0.2, "unit": "-", "also": [{"value": 7.0, "unit": "N/V"}]}}}
    for value, unit in ((0.2, "1"), (7.0, "N/V")):
        got = {"effects": [{"id": truth["id"], "parameters": {"load_factor": {"value": value, "unit": unit}}}]}
        assert compare(truth, entry, got).errors["load_dependent_friction.load_factor"] == pytest.approx(0.0)
