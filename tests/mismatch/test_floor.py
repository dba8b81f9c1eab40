"""Held-out recordings above the floor need no missing effect where parameters fitted to everything explain them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from tests_support import gathered, multisine, oscillator, pushed, recorded

from pwaid.mismatch.decide import TOGETHER, decide
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import collect, conclude
from pwaid.mismatch.floor import estimate_floor
from pwaid.mismatch.hypotheses import floor_square
from pwaid.mismatch.summary import verdict_sentence
from pwaid.recording import Recording


def test_parameters_that_short_training_hardly_determines_are_no_missing_effect():
    """Without the joint refit the lag, which removes half of the held-out error, was named."""
    runs = [pushed(s, lambda x, v: 0.0, noise=0.05, samples=n) for s, n in ((13, 60), (14, 60), (15, 900))]
    found = gathered(runs, "actuator_lag", "cubic_stiffness")
    problem = found.problem
    assert found.null.test_error > 3 * floor_square(problem)
    assert max(h.share for h in found.singles if h.ids == ("actuator_lag",)) > 0.5
    decision = decide(problem, found.null, found.singles, found.pairs)
    assert decision.verdict == "parameters_only"
    sentence = verdict_sentence(conclude(found, brief=True).to_dict())
    assert decision.reasons[0].startswith(TOGETHER)
    assert TOGETHER in sentence and "disturbance" not in sentence


def test_an_effect_that_only_held_out_recordings_excite_is_not_taken_for_parameters():
    quiet = [pushed(s, lambda x, v: -4.0 * max(abs(x) - 1.2, 0.0) * x, highest=0.2, samples=300) for s in (1, 2)]
    rich = pushed(3, lambda x, v: -4.0 * max(abs(x) - 0.3, 0.0) * x)
    found = gathered([*quiet, rich], "cubic_stiffness")
    assert decide(found.problem, found.null, found.singles, found.pairs).verdict == "unexplained"


def test_a_reading_that_rarely_changes_has_the_floor_of_its_rounding():
    t = np.arange(600.0)
    y = np.round((20.0 + 5.0 * np.sin(0.01 * t)) / 0.5) * 0.5
    binary = (np.sin(0.01 * t) > 0).astype(float)
    for signal, level in ((y, 0.5 / np.sqrt(12.0)), (binary, 0.0), (np.sin(0.01 * t), 0.0)):
        found = estimate_floor(np.zeros((600, 1)), signal[:, None], np.array([[0, 600, 0, 600]]), ["T"])
        assert found.level[0] == pytest.approx(level)


def test_a_floor_that_is_given_for_one_output_does_not_come_of_repeats_alone():
    rng = np.random.default_rng(0)
    outputs = rng.normal(size=(400, 2))
    segments, repeats = np.array([[0, 200, 0, 200], [200, 400, 200, 400]]), [[outputs[:200], outputs[200:]]]
    alone, beside = (estimate_floor(outputs, outputs, segments, ["x", "v"], given, repeats)
                     for given in (None, {"v": 3.0}))
    assert alone.repeated and not beside.repeated
    assert beside.level[0] == alone.level[0] and beside.level[1] == 3.0


def swung(seed: int, beginning: float, disturbed: float = 0.0, cubic: float = 0.0) -> Recording:
    """The oscillator under one input from another displacement at rest, 5 mm of noise and a slow disturbing force."""
    rng, t, dt = np.random.default_rng(seed), 0.02 * np.arange(900), 0.001
    u = multisine(np.random.default_rng(0 if seed < 10 else seed), t, 1.2)
    w = disturbed * lfilter([0.1], [1.0, -0.97], rng.normal(size=t.size))
    x, v, y = beginning, 0.0, np.empty(t.size)
    for k in range(t.size):
        y[k] = x
        for _ in range(20):
            v += dt * (u[k] + w[k] - 0.1 * v - 3.0 * x - cubic * x**3)
            x += dt * v
    return recorded(t, u, y, 5e-3, rng, seed)


def test_repeats_that_begin_differently_differ_by_noise_only():
    runs = [swung(1, 1.0), swung(2, -0.7), swung(11, 0.2)]
    evidence = collect(oscillator(b=0.12), runs[:2], runs[2:], ["m", "b", "k"], repeats=[["r1.csv", "r2.csv"]],
                       effects=effect_by_id("constant_load"))
    assert evidence.problem.floor.trusted
    assert evidence.problem.floor.level == pytest.approx([5e-3], rel=0.15)


def test_a_floor_by_repeats_that_a_law_undercuts_elsewhere_is_put_down():
    runs = [swung(1, 0.3, 1.2, cubic=3.0), swung(2, -0.3, 1.2, cubic=3.0), *(swung(s, 0.2, 0.1, 3.0) for s in (11, 12))]
    evidence = collect(oscillator(b=0.12), runs[:3], runs[3:], ["m", "b", "k"], repeats=[["r1.csv", "r2.csv"]],
                       effects=effect_by_id("cubic_stiffness"))
    floor = evidence.problem.floor
    assert floor.repeated and "repeated recordings" in floor.beaten and not floor.trusted
