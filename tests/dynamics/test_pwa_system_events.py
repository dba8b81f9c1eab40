"""First crossings of polynomials: certified against roots found by another route."""

import numpy as np
import pytest

from pwaid.dynamics.events import DEGREE, NO_CROSSING, clear_start, entry_sign, first_crossing


def poly(*roots, scale=1.0, sign=1.0):
    c = np.zeros(DEGREE + 1)
    c[: len(roots) + 1] = sign * scale * np.polynomial.polynomial.polyfromroots(roots)
    return c


@pytest.mark.parametrize("seed", range(40))
def test_first_crossing_agrees_with_companion_roots(seed):
    rng = np.random.default_rng(seed)
    c = np.zeros(DEGREE + 1)
    degree = rng.integers(1, 9)
    c[: degree + 1] = rng.standard_normal(degree + 1)
    c[0] = abs(c[0])
    roots = np.polynomial.polynomial.polyroots(c[: degree + 1])
    real = np.sort(roots[np.abs(roots.imag) < 1e-12].real)
    inside = real[(real > 0) & (real <= 1)]
    s = first_crossing(c, 1e-13)
    assert s == pytest.approx(inside[0] if inside.size else NO_CROSSING, abs=1e-9)


@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-6])
def test_two_crossings_close_together_are_not_missed(width):
    c = poly(0.37, 0.37 + width)
    assert first_crossing(c, 1e-15) == pytest.approx(0.37, abs=1e-8)


def test_a_dip_that_does_not_reach_the_guard_is_no_crossing():
    c = poly(0.5, 0.5)
    c[0] += 1e-6
    assert first_crossing(c, 1e-13) == NO_CROSSING


def test_a_motion_along_the_guard_never_ends():
    assert first_crossing(np.zeros(DEGREE + 1), 1e-13) == NO_CROSSING


def test_a_start_on_the_guard_is_decided_by_the_first_coefficient_that_counts():
    c = np.zeros(DEGREE + 1)
    c[0], c[1], c[2], c[3] = -1e-16, 3e-17, 1.0, -2.0
    assert entry_sign(c, 1e-13) == 1
    assert entry_sign(-c, 1e-13) == -1
    clear_start(c, 1e-13)
    assert c[0] == 0.0 and c[1] == 0.0 and c[2] == 1.0
    assert first_crossing(c, 1e-13) == pytest.approx(0.5, abs=1e-14)
    assert first_crossing(-c, 1e-13) == 0.0
