"""BFT, VAF and FIT on cases with known answers."""

import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.hinfstruct import bft, interpolation_fit, vaf

Y = np.array([[0.0, 1.0], [2.0, 3.0], [4.0, 8.0]])


def test_perfect_mean_and_shifted():
    assert bft(Y, Y) == pytest.approx([100, 100])
    assert bft(Y, np.broadcast_to(Y.mean(axis=0), Y.shape)) == pytest.approx([0, 0])
    assert vaf(Y, Y + 5.0) == pytest.approx([100, 100])  # VAF does not see an offset
    assert np.all(bft(Y, Y + 50.0) == 0)  # BFT does, and is clipped
    half = Y.mean(axis=0) + 0.5 * (Y - Y.mean(axis=0))
    assert bft(Y, half) == pytest.approx([50, 50])
    assert vaf(Y, half) == pytest.approx([75, 75])
    assert isinstance(bft(Y[:, 0], Y[:, 0]), float)


def test_divergence_scores_zero():
    assert bft(Y, np.full_like(Y, np.inf)).tolist() == [0, 0]


def test_interpolation_fit():
    eta = np.array([1.0, 2.0, 3.0])
    assert interpolation_fit(eta, eta) == 100
    assert interpolation_fit(
        eta, eta + np.array([1.0, 0.0, 0.0])
    ) == pytest.approx(100 * (1 - 1 / np.sqrt(2)))
    assert interpolation_fit(np.ones(3), np.ones(3)) == 100


@pytest.mark.parametrize("measure", [bft, vaf])
def test_bad_input(measure):
    with pytest.raises(InputError, match="same shape"):
        measure(Y, Y[:2])
    with pytest.raises(InputError, match="NaN"):
        measure(np.full((3, 1), np.nan), np.zeros((3, 1)))
    with pytest.raises(InputError, match="constant"):
        measure(np.ones((3, 1)), np.zeros((3, 1)))
