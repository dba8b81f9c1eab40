"""The noise model: the autoregression that turns a residual into innovations.

An unmeasured force leaves a residual that is coloured by the plant. Its squared error says little: a slow wave in
it weighs as much as thousands of independent samples. Filtered by its own autoregression it becomes white, and sums
of squared innovations can be compared as log-likelihoods, with every sample counting once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["NoiseModel", "fit_noise"]

ORDERS = (0, 1, 2, 3, 4, 6, 8, 12, 16)


@dataclass(frozen=True)
class NoiseModel:
    """Per output: coefficients a of e[k] = r[k] - a_1 r[k-1] - ... and the innovations' variance."""

    coefficients: tuple[np.ndarray, ...]
    variance: np.ndarray

    def innovations(self, residual, segments) -> np.ndarray:
        """Innovations in units of their standard deviation; zero where a segment's past is too short.

        `residual` is (N, ny), or (N, ny, n) for n signals at once; so is what comes back.
        """
        e = np.zeros_like(residual)
        for k, a in enumerate(self.coefficients):
            p = len(a)
            for first, last in np.asarray(segments)[:, :2]:
                r = residual[first:last, k]
                if len(r) > p:
                    e[first + p:last, k] = r[p:] - sum(c * r[p - i - 1:len(r) - i - 1] for i, c in enumerate(a))
        return e / np.sqrt(self.variance).reshape(-1, *[1] * (e.ndim - 2))


def _past(r, p):
    """The p values before each of r[p:], (len(r) - p, p), latest first."""
    return np.column_stack([r[p - i - 1:len(r) - i - 1] for i in range(p)]) if p else np.zeros((len(r), 0))


def _regression(r, segments, p):
    """Rows of past and present over all segments."""
    parts = [r[first:last] for first, last in np.asarray(segments)[:, :2] if last - first > 2 * p + 4]
    if not parts:
        return np.zeros((0, p)), np.zeros(0)
    return np.vstack([_past(s, p) for s in parts]), np.concatenate([s[p:] for s in parts])


def fit_noise(residual, segments) -> NoiseModel:
    """Autoregression of every output's residual, its order by BIC over ORDERS.

    Parameters
    ----------
    residual : (N, ny), in the outputs' units. segments : (n, 2 or more) first and last+1 sample.
    """
    coefficients, variance = [], []
    for k in range(residual.shape[1]):
        best = None
        for p in ORDERS:
            past, now = _regression(residual[:, k], segments, p)
            if len(now) < 10 * (p + 1):
                break
            a = np.linalg.lstsq(past, now, rcond=None)[0] if p else np.zeros(0)
            v = float(np.mean((now - past @ a) ** 2)) + 1e-300
            bic = len(now) * np.log(v) + (p + 1) * np.log(len(now))
            if best is None or bic < best[0]:
                best = bic, a, v
        a, v = (best[1], best[2]) if best else (np.zeros(0), float(np.mean(residual[:, k] ** 2)) + 1e-300)
        coefficients.append(a)
        variance.append(v)
    return NoiseModel(tuple(coefficients), np.array(variance))
