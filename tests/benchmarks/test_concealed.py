"""The sealed cases: exact discontinuities, agreement of integrator and simulator text, determinism,
blindness."""

from __future__ import annotations

import argparse
import importlib.util
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "benchmarks"))

from concealed import case as building
from concealed import classes, clutter, generate, vector, write
from concealed.catalogue import FAMILY, IDS
from concealed.integrate import simulate
from concealed.plants import PLANTS

FOLDER = Path(generate.__file__).parent


def run(plant, p, x0, u, **slots):
    e = vector.with_values(vector.neutral(**plant.switches), slots)
    signal = np.asarray(u, float).reshape(len(u), -1)
    return simulate(plant, p, e, x0, signal, nsub=24, outputs=range(len(plant.states)))[1]


def test_dry_friction_sticks_exactly_below_breakaway():
    drive = PLANTS["rotary_drive"]
    x = run(drive, [0.02, 0.0, 1.0, 0.0, 0.0], (0.3, 0.0), np.full(200, 0.29), level_positive=0.3,
            level_negative=0.3)
    assert np.all(x[:, 1] == 0.0)
    assert np.all(x[:, 0] == 0.3)


def test_sliding_against_dry_friction_follows_the_parabola():
    drive = PLANTS["rotary_drive"]
    x = run(drive, [0.02, 0.0, 1.0, 0.0, 0.0], (0.0, 0.0), np.full(100, 0.5), level_positive=0.3,
            level_negative=0.3)
    t = np.arange(100) * drive.ts
    np.testing.assert_allclose(x[:, 0], 0.5 * (0.5 - 0.3) / 0.02 * t**2, rtol=1e-9, atol=1e-12)


def test_a_spring_with_dry_friction_loses_the_same_amplitude_each_half_swing_and_stops():
    plant = PLANTS["mass_spring_damper"]
    k, level = 150.0, 1.2
    x = run(plant, [1.5, 0.0, 1.0, k, 0.0], (0.1, 0.0), np.zeros(900), level_positive=level,
            level_negative=level)
    turns = x[1:-1, 0][(np.diff(x[:-1, 0]) * np.diff(x[1:, 0])) < 0.0]
    expected = 0.1 - 2.0 * level / k * np.arange(1, len(turns) + 1)
    np.testing.assert_allclose(np.abs(turns), np.abs(expected), atol=6e-4)
    assert np.all(x[-50:, 1] == 0.0)
    assert abs(x[-1, 0]) <= level / k


@pytest.mark.parametrize("slots, change", [
    ({"limit": 0.4}, lambda u: np.clip(u, -0.4, 0.4)),
    ({"half_width": 0.2}, lambda u: np.sign(u) * np.maximum(np.abs(u) - 0.2, 0.0)),
    ({"delay_substeps": 48}, lambda u: np.concatenate([u[:1], u[:1], u[:-2]])),
])
def test_actuator_laws_equal_the_same_law_on_the_held_input(slots, change):
    drive = PLANTS["rotary_drive"]
    p = [q.typical for q in drive.params]
    u = np.sin(np.arange(300) * 0.07)
    np.testing.assert_allclose(run(drive, p, (0, 0), u, **slots), run(drive, p, (0, 0), change(u)),
                               atol=1e-12)


