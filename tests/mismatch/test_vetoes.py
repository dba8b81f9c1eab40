"""What a fitted law may not be: a stop that yields, a limit that readings pass, a pair that explains too little."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests_support import gathered, multisine, oscillator, pushed, record, recorded

from pwaid.mismatch import Thresholds
from pwaid.mismatch.adequacy import stretched
from pwaid.mismatch.decide import _material, decide
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import collect
from pwaid.mismatch.model import Model
from pwaid.mismatch.vetoes import _strains, at_bound, veto


def test_a_stop_that_yields_like_a_spring_is_none():
    springs = gathered([pushed(s, lambda x, v: -6.0 * x**3) for s in (1, 2, 3)], "end_stop")
    best = min(springs.singles, key=lambda h: h.test_error)
    assert best.share > 0.5  # it would pass
    assert "yields like a spring" in veto(springs.problem, best)
    assert decide(springs.problem, springs.null, springs.singles, ()).verdict == "unexplained"


def test_a_stop_that_is_nearly_always_pressed_is_a_spring():
    recordings = [pushed(s, lambda x, v: -4.0 * max(x + 0.8, 0.0)) for s in (1, 2, 3)]
    springs = collect(oscillator(k=3.0), recordings[:2], recordings[2:], ["m", "b"], effects=effect_by_id("end_stop"))
    best = min(springs.singles, key=lambda h: h.test_error)
    assert best.share > 0.99  # a stop does what the spring does
    assert "yields like a spring" in veto(springs.problem, best)


def test_a_stop_that_stops_is_one():
    def stop(x, v):
        depth = np.sign(x) * max(abs(x) - 0.35, 0.0)
        return -(600.0 * depth + 4.0 * v) if depth * (600.0 * depth + 4.0 * v) > 0 else 0.0

    stops = gathered([pushed(s, stop) for s in (1, 2, 3)], "end_stop")
    decision = decide(stops.problem, stops.null, stops.singles, ())
    assert (decision.verdict, decision.chosen.ids) == ("named", ("end_stop",))


@pytest.fixture(scope="module")
def clipped_then_drifting():
    """Readings clipped at 0.3 m; the sensor drifts by 0.09 m a recording after that."""
    return gathered([r.replace(outputs=np.clip(r.outputs, -0.3, 0.3) + 5e-3 * r.time[:, None] + 2e-3
                               * np.random.default_rng(s).normal(size=r.outputs.shape))
                     for s, r in ((s, record(s, noise=0.0)) for s in (1, 2, 3))], "sensor_saturation", "sensor_drift")


def test_readings_that_another_law_moves_past_a_limit_do_not_speak_against_it(clipped_then_drifting):
    evidence = clipped_then_drifting
    pairs = [h for h in evidence.pairs if set(h.ids) == {"sensor_saturation", "sensor_drift"} and h.share > 0.9]
    assert pairs and any(veto(evidence.problem, h) == "" for h in pairs)
    decision = decide(evidence.problem, evidence.null, evidence.singles, evidence.pairs)
    assert decision.verdict == "named" and set(decision.chosen.ids) == {"sensor_saturation", "sensor_drift"}


def test_a_pair_must_explain_more_than_one_law_must(clipped_then_drifting):
    evidence = clipped_then_drifting
    strict = decide(evidence.problem, evidence.null, evidence.singles, evidence.pairs,
                    Thresholds(pair_share=1.1, pair_share_quiet=1.1))
    assert strict.chosen is None or len(strict.chosen.ids) < 2


def test_a_law_at_the_floor_must_still_raise_the_likelihood():
    evidence = gathered([record(s, level=0.06) for s in (1, 2, 3)], "coulomb_friction")
    named, refused = (decide(evidence.problem, evidence.null, evidence.singles, (), t)
                      for t in (Thresholds(), Thresholds(evidence=1e9)))
    assert named.verdict == "named"
    assert refused.verdict == "unexplained" and any("log-likelihood rose by" in r for r in refused.reasons)


def test_a_clipped_reading_may_pass_its_limit_by_slow_noise_but_not_by_more():
    def reading(seed, passed):
        r, rng = record(seed, noise=0.0), np.random.default_rng(100 + seed)
        slow = np.convolve(rng.normal(size=len(r.time) + 24), np.ones(25) / 5.0, "valid")[:, None]
        clipped = np.clip(r.outputs, -0.3, 0.3)
        return r.replace(outputs=clipped + passed * (r.outputs - clipped) + 0.004 * slow)

    for passed, said in ((0.0, ""), (0.4, "the recording goes beyond the limit that is said to clip it")):
        evidence = gathered([reading(s, passed) for s in (1, 2, 3)], "sensor_saturation")
        best = min(evidence.singles, key=lambda h: h.train_error)
        assert best.share > 0.4
        assert veto(evidence.problem, best) == said


def test_a_size_that_vanishes_beside_another_is_not_at_a_bound():
    evidence = gathered([record(s, level=0.06) for s in (1, 2, 3)], "stribeck_friction")
    best = min((h for h in evidence.singles if h.ids == ("stribeck_friction",)), key=lambda h: h.train_error)
    step = evidence.problem.train.sample_time
    low, high = best.fit.model.bounds(step)
    names, n = [q.name for q in best.located[0].effect.quantities], best.fit.model.np

    def moved(name, to):
        theta = best.fit.theta.copy()
        theta[n + names.index(name)] = to[n + names.index(name)]
        return at_bound(replace(best, fit=replace(best.fit, theta=theta)), step)

    assert moved("excess", low) == [] and moved("excess", high) == ["excess"]
    assert moved("stribeck_speed", low) == ["stribeck_speed"]


def test_what_a_second_law_removes_must_be_as_much_as_the_noise():
    evidence = gathered([record(s, level=0.4) for s in (1, 2, 3)], "coulomb_friction")
    problem, best = evidence.problem, evidence.singles[0]
    rest = problem.test.Y - best.test.Y
    closer = replace(best, test=replace(best.test, Y=best.test.Y + 0.3 * rest))  # half of the noise's mean square
    farther = replace(best, test=replace(best.test, Y=best.test.Y - 0.5 * rest))  # 1.25 times that more
    assert not _material(problem, best, closer, Thresholds())
    assert _material(problem, farther, best, Thresholds()) and _material(problem, evidence.null, best, Thresholds())


def test_a_hysteretic_spring_without_hysteresis_is_none():
    softening = [pushed(s, lambda x, v: -4.0 * np.tanh(2.5 * x)) for s in (1, 2, 3)]
    recordings = softening[:2], softening[2:]
    evidence = collect(oscillator(), *recordings, ["m", "b"], effects=effect_by_id("hysteretic_spring"))
    h = evidence.singles[0]
    assert h.share > 0.9 and h.values()[0][3] > 0.9  # it fits, with nothing that dissipates
    assert "no hysteresis" in veto(evidence.problem, h)
    assert decide(evidence.problem, evidence.null, evidence.singles, ()).verdict == "unexplained"


def test_a_compliance_that_stands_for_a_mass_is_none():
    runs = [record(s) for s in (1, 2, 3)]
    evidence = collect(oscillator(m=0.6), runs[:2], runs[2:], ["b", "k"], effects=effect_by_id("compliance"))
    h = evidence.singles[0]
    assert h.share > 0.9 and h.values()[0][0] > 0.94
    assert "all of the mass" in veto(evidence.problem, h)
    assert decide(evidence.problem, evidence.null, evidence.singles, ()).verdict == "unexplained"


def test_a_compliance_that_does_not_swing_is_none():
    runs = [record(s) for s in (1, 2, 3)]
    evidence = collect(oscillator(b=0.2), runs[:2], runs[2:], ["m", "k"], effects=effect_by_id("compliance"))
    h = evidence.singles[0]
    assert h.share > 0.99 and h.values()[0][2] > 0.5  # a damper at some frequencies
    assert "dies out within one swing" in veto(evidence.problem, h)
    assert decide(evidence.problem, evidence.null, evidence.singles, ()).verdict == "unexplained"


def rippled(force):
    runs = [pushed(s, lambda x, v: force(x)) for s in (1, 2, 3)]
    evidence = collect(oscillator(k=3.0), runs[:2], runs[2:], ["m", "b"], effects=effect_by_id("position_ripple"))
    return evidence, max(evidence.singles, key=lambda h: h.share)


def test_a_ripple_that_was_not_seen_to_repeat_is_none():
    evidence, h = rippled(lambda x: -4.0 * np.tanh(2.5 * x))
    assert h.share > 0.99 and h.values()[0][1] * np.ptp(h.fit.X[:, 0]) < 3.0 * np.pi
    assert "as long as the travel" in veto(evidence.problem, h)


def test_a_ripple_that_repeats_is_one():
    evidence, h = rippled(lambda x: -1.0 * np.sin(9.0 * x))
    assert h.share > 0.99 and veto(evidence.problem, h) == ""
    assert h.values()[0][:2] == pytest.approx([1.0, 9.0], rel=0.02)


def on_one_side(force):
    """The true oscillator, held about 1.5 m from its rest, with a force of the position."""
    def run(seed):
        rng, t, h = np.random.default_rng(seed), 0.02 * np.arange(900), 0.001
        u, x, v, y = 8.0 + 0.5 * multisine(rng, t, 1.5), 1.6, 0.0, np.empty(900)
        for k in range(900):
            y[k] = x
            for _ in range(20):
                v += h * (u[k] - 0.45 * v - 3.0 * x - force(x))
                x += h * v
        return recorded(t, u, y, 2e-3, rng, seed)

    runs = [run(s) for s in (1, 2, 3)]
    evidence = collect(oscillator(k=3.0), runs[:2], runs[2:], ["m", "b"], effects=[
        e for i in ("quadratic_stiffness", "constant_load") for e in effect_by_id(i)])
    return evidence, max(evidence.pairs, key=lambda h: h.share)


def test_a_bent_spring_with_a_load_that_make_a_straight_line_are_none():
    evidence, h = on_one_side(lambda x: 2.0 * x)
    assert h.share > 0.999 and "straight line" in veto(evidence.problem, h)
    assert decide(evidence.problem, evidence.null, evidence.singles, evidence.pairs).verdict == "unexplained"


def test_a_bent_spring_with_a_load_that_explain_everything_are_named():
    evidence, h = on_one_side(lambda x: x * x + 1.0)
    decision = decide(evidence.problem, evidence.null, evidence.singles, evidence.pairs)
    assert decision.verdict == "named" and set(decision.chosen.ids) == {"quadratic_stiffness", "constant_load"}


def test_what_a_law_leaves_may_not_outgrow_what_there_was_to_explain():
    evidence = gathered([record(s, level=0.4) for s in (1, 2, 3)], "coulomb_friction")
    problem, best = evidence.problem, evidence.singles[0]

    def left(fit, data, factor):
        return replace(fit, Y=fit.Y - (factor - 1.0) * (data.Y - fit.Y))

    def said(times, problem=problem):
        h = replace(best, fit=left(best.fit, problem.train, 3.0), test=left(best.test, problem.test, times))
        return stretched(problem, h, Thresholds())

    assert said(8.0) == "" and "as much as in training" in said(10.0)  # 64 and 100 floors held out, 9 in training
    harder = replace(problem, null_test=left(problem.null_test, problem.test, 3.0))
    assert said(10.0, harder) == ""  # a held-out recording that goes farther, where the null errs nine times more


def swinging(seed: int, load: float):
    """The true oscillator under one sine and a constant load."""
    rng, t, h = np.random.default_rng(seed), 0.02 * np.arange(900), 0.001
    u, x, v, y = 1.2 * np.sin(0.5 * np.pi * t + seed), 0.0, 0.0, np.empty(900)
    for k in range(900):
        y[k] = x
        for _ in range(20):
            v += h * (u[k] - 0.45 * v - 3.0 * x - load)
            x += h * v
    return recorded(t, u, y, 2e-3, rng, seed)


def test_a_hysteretic_spring_that_stays_strained_to_one_side_is_a_load():
    runs = [swinging(s, 0.4) for s in (1, 2, 3)]
    evidence = collect(oscillator(), runs[:2], runs[2:], ["m", "b", "k"], effects=effect_by_id("hysteretic_spring"))
    h = evidence.singles[0]
    assert h.share > 0.9 and h.values()[0][3] < 0.9
    assert "as good as constant" in veto(evidence.problem, h)


def test_the_strain_of_a_hysteretic_spring_is_found_behind_the_memory_of_an_input():
    evidence = gathered([record(s, samples=400) for s in (1, 2, 3)], "hysteretic_spring", "actuator_lag")
    problem = evidence.problem
    spring, lag = (next(e for h in evidence.singles for e in h.located if e.effect.id == i)
                   for i in ("hysteretic_spring", "actuator_lag"))
    parts = [np.array([0.3, 0.2, 1.0, 0.5]), np.array([1e-4])]

    def strains(located, values):
        model = Model(problem.settings, located, 4)
        both = [replace(evidence.null.fit, model=model, X=model.simulate_with(
            problem.plant.vector(), values, fit.X0, data)[1])
            for fit, data in ((evidence.null.fit, problem.train), (evidence.null.test, problem.test))]
        return _strains(replace(evidence.null, fit=both[0], test=both[1]), spring)

    alone = strains((spring,), parts[:1])
    assert np.ptp(alone) > 0.5
    np.testing.assert_allclose(strains((spring, lag), parts), alone, atol=0.05)
