"""Locate on recordings: the named friction's jump, and the labelled correction of what nothing names."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tests_support import oscillator, pushed

from pwaid.mismatch import explain
from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.html import html_page
from pwaid.mismatch.lawcurve import law_over
from pwaid.mismatch.pictures import pictures
from pwaid.mismatch.pictures_where import error_shares
from pwaid.mismatch.smoother import linearise, unknown_inputs
from pwaid.mismatch.summary import summary_text

FREE = ["m", "b", "k"]


def bump(x, v):
    """A force that no entry of the catalogue has: one-sided, over the position."""
    return -1.5 * max(0.0, 1.0 - abs(x - 0.25) / 0.15)


@pytest.fixture(scope="module")
def friction(friction_recordings):
    return explain(oscillator(), friction_recordings[:2], friction_recordings[2:], FREE,
                   effects=[*effect_by_id("coulomb_friction"), *effect_by_id("cubic_stiffness")])


@pytest.fixture(scope="module")
def unnamed():
    recordings = [pushed(s, bump, highest=1.0, noise=1e-3, fine=10).replace(name=f"bump{s}.csv") for s in (1, 2, 3)]
    return explain(oscillator(), recordings[:2], recordings[2:], FREE,
                   effects=[*effect_by_id("sensor_saturation"), *effect_by_id("quadratic_drag")])


def test_named_friction_jumps_where_the_speed_is_zero(friction):
    where = friction.content["location"]
    assert friction.verdict == "named" and where["channel"] == "state:v" and not where["memory"]
    seen = where["unknown_input"]
    assert seen["variable"] == "v" and "input:F" in seen["alike"]  # the input pushes on the same mass
    bend = min(seen["breakpoints"], key=lambda b: abs(b["position"]))
    assert bend["jump"] and abs(bend["position"]) < 0.1
    assert bend["size"] == pytest.approx(-0.8, rel=0.4)  # read off a smeared jump
    assert where["breakpoints"]["v"] == [b["position"] for b in seen["breakpoints"]]
    assert "jump at" in friction.summary
    assert friction.content["correction"] is None


def test_every_picture_of_the_page_is_drawn(friction, unnamed):
    drawn = pictures(friction)
    assert [title for title, _, _ in drawn] == [
        "Recording against simulation, before and after", "What is missing, over the responsible variable",
        "The mismatch over time and frequency", "Candidates", "Which candidates these recordings tell apart",
        "Next experiment"]
    assert all(png.startswith(b"\x89PNG") for _, _, png in drawn)
    assert len(pictures(unnamed)) >= 4


def test_page_opens_with_the_verdict_in_words(friction):
    page = html_page(friction)
    assert "<h1>Coulomb friction of 0." in page
    assert "is missing from the simulator.</h1>" in page
    assert page.count("data:image/png;base64,") == 6
    assert "http" not in page  # self-contained


def test_summary_follows_the_order_an_engineer_asks(friction):
    text = friction.summary
    marks = ["NAMED. Coulomb friction of", "It explains", "Where:", "Law: coulomb friction", "Error on held-out",
             "Next: To be surer of coulomb_friction", "hypotheses tried"]
    places = [text.index(m) for m in marks]
    assert places == sorted(places)
    assert len(text.splitlines()) < 40
    assert max(map(len, text.splitlines())) <= 112


def test_report_says_what_can_be_told_apart_and_what_to_record(friction):
    c = friction.content
    n = len(c["isolability"]["labels"])
    assert np.shape(c["isolability"]["matrix"]) == (n, n)
    plan = c["experiment"]
    assert plan["between"][0] == "coulomb_friction at state:v"
    assert plan["input"] in c["next_experiment"]
    assert "coulomb" not in plan["between"][1]  # a rival of another law
    assert plan["predicted_difference"] > plan["present_difference"] > 0
    stages = c["fit"]["r3.csv"]["x"]
    assert stages["repaired"]["share_explained"] == pytest.approx(c["share_explained"], abs=0.01)
    assert stages["refitted"]["whiteness_p"] < 1e-3


def test_shares_over_time_sum_to_what_is_left(friction):
    p = friction.problem
    before, after = (p.test.Y[:, 0] - Y[:, 0] for Y in (friction.null.test.Y, friction.best.test.Y))
    edges, shares = error_shares(before, after)
    assert edges[-1] == len(before)
    assert shares[0].sum() == pytest.approx(1.0)
    assert shares[1].sum() == pytest.approx(np.sum(after**2) / np.sum(before**2))


def test_law_curve(friction):
    z = np.array([-1.0, -0.1, 0.1, 1.0])
    level = friction.effects[0]["parameters"]["level"]["value"]
    np.testing.assert_allclose(law_over(friction.problem, friction.best, "v", z), -level * np.sign(z), rtol=1e-6)


def test_unknown_inputs_rank_the_equation_of_motion(friction):
    line = linearise(friction.problem)
    assert unknown_inputs(friction.problem, line)[0].channel in ("state:v", "input:F")


def test_unexplained_gets_a_labelled_correction_that_repairs(unnamed):
    assert unnamed.verdict == "unexplained" and unnamed.effects == []
    c = unnamed.content
    correction = c["correction"]
    assert "without a name" in correction["label"]
    assert correction["variable"] == "x" and correction["in_repaired_simulator"]
    assert correction["heldout_gain"] > 0.5
    seen = c["location"]["unknown_input"]["breakpoints"]
    assert not any(b["jump"] for b in seen)  # the flanks of a bump are no jumps
    for place in (0.1, 0.25, 0.4):
        assert min(abs(b["position"] - place) for b in seen) < 0.06
    fit = c["fit"]["bump3.csv"]["x"]
    assert fit["repaired"]["rmse"] < 0.75 * fit["refitted"]["rmse"]
    assert "Correction without a name" in summary_text(c)
    json.dumps(c, allow_nan=False)


def test_repaired_simulator_carries_the_correction(unnamed):
    """The python-control object gives the outputs that were scored."""
    system, held = unnamed.simulator, unnamed.problem.test
    x, Y = unnamed.best.test.X0[0], []
    for k in range(200):
        Y.append(system.output(k * held.sample_time, x, held.U[k]))
        x = system.dynamics(k * held.sample_time, x, held.U[k])
    np.testing.assert_allclose(np.array(Y), unnamed.best.test.Y[:200], atol=1e-6)
