"""Long recordings are searched on stretches; what is found there is fitted to everything."""

from __future__ import annotations

import numpy as np
import pytest
from tests_support import gathered, record

from pwaid.mismatch import scout
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.decide import decide
from pwaid.mismatch.effects.registry import CATALOGUE
from pwaid.mismatch.model import Located, Model
from pwaid.mismatch.scout import evenly, part_of, scouted

IDS = ("coulomb_friction", "sensor_offset", "cubic_stiffness", "sensor_drift")


@pytest.fixture
def brief(monkeypatch):
    """Searches on 600 samples."""
    monkeypatch.setattr(scout, "SAMPLES", 600)


def test_stretches_keep_segments_samples_and_clock():
    data = Dataset.from_recordings([record(1, samples=90), record(2, samples=60)]).cut(40)
    part, index = data.windows([(10, 60), (100, 150)])
    assert part.segments.tolist() == [[0, 35, 0, 50, 10], [35, 50, 0, 50, 10], [50, 70, 50, 100, 10],
                                      [70, 100, 50, 100, 10]]
    assert part.names == data.names
    np.testing.assert_array_equal(part.Y, data.Y[index])
    np.testing.assert_array_equal(part.U, data.U[index])
    inner, deeper = part.windows([(20, 40), (60, 80)])
    assert inner.segments[:, 4].tolist() == [30, 30, 20, 20]
    np.testing.assert_array_equal(inner.Y, data.Y[index][deeper])
    assert part.cut(25).segments[:, 4].tolist() == [10] * 4
    assert part.and_also(part).segments[4].tolist() == [100, 135, 100, 150, 10]


@pytest.mark.parametrize("effect", ["sensor_drift", "coulomb_friction", "periodic_disturbance"])
def test_a_law_does_on_stretches_what_it_does_on_the_recording(effect):
    """Those bound to the clock too."""
    found = gathered([record(s) for s in (1, 2, 3)], "sensor_offset")
    problem, law = found.problem, next(e for e in CATALOGUE if e.id == effect)
    model = Model(problem.settings, (Located(law, law.places(problem.structure)[0]),), problem.settings.substeps)
    theta = np.append(problem.null.theta, np.full(model.nz, 0.2))
    Y, X = model.simulate(theta, problem.null.X0, problem.train)
    part, index = problem.train.windows([(100, 400), (700, 900)])
    again, _ = model.simulate(theta, X[index[part.segments[:, 0]], :model.nx], part)
    np.testing.assert_allclose(again, Y[index], atol=1e-9)


def test_short_recordings_are_searched_whole():
    assert scouted(gathered([record(s) for s in (1, 2, 3)], "sensor_offset").problem) is None


def test_the_stretches_hold_what_the_null_misses_most(brief):
    problem = gathered([record(s, level=0.4) for s in (1, 2, 3)], "sensor_offset").problem
    small = scouted(problem)
    assert 300 <= len(small.train.U) <= 900 < len(problem.train.U)
    assert small.train.sample_time == problem.train.sample_time
    error = np.sum(problem.null.residual(problem.train) ** 2, axis=1)
    blocks = scout._blocks(problem, problem.train, 600)
    told = scout._telling(problem, problem.train, problem.null)
    assert set(told) < set(blocks)
    assert max(blocks, key=lambda s: np.mean(error[slice(*s)])) in told
    spread = evenly(problem, problem.train, 600)
    assert sum(b - a for a, b in spread) == pytest.approx(600, abs=150)
    part, index = problem.train.windows(spread)
    np.testing.assert_array_equal(part_of(problem.null, part, index).Y, problem.null.Y[index])


def test_what_stretches_show_is_fitted_to_everything(brief):
    recordings = [record(s, level=0.4) for s in (1, 2, 3)]
    whole = gathered(recordings, *IDS)
    assert any("training samples" in note for note in whole.notes)
    best = whole.singles[0]
    assert best.ids == ("coulomb_friction",)
    assert len(best.fit.Y) == len(whole.problem.train.U) == 2 * len(recordings[0].time)
    assert best.values()[0][0] == pytest.approx(0.4, rel=0.02)
    assert decide(whole.problem, whole.null, whole.singles, whole.pairs).verdict == "named"
