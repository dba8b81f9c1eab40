"""A known disturbance of a known linear plant comes back, and the likelihood says where it entered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pwaid.mismatch import smoother
from pwaid.mismatch.smoother import Linearised, smooth

A = np.array([[0.0, 1.0, 0.0, 0.0], [-5.0, -0.4, 3.0, 0.1], [0.0, 0.0, 0.0, 1.0], [6.0, 0.2, -6.0, -0.5]])
COLUMNS = {"motor": np.array([0.0, 1.0, 0.0, 0.0]), "load": np.array([0.0, 0.0, 0.0, 2.0])}
H, N = 0.02, 1500


def plant(noise=1e-3):
    """Two masses, both positions measured."""
    C = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]])
    def stack(M):
        return np.ascontiguousarray(np.repeat(M[None], N, axis=0))

    return Linearised(np.zeros((N, 4)), np.zeros((N, 1)), np.zeros((N, 2)), stack(A), np.zeros((N, 4, 1)), stack(C),
                      np.zeros((N, 2, 1)), np.array([[0, N]]), np.arange(N) * H, np.full(2, noise), H)


def driven(line, column, d, rng):
    F, B = line.transition(np.tile(column, (N, 1)))
    x, Y, X = np.array([0.05, 0.0, -0.02, 0.1]), np.empty((N, 2)), np.empty((N, 4))
    for k in range(N):
        X[k], Y[k] = x, line.C[k] @ x
        x = F[k] @ x + B[k] * d[k]
    return replace(line, residual=Y + line.noise * rng.normal(size=Y.shape)), X


@pytest.mark.parametrize("place", COLUMNS)
def test_disturbance_is_recovered_and_its_place_found(place):
    t = np.arange(N) * H
    d = np.sin(1.3 * t) + 0.5 * np.sin(4.1 * t + 1)
    line, X = driven(plant(), COLUMNS[place], d, np.random.default_rng(3))
    got = {name: smooth(line, np.tile(column, (N, 1)), np.zeros((N, 2)), 1.0, np.ones(4), 1.0, name)
           for name, column in COLUMNS.items()}
    right = got[place]
    inner = slice(40, -40)
    error = (right.value - d)[inner]
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.std(d)
    assert np.mean(np.abs(error) < 2 * right.deviation[inner]) > 0.8  # the posterior band is honest
    np.testing.assert_allclose(right.states[inner], X[inner], atol=0.05)
    assert max(got, key=lambda name: got[name].log_likelihood) == place


def test_filter_agrees_with_batch_least_squares(monkeypatch):
    """Smoothing is a Gaussian posterior mean: the dense normal equations give the same d."""
    n, a, r, q = 30, 0.9, 0.1, 0.04
    rng = np.random.default_rng(0)
    y = rng.normal(size=n)
    line = Linearised(np.zeros((n, 1)), np.zeros((n, 1)), y[:, None], np.full((n, 1, 1), a - 1), np.zeros((n, 1, 1)),
                      np.ones((n, 1, 1)), np.zeros((n, 1, 1)), np.array([[0, n]]), np.arange(n) * 1.0,
                      np.array([r]), 1.0, True)
    scale = np.sqrt(q)
    monkeypatch.setattr(smoother, "GRID", np.array([1.0]))
    got = smooth(line, np.ones((n, 1)), np.zeros((n, 1)), scale, np.ones(1), 1.0)
    rows, right = [np.r_[1.0, np.zeros(n)], np.r_[0.0, 1 / (10 * scale), np.zeros(n - 1)]], [0.0, 0.0]
    for k in range(n):  # unknowns: x0, d[0..n-1]
        row = np.zeros(n + 1)
        row[0] = a**k
        row[1:k + 1] = a ** np.arange(k - 1, -1, -1)
        rows.append(row / r)
        right.append(y[k] / r)
        if k:
            row = np.zeros(n + 1)
            row[k], row[k + 1] = -1, 1
            rows.append(row / np.sqrt(q))
            right.append(0.0)
    M = np.array(rows)
    np.testing.assert_allclose(got.value, np.linalg.lstsq(M, np.array(right), rcond=None)[0][1:], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(got.deviation, np.sqrt(np.diag(np.linalg.inv(M.T @ M))[1:]), rtol=1e-5)


def test_a_jump_is_smeared_over_the_reported_rise():
    d = np.where(np.arange(N) < N // 2, -1.0, 1.0)
    line, _ = driven(plant(), COLUMNS["motor"], d, np.random.default_rng(1))
    got = smooth(line, np.tile(COLUMNS["motor"], (N, 1)), np.zeros((N, 2)), 1.0, np.ones(4), 1.0)
    assert 0 < got.rise < 1.0
    far = np.abs(np.arange(N) - N // 2) * H > 2 * got.rise
    far[:40] = far[-40:] = False
    np.testing.assert_allclose(got.value[far], d[far], atol=0.5)
