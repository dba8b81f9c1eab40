"""A pendulum that swings over the top: no start state keeps it over a recording, though nothing is missing."""

from __future__ import annotations

import control
import numpy as np
from tests_support import oscillator, record

from pwaid.mismatch.decide import at_floor
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import collect
from pwaid.mismatch.thresholds import Thresholds
from pwaid.recording import Recording

PERIOD, SAMPLES = 0.0125, 900
TRUE = {"J": 0.046, "b": 0.03, "mgl": 1.0}


def pendulum(t, x, u, params):
    return np.array([x[1], (u[0] - params["b"] * x[1] - params["mgl"] * np.sin(x[0])) / params["J"]])


def recording(seed: int, friction: float) -> Recording:
    """Torques that carry it over the top now and then, the speed measured with 1 % of noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(SAMPLES) * PERIOD
    u = 0.45 * np.sin(2 * np.pi * np.outer(t, rng.uniform(0.3, 1.2, 4)) + rng.uniform(0, 6.28, 4)).sum(axis=1)
    x, y = np.array([rng.uniform(-0.3, 0.3), 0.0]), np.empty(SAMPLES)
    for k in range(SAMPLES):
        y[k] = x[1]
        for _ in range(20):
            slow = u[k:k + 1] - friction * np.tanh(200 * x[1])
            half = x + PERIOD / 40 * pendulum(t, x, slow, TRUE)
            x = x + PERIOD / 20 * pendulum(t, half, slow, TRUE)
    y += 0.01 * np.std(y) * rng.normal(size=SAMPLES)
    return Recording(t, u[:, None], y[:, None], ("T",), ("w",), {"T": "N m", "w": "rad/s"}, name=f"r{seed}.csv")


def evidence_of(friction: float):
    simulator = control.nlsys(pendulum, lambda t, x, u, params: x[1:], inputs=["T"], outputs=["w"],
                              states=["q", "w"], params={**TRUE, "b": 0.033})
    runs = [recording(s, friction) for s in (1, 2, 3)]
    return collect(simulator, runs[:2], runs[2:], ["J", "b", "mgl"], effects=effect_by_id("coulomb_friction"),
                   noise_floor={"w": 0.01 * np.std(runs[0].outputs)})


def test_segments_keep_what_no_start_state_keeps():
    problem = evidence_of(0.0).problem
    assert any("the motion is sensitive" in note for note in problem.notes)
    assert at_floor(problem, Thresholds())
    assert len(problem.train.segments) > 2
    assert np.all(np.abs(np.expm1(problem.null.theta) - [0.0, -1 / 11, 0.0]) < 0.02)


def test_a_friction_is_found_in_segments_and_judged_on_whole_recordings():
    evidence = evidence_of(0.04)
    best = evidence.singles[0]
    assert any("the motion is sensitive" in note for note in evidence.problem.notes)
    assert not at_floor(evidence.problem, Thresholds())
    assert len(evidence.problem.train.segments) == 2
    assert best.share > 0.99
    assert abs(best.values()[0][0] - 0.04) < 0.002


def test_a_recording_at_rest_makes_no_motion_sensitive():
    moving = [record(seed, samples=500) for seed in (1, 2, 3)]
    rest = moving[1].replace(inputs=np.full_like(moving[1].inputs, 0.3), outputs=np.full_like(moving[1].outputs, 0.1),
                             name="rest")
    for train, test in (([moving[0], rest], [moving[2]]), (moving[:2], [moving[2], rest])):
        problem = collect(oscillator(), train, test, ["m", "b", "k"], effects=effect_by_id("cubic_stiffness")).problem
        assert len(problem.train.segments) == len(train) and not any("sensitive" in note for note in problem.notes)
