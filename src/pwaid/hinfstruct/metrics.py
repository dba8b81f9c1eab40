"""Fit figures of Vizer et al.

(2014): BFT and VAF (33), FIT of an interpolation (36). All in percent, time along axis 0.
"""

from __future__ import annotations

import numpy as np

from pwaid.errors import InputError

__all__ = ["bft", "interpolation_fit", "vaf"]


def _pair(measured, simulated) -> tuple[np.ndarray, np.ndarray]:
    y, y_hat = np.asarray(measured, dtype=float), np.asarray(simulated, dtype=float)
    if y.shape != y_hat.shape or y.ndim not in (1, 2) or y.shape[0] < 2:
        raise InputError(
            f"measured has shape {y.shape} and simulated {y_hat.shape}; expected two arrays of the same "
            "shape "
            "(N,) or (N, outputs) with N >= 2; pass both signals on the same time grid"
        )
    if not np.isfinite(y).all():
        raise InputError("measured contains NaN or infinite values; remove or fill these samples first")
    if np.any(np.ptp(y, axis=0) == 0):
        raise InputError(
            "a measured output is constant, so a fit relative to its variation is not defined; leave it out"
        )
    return y, y_hat


def bft(measured, simulated):
    """Best fit rate (33a): 100 max(1 - ||y - y_hat|| / ||y - mean y||, 0), per output.

    A diverged simulation (NaN or infinite) scores 0.

    Parameters
    ----------
    measured, simulated : array, shape (N,) or (N, outputs)

    Returns
    -------
    float or array, shape (outputs,), percent

    Raises
    ------
    InputError
        Shapes differ, the measured signal is not finite, or one of its columns is constant.
    """
    y, y_hat = _pair(measured, simulated)
    with np.errstate(over="ignore", invalid="ignore"):
        ratio = np.linalg.norm(y - y_hat, axis=0) / np.linalg.norm(y - y.mean(axis=0), axis=0)
    return _percent(ratio)


def vaf(measured, simulated):
    """Variance accounted for (33b):

    100 max(1 - var(y - y_hat) / var(y), 0), per output; arguments as in `bft`.
    """
    y, y_hat = _pair(measured, simulated)
    with np.errstate(over="ignore", invalid="ignore"):
        ratio = np.var(y - y_hat, axis=0) / np.var(y, axis=0)
    return _percent(ratio)


def interpolation_fit(eta, eta_hat) -> float:
    """FIT (36) between local coefficients and their interpolation, percent; not clipped at zero.

    All entries are taken together with one scalar mean, as printed, so entries of 1e5 dominate entries of 1.
    Coefficients that are all equal return 100 when reproduced exactly and -inf otherwise.
    """
    eta, eta_hat = np.ravel(np.asarray(eta, dtype=float)), np.ravel(np.asarray(eta_hat, dtype=float))
    if eta.shape != eta_hat.shape or eta.size == 0:
        raise InputError(
            f"eta has {eta.size} entries and eta_hat {eta_hat.size}; expected the same number, at least one"
        )
    miss, spread = np.linalg.norm(eta - eta_hat), np.linalg.norm(eta - eta.mean())
    if spread == 0:
        return 100.0 if miss == 0 else -np.inf
    return float(100 * (1 - miss / spread))


def _percent(ratio):
    value = 100 * np.clip(1 - np.nan_to_num(ratio, nan=np.inf), 0.0, None)
    return float(value) if np.ndim(value) == 0 else value
