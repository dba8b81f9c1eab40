"""Segments of recordings and their openings."""

from __future__ import annotations

import numpy as np
from tests_support import record

from pwaid.mismatch.dataset import Dataset

DATA = Dataset.from_recordings([record(1, samples=90), record(2, samples=60)])


def test_openings_are_the_first_samples_of_every_segment():
    cut = DATA.cut(40)
    assert cut.segments.tolist() == [[0, 45, 0, 90], [45, 90, 0, 90], [90, 120, 90, 150], [120, 150, 90, 150]]
    first = cut.openings(25)
    for (a, b, c, d, ran), (start, end, begin, _) in zip(first.segments, cut.segments, strict=True):
        assert (a, b, ran) == (c, d, start - begin)
        assert b - a == min(25, end - start)
        np.testing.assert_array_equal(first.Y[a:b], cut.Y[start:start + b - a])
        np.testing.assert_array_equal(first.U[a:b], cut.U[start:start + b - a])
    assert len(first.Y) == first.segments[-1, 1]
