"""The baselines compute what they say: sparse regression, output-error refit with Gaussian process, reading a case."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "benchmarks"))

from concealed import classes, generate, write
from concealed.baselines import always_parameters, common, gaussian_process, majority, sindy
from concealed.integrate import simulate
from concealed.judge import removed_share


@pytest.fixture(scope="module")
def sealed(tmp_path_factory):
    """A calibration case with a missing viscous friction: its folder as a baseline reads it, case and key entry."""
    seed = generate.seed_of("calibration", "rich", "single", 0)
    made = classes.generate("single", "rich", 0, seed)
    path = tmp_path_factory.mktemp("case") / "case"
    write.write_case(made, path)
    return common.read(path), made, write.key_entry(made, "single", "rich", seed)


def test_several_runs_at_a_time_are_the_runs_one_by_one_and_follow_the_truth(sealed):
    folder, made, _ = sealed
    rec = made.recordings[0]
    ts = made.plant.ts
    x0 = np.column_stack([rec.x0, 1.5 * rec.x0])
    gain = np.array([1.0, 1.2])
    free, params = folder.free[0], folder.system.params
    assert folder.first == (made.recipe.hold == "first")

    def run(factor, x0):
        changed = params | {free: params[free] * factor}
        return common.simulate(folder.system, changed, rec.u, ts, x0, folder.first)

    both = run(gain, x0)
    for i in range(2):
        alone = run(gain[i], x0[:, i:i + 1])
        np.testing.assert_allclose(both[:, :, i], alone[:, :, 0], rtol=1e-12)
    fine = simulate(made.plant, made.nominal, made.e_nominal, rec.x0, rec.u, nsub=24, outputs=made.measured,
                    hold=made.recipe.hold)[2]
    assert np.abs(both[:, :, 0] - fine).max() < 2e-3 * np.abs(fine).max()


def test_the_jacobian_is_the_slope_of_the_residual(sealed):
    folder, *_ = sealed
    names = folder.train[:2]
    problem = gaussian_process.OutputError(folder, names, np.zeros(len(folder.free)), False)
    size = np.full(folder.system.nstates, 0.1)
    z = np.full(len(folder.free) + 2 * folder.system.nstates, 0.05)
    jac = problem.jacobian(z, size)
    for k in (0, len(z) - 1):
        step = np.zeros(len(z))
        step[k] = 1e-4
        slope = (problem.residual(z + step, size) - problem.residual(z - step, size)) / 2e-4
        np.testing.assert_allclose(jac[:, k], slope, atol=2e-3 * np.abs(slope).max())


def test_the_gaussian_process_refits_and_removes_part_of_a_held_out_error(sealed):
    folder, _, entry = sealed
    short = {n: tuple(part[:250] for part in rec) for n, rec in folder.recordings.items()}
    folder = replace(folder, recordings=short)
    report = gaussian_process.diagnose(folder, set())
    assert report["verdict"] == "unexplained"
    assert set(report["fit"]) == set(folder.test)
    share = removed_share(entry, report)
    assert 0.0 < share < 1.0


def test_a_term_counts_with_what_it_alone_adds():
    rng = np.random.default_rng(3)
    q, v, u = rng.uniform(-0.8, 0.8, 4000), rng.standard_normal(4000), rng.standard_normal((4000, 1))
    nominal, terms = sindy.library(q, v, u, 2)
    force = nominal @ [-0.4, 1.0, -0.3]
    assert sindy.regress(force, nominal, terms) == {}
    shares = sindy.regress(force - 0.5 * np.sign(v), nominal, terms)
    assert list(shares) == ["coulomb_friction"]
    found = sindy.regress(force - 8.0 * q**3, nominal, terms)
    assert set(found) <= {"cubic_stiffness", "gravity_torque"}  # sin q is q − q³/6 here: the same force
    assert found


def test_the_constant_answers_respect_what_is_left_out():
    assert always_parameters.diagnose(None, set())["verdict"] == "parameters_only"
    assert majority.diagnose(None, set())["effects"][0]["id"] == "coulomb_friction"
    assert majority.diagnose(None, {"coulomb_friction"})["effects"][0]["id"] == "actuator_saturation"
    assert majority.diagnose(None, set(majority.MAJORITY))["verdict"] == "parameters_only"
