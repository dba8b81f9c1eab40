"""Two positions on one shaft move together; the sizes of forces must not take them as independent."""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.probing import _joined_motion


def test_range_of_a_joined_position_is_what_the_other_leaves_open():
    rng = np.random.default_rng(0)
    angle, twist = rng.uniform(-1, 1, 400), 0.01 * rng.uniform(-1, 1, 400)
    states = np.column_stack([angle + twist, rng.normal(size=400), angle, rng.normal(size=400)])
    low, high = states.min(axis=0), states.max(axis=0)
    points = [(low, np.zeros(1)), (high, np.zeros(1))]
    kinds = ("position", "velocity", "position", "velocity")
    visited, least, most = _joined_motion(points, states, kinds, low, high)
    assert 0.015 < most[0] - least[0] < 0.025 and 0.015 < most[2] - least[2] < 0.025
    assert (least[1], most[1]) == (low[1], high[1])
    assert all(any(np.array_equal(x, row) for row in states) for x, _ in visited)


def test_a_single_position_keeps_its_range():
    states = np.random.default_rng(1).normal(size=(100, 2))
    low, high = states.min(axis=0), states.max(axis=0)
    points = [(low, np.zeros(1))]
    assert _joined_motion(points, states, ("position", "velocity"), low, high) == (points, low, high)
