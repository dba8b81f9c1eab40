"""Numbers in the text summary show what their intervals support, and verdicts read as sentences."""

from __future__ import annotations

import pytest

from pwaid.mismatch.summary import _else, plus_minus, verdict_sentence, with_interval


@pytest.mark.parametrize(
    ("value", "low", "high", "text"),
    [
        (0.119985, 0.1199, 0.12003, "0.11998 (0.1199 to 0.12003)"),
        (17.5, 16.4, 18.8, "17.5 (16.4 to 18.8)"),
        (0.0, -1.0, 1.0, "0 (-1 to 1)"),
        (1.5, None, None, "1.5 (n/a to n/a)"),
        (None, None, None, "n/a (n/a to n/a)"),
    ],
)
def test_digits_follow_the_interval(value, low, high, text):
    assert with_interval(value, low, high) == text


@pytest.mark.parametrize(
    ("value", "low", "high", "text"),
    [
        (0.45, 0.44, 0.46, "0.450 ± 0.010 N m"),
        (12.0, 9.0, 30.0, "12 (9 to 30) N m"),  # not symmetric
        (2.4e11, 2.3e11, 2.5e11, "2.4e+11 (2.3e+11 to 2.5e+11) N m"),
        (0.45, None, None, "0.45 N m"),
    ],
)
def test_symmetric_intervals_read_as_plus_minus(value, low, high, text):
    assert plus_minus(value, low, high, "N m") == text


def content(verdict, effects=(), alternatives=(), rmse=1.0):
    return {"verdict": verdict, "effects": list(effects), "alternatives": list(alternatives),
            "noise_floor": {"y": 0.5}, "fit": {"r": {"y": {"refitted": {"rmse": rmse}}}},
            "parameters": {"J": {"nominal": 1.0, "refitted": 0.8}, "b": {"nominal": 1.0, "refitted": 1.01}}}


def effect(name, kind="state", signal="v"):
    return {"id": name, "where": {"kind": kind, "signal": signal, "note": ""},
            "parameters": {"level": {"value": 0.45, "low": 0.44, "high": 0.46, "unit": "N m"}}}


def test_verdicts_read_as_sentences():
    friction, clip = effect("coulomb_friction"), effect("sensor_saturation", "output", "y")
    assert verdict_sentence(content("named", [friction], [[0]])) == (
        "Coulomb friction of 0.450 ± 0.010 N m acting on v is missing from the simulator.")
    pair = verdict_sentence(content("named", [friction, clip], [[0, 1]]))
    assert "and sensor saturation of 0.450 ± 0.010 N m in the sensor y are missing" in pair
    either = verdict_sentence(content("one_of", [friction, clip], [[0], [1]]))
    assert "cannot say which" in either
    assert " or sensor saturation" in either
    assert "2.0 times the noise" in verdict_sentence(content("unexplained"))
    moved = verdict_sentence(content("parameters_only", rmse=0.5))
    assert "J 20 % lower" in moved
    assert "b 1 %" not in moved
    assert "disturbance" not in moved
    assert "disturbance" in verdict_sentence(content("parameters_only", rmse=1.0))
    assert "nothing is missing" in verdict_sentence(content("agreement", rmse=0.5)).lower()


def test_a_runner_up_that_explains_more_and_was_refused_is_said_to_be():
    rows = [{"id": i, "where": f"{i} at state:v", "share_explained": share, "passed": passed, "wider": False}
            for i, share, passed in (("coulomb_friction", 0.97, True), ("hysteretic_spring", 0.99, False),
                                     ("viscous_friction", 0.4, False))]
    told = _else({"candidates": rows, "answer": ["coulomb_friction at state:v"], "share_explained": 0.97,
                  "effects": [effect("coulomb_friction")]})
    assert told == ["Runners-up (share of explainable held-out error): hysteretic_spring at state:v 99.0 %, refused; "
                    "viscous_friction at state:v 40 %"]
