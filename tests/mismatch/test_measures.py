"""Fit measures: whiteness and the share of the explainable error."""

from __future__ import annotations

import numpy as np
import pytest

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.measures import correlations, fit_table, ljung_box
from pwaid.recording import Recording


def test_white_noise_passes_and_coloured_noise_fails():
    rng = np.random.default_rng(0)
    p = [ljung_box(rng.normal(size=400))[1] for _ in range(200)]
    assert 0.01 < np.mean(np.array(p) < 0.05) < 0.11  # the test has its stated size
    coloured = np.convolve(rng.normal(size=410), np.ones(4) / 4, "valid")
    assert ljung_box(coloured)[1] < 1e-6


def test_correlations_of_an_alternating_signal():
    np.testing.assert_allclose(correlations(np.tile([1.0, -1.0], 500), 3), [-0.999, 0.998, -0.997], atol=1e-12)
    np.testing.assert_array_equal(correlations(np.ones(20), 2), [0.0, 0.0])


def test_share_of_explainable_counts_from_the_floor():
    t = np.arange(400) * 0.1
    rng = np.random.default_rng(1)
    noise, miss = 0.1 * rng.choice([-1.0, 1.0], size=400), np.sin(t)
    y = 3.0 * np.cos(0.3 * t) + noise
    data = Dataset.from_recordings([Recording(t, t[:, None], y[:, None], ("u",), ("y",), {}, name="r.csv")])
    stages = {"nominal": (y - noise - 2 * miss)[:, None], "refitted": (y - noise - miss)[:, None],
              "repaired": (y - noise)[:, None]}
    table = fit_table(data, ["y"], stages, np.array([0.1]))["r.csv"]["y"]
    assert table["repaired"]["share_explained"] == pytest.approx(1.0, abs=0.05)
    assert table["repaired"]["rmse"] == pytest.approx(0.1)
    at_floor = fit_table(data, ["y"], {"refitted": (y - noise)[:, None], "repaired": (y - noise)[:, None]},
                         np.array([0.1]))["r.csv"]["y"]
    assert np.isnan(at_floor["repaired"]["share_explained"])  # nothing was explainable
