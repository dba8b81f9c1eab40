"""Held-out recordings above the floor need no missing effect where parameters fitted to everything explain them."""

from __future__ import annotations

import numpy as np
import pytest
from tests_support import gathered, pushed

from pwaid.mismatch.decide import TOGETHER, decide
from pwaid.mismatch.explain import conclude
from pwaid.mismatch.floor import estimate_floor
from pwaid.mismatch.hypotheses import floor_square
from pwaid.mismatch.summary import verdict_sentence


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
