"""Numbers in the text summary show what their intervals support."""

from __future__ import annotations

import pytest

from pwaid.mismatch.summary import with_interval


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