def test_a_slow_ramp_through_a_gap_moves_the_load_only_after_contact():
    plant = PLANTS["two_mass_drive"]
    p = [q.typical for q in plant.params]
    x = run(plant, p, (0, 0, 0, 0), np.full(60, 0.02), half_gap=0.05)
    free = x[:, 0] < 0.05
    assert free.sum() > 10
    assert np.all(x[free, 2] == 0.0)
    assert x[-1, 0] > 0.05


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_simulator_text_and_integrator_agree_when_nothing_is_concealed(name, tmp_path):
    plant = PLANTS[name]
    p = np.array([q.typical for q in plant.params])
    params = {q.name: v for q, v in zip(plant.params, p, strict=True)}
    measured = tuple(range(len(plant.states)))
    (tmp_path / "simulator.py").write_text(plant.source(plant, params, measured, ""), encoding="utf-8")
    spec = importlib.util.spec_from_file_location("nominal", tmp_path / "simulator.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    system = module.build()
    rng = np.random.default_rng(1)
    for _ in range(3):
        x = np.array(plant.x0) + np.array(plant.x0_spread) * rng.uniform(0.2, 1.0, len(plant.x0))
        u = np.array(plant.bias) + np.array(plant.amplitude) * rng.uniform(0.1, 1.0)
        h = plant.ts / 24
        k1 = system.dynamics(0.0, x, u)
        k2 = system.dynamics(0.0, x + 0.5 * h * k1, u)
        k3 = system.dynamics(0.0, x + 0.5 * h * k2, u)
        k4 = system.dynamics(0.0, x + h * k3, u)
        e = vector.neutral(**plant.switches)
        one = simulate(plant, p, e, x, np.array([u, u]), nsub=24, outputs=measured)[1][1]
        for _ in range(24):
            k1 = system.dynamics(0.0, x, u)
            k2 = system.dynamics(0.0, x + 0.5 * h * k1, u)
            k3 = system.dynamics(0.0, x + 0.5 * h * k2, u)
            k4 = system.dynamics(0.0, x + h * k3, u)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        np.testing.assert_allclose(one, x, rtol=1e-6, atol=1e-9)


def test_a_case_depends_on_its_seed_alone_and_its_folder_tells_nothing(tmp_path):
    seed = generate.seed_of("calibration", "rich", "single", 0)
    hashes = set()
    for i in range(2):
        made = classes.generate("single", "rich", 0, seed)
        hashes.add(write.write_case(made, tmp_path / str(i)))
    assert len(hashes) == 1
    text = "".join(f.read_text(encoding="utf-8") for f in (tmp_path / "0").iterdir())
    assert not [i for i in IDS if i in text]
    assert "level_positive" not in text
    key = write.key_entry(made, "single", "rich", seed)
    assert key["effects"][0]["id"] in IDS
    assert key["detectability"][key["effects"][0]["id"]] >= classes.SEEN


def test_a_clean_case_is_explained_by_its_nominal_simulator_to_below_the_noise():
    made = classes.generate("clean", "rich", 1, generate.seed_of("calibration", "rich", "clean", 1))
    assert made.margins["everything"] < 1.2
    assert made.facts["nominal_ratio"] < 1.2
    spread = np.concatenate([r.y - r.free for r in made.recordings]).std(axis=0)
    np.testing.assert_allclose(spread, made.sigma, rtol=0.1)


def test_effects_never_excited_leave_less_than_a_third_of_the_noise():
    made = classes.generate("unexcited", "rich", 0, generate.seed_of("calibration", "rich", "unexcited", 0))
    assert max(made.margins.values()) < 0.3


def test_a_runaway_simulation_is_rejected():
    recipe = building.Recipe("rotary_drive", "multisine", 0.02, effects=(("linear_stiffness", -4000.0),))
    with pytest.raises(building.Rejected, match="range"):
        building.build(recipe, np.random.default_rng(0))


def test_calibration_and_score_seeds_never_meet():
    for which, low, high in (("calibration", 0, 10000), ("score", 10000, 20000)):
        seeds = [j[3] for j in generate.jobs(which, classes.CELLS, classes.CLASSES, {"": 300})]
        assert len(set(seeds)) == len(seeds)
        assert min(seeds) >= low
        assert max(seeds) < high
    with pytest.raises(ValueError, match="at most"):
        generate.seed_of("score", "rich", "single", 5000)


def test_a_composition_may_differ_by_class():
    n = dict(generate.counted(t) for t in ("2", "single=5"))
    made = generate.jobs("calibration", classes.CELLS, ("single", "clean", "concealed_noise"), n)
    counts = {name: sum(j[0] == name for j in made) for name in ("single", "clean", "concealed_noise")}
    assert counts == {"single": 10, "clean": 4, "concealed_noise": 2}
    with pytest.raises(argparse.ArgumentTypeError, match="CLASS=N"):
        generate.counted("nothing=3")


def test_a_closed_loop_has_a_held_command_and_no_repeats():
    order = np.random.default_rng(0).permutation(len(IDS))
    for attempt in range(60):
        rng = np.random.default_rng([1, attempt])
        recipe = classes._recipe("concealed_controller", "rich", attempt, attempt, 1.0, rng, order, 0)
        assert (recipe.excitation, recipe.hold, recipe.repeats) == ("closed_loop", "zero", False)


def test_quantisation_is_an_effect_and_no_disturbance():
    made = classes.generate("single", "rich", 37, generate.seed_of("calibration", "rich", "single", 37))
    assert made.drawn[0].id == "sensor_quantization"
    assert made.facts["disturbance_ratio"] == 0.0


def test_a_drifting_parameter_drifts_alike_in_recordings_of_any_length():
    recipe = building.Recipe("rl_circuit", "multisine", 0.02, effects=(("parameter_drift", 1.0),))
    made = building.build(recipe, np.random.default_rng(0))
    rate = made.drawn[0].parameters["rate"][0]
    assert len({len(r.u) for r in made.recordings}) == 2
    for rec in made.recordings:
        np.testing.assert_allclose(rec.drift[1], 1.0 + rate * made.plant.ts * np.arange(len(rec.u)))


def test_the_generator_never_imports_the_package():
    for path in FOLDER.rglob("*.py"):
        assert not re.search(r"^\s*(from|import) pwaid", path.read_text(encoding="utf-8"),
                             re.MULTILINE), path.name


def test_every_effect_has_a_plant_and_a_family():
    for effect in IDS:
        assert any(effect in plant.effects for plant in PLANTS.values()), effect
    assert all(e in FAMILY for plant in PLANTS.values() for e in plant.effects)


def test_clutter_stays_small_beside_an_effect_that_drives_the_axis_far():
    """An arm under a load turns away from its cubic spring's rest: the spring did 38 times what it does alone."""
    case = classes.generate("pair", "rich", 12, 90392)
    assert [e for e, _ in case.recipe.effects] == ["sensor_saturation", "constant_load"]
    slots = case.facts["clutter"]
    effects_alone = replace(case, e=clutter.applied(case.e, clutter.scaled(slots, -1.0)))
    base = vector.neutral(**case.plant.switches)
    grown = building._growth(effects_alone, base, slots)
    assert grown > 20.0
    assert 0.0 < slots["stiffness_3"] * grown / building.LARGEST_GROWTH < 1e-3  # 6.5e-4 alone is 0.3 of the noise


def test_the_clutters_curved_sensor_is_the_effects_own():
    scene = type("Scene", (), {"plant": PLANTS["hydraulic_cylinder"], "force": 1.0, "v_rms": 1.0, "q_max": 1.0,
                               "y_max": np.array([0.1, 1e6])})()
    slots = [clutter.draw(scene, np.random.default_rng(s), 0.02, (), channel) for s in range(8) for channel in (0, 1)]
    first, second = ([s["sensor_cubic"] for s in slots[k::2] if "sensor_cubic" in s] for k in (0, 1))
    assert first and min(first) > 0.3
    assert second and max(second) < 2e-14


def test_later_sets_leave_out_other_effects_under_other_conditions():
    order, rng = np.arange(len(IDS)), np.random.default_rng(0)

    def drawn(name, cell, turn, count):
        places = [classes._turned(name, cell, i, turn) for i in range(count)]
        return [classes._recipe(name, cell, i, 0, 1.0, rng, order, turn) for i in places]

    def ids(recipes):
        return {r.effects[0][0] for r in recipes}

    assert ids(drawn("left_out", "rich", 0, 20)) == ids(drawn("left_out", "hard", 0, 20)) == set(IDS[:20])
    later = [ids(drawn("left_out", cell, turn, 20)) for turn in (1, 2) for cell in ("rich", "hard")]
    assert set.union(*later) == set(IDS)
    seen = [{r.effects[0][0]: r.excitation for r in drawn("single", "hard", turn, 42)} for turn in (0, 1, 2)]
    assert all(len({s[i] == "closed_loop" for s in seen}) == 2 or len({s[i] for s in seen}) > 1 for i in IDS)


@pytest.mark.parametrize(("truth", "gone"), [
    ("asymmetric_coulomb_friction", {"constant_load"}),
    ("presliding_friction", {"hysteretic_spring"}),
    ("coulomb_friction", {"presliding_friction", "stribeck_friction", "hysteretic_spring"})])
def test_laws_that_are_the_truth_in_other_words_are_left_out_with_it(truth, gone):
    plant = SimpleNamespace(name="two_link_arm", velocity="w", position=0)
    case = SimpleNamespace(drawn=[SimpleNamespace(id=truth)], measured=("q", "w"), plant=plant)
    assert gone | {truth} <= set(classes.left_out_ids(case))


@pytest.mark.parametrize(("plant", "exact"), [("dc_motor", True), ("two_link_arm", False)])
def test_loads_make_the_offset_of_a_reading_on_a_linear_plant(plant, exact):
    plant = SimpleNamespace(name=plant, velocity=1, position=-1)
    case = SimpleNamespace(drawn=[SimpleNamespace(id="sensor_offset")], measured=(0, 1), plant=plant)
    assert ("constant_load" in classes.left_out_ids(case)) == exact
