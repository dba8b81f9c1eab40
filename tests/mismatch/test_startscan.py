"""Start states that only a law sees: they are looked for over their whole range."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest

from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import collect
from pwaid.mismatch.hypotheses import mean_square
from pwaid.mismatch.vetoes import veto
from pwaid.recording import Recording

PERIOD, LEVEL, WAVE = 0.02, 0.35, 9.0


def rotor(t, x, u, params):
    return np.array([x[1], (u[0] - params["b"] * x[1]) / params["J"]])


def two_rotors(t, x, u, params):
    twist = params["k"] * (x[0] - x[2]) + 0.05 * (x[1] - x[3])
    return np.array([x[1], (u[0] - params["b"] * x[1] - twist) / params["J"], x[3], twist / 0.5])


def speed(t, x, u, params):
    return np.array([x[1]])


def angle(t, x, u, params):
    return np.array([x[0]])


def plant(rhs, output):
    states = ["q_m", "w_m", "q_l", "w_l"] if rhs is two_rotors else ["q_m", "w_m"]
    return control.nlsys(rhs, output, inputs=["T"], outputs=["y"], states=states,
                         params={"J": 1.0, "b": 0.6, "k": 40.0} if rhs is two_rotors else {"J": 1.0, "b": 0.6})


def recording(seed: int, rhs, output, ripple: float = 0.0, samples: int = 700, load: float = 0.0):
    """A multisine that starts anywhere on the ripple, in steps of 1 ms, with 1 % of noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * PERIOD
    u = 1.2 * np.sin(2 * np.pi * np.outer(t, rng.uniform(0.1, 0.8, 5)) + rng.uniform(0, 6.28, 5)).sum(axis=1)
    x, params, y = np.zeros(4 if rhs is two_rotors else 2), {"J": 1.05, "b": 0.55, "k": 40.0}, np.empty(samples)
    x[::2] += rng.uniform(-1.0, 1.0)
    for k in range(samples):
        y[k] = output(t[k], x, u[k:k + 1], params)[0]
        for _ in range(20):
            d = rhs(t[k], x, u[k:k + 1], params)
            d[1] += (ripple * np.sin(WAVE * x[0]) + load) / params["J"]
            x = x + PERIOD / 20 * d
    y += 0.01 * np.std(y) * rng.normal(size=samples)
    return Recording(t, u[:, None], y[:, None], ("T",), ("y",),
                     {"T": "N m", "y": "rad" if output is angle else "rad/s"}, name=f"r{seed}.csv")


def evidence_of(rhs, output, effect, **more):
    runs = [recording(s, rhs, output, **more) for s in (1, 2, 3)]
    return collect(plant(rhs, output), runs[:2], runs[2:], ["J", "b"], effects=effect_by_id(effect))


@pytest.mark.parametrize(("rhs", "output", "direction"), [
    (rotor, speed, [1.0, 0.0]), (two_rotors, speed, [1.0, 0.0, 1.0, 0.0]), (rotor, angle, None)])
def test_directions_that_the_null_does_not_see(rhs, output, direction):
    unseen = evidence_of(rhs, output, "quadratic_drag").problem.unseen
    if direction is None:
        assert unseen == []
    else:
        (leading, found), = unseen
        assert found[leading] == 1.0
        assert np.allclose(found / found[0], direction, atol=1e-6)


@pytest.mark.parametrize("rhs", [rotor, two_rotors])
def test_a_ripple_is_found_where_the_position_is_not_measured(rhs):
    best = evidence_of(rhs, speed, "position_ripple", ripple=LEVEL).singles[0]
    assert best.share > 0.99
    assert best.values()[0][:2] == pytest.approx([LEVEL, WAVE], rel=0.03)


def test_a_start_that_a_fit_has_lost_is_found_again():
    evidence = evidence_of(rotor, speed, "position_ripple", ripple=LEVEL)
    best, problem = evidence.singles[0], evidence.problem
    X0 = best.fit.X0.copy()
    X0[0, 0] += 2.5 / WAVE
    Y, X = best.fit.model.simulate(best.fit.theta, X0, problem.train)
    lost = replace(best.fit, X0=X0, Y=Y, X=X)
    assert mean_square(problem, lost, problem.train) > 2 * best.train_error
    assert mean_square(problem, problem.restarted(lost), problem.train) < 1.01 * best.train_error


def test_a_spring_that_stands_in_for_a_load_where_nothing_measures_the_position():
    far = evidence_of(rotor, speed, "linear_stiffness", load=0.5)
    assert far.singles[0].share > 0.9
    assert veto(far.problem, far.singles[0]) == "its force is as good as constant: a load"
    near = evidence_of(rotor, speed, "linear_stiffness", ripple=LEVEL)
    assert all("load" not in veto(near.problem, h) for h in near.singles)
