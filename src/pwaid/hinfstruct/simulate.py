"""Simulation of continuous LPV models along a scheduling trajectory:

Runge-Kutta 4, inputs held between samples.
"""

from __future__ import annotations

import numba
import numpy as np

from pwaid.errors import InputError
from pwaid.hinfstruct.statespace import initial_state

__all__ = ["check_trajectory", "simulate_lpv"]


def check_trajectory(time, inputs, schedule, n_inputs: int, name: str = "kappa"):
    """Time (N,), inputs (N, n_inputs) and schedule (N,) as float arrays on a uniform grid."""
    time = np.asarray(time, dtype=float)
    inputs = np.array(inputs, dtype=float, order="C")  # copies: one compiled signature, read-only or not
    schedule = np.array(schedule, dtype=float, order="C")
    inputs = inputs.reshape(len(inputs), -1)
    fits = inputs.shape == (time.size, n_inputs) and schedule.shape == time.shape
    if time.ndim != 1 or time.size < 2 or not fits:
        raise InputError(
            f"time {time.shape}, inputs {inputs.shape}, {name} {schedule.shape}: expected (N,), (N, "
            f"{n_inputs}), (N,), N >= 2"
        )
    if not (np.isfinite(time).all() and np.isfinite(inputs).all() and np.isfinite(schedule).all()):
        raise InputError(
            f"time, inputs or {name} contain NaN or infinite values; cut or interpolate them first"
        )
    steps = np.diff(time)
    if steps.min() <= 0 or np.ptp(steps) > 1e-6 * steps.mean():
        raise InputError("time is not increasing with a constant step; resample the recording first")
    return time, inputs, schedule


def simulate_lpv(stacked, time, inputs, kappa, *, x0=None, substeps: int = 1) -> np.ndarray:
    """Outputs (N, ny) of dx/dt = A(kappa(t)) x + B(kappa(t)) u, y = C(kappa) x + D(kappa) u.

    Parameters
    ----------
    stacked : callable
        ``kappa (k,) -> (A, B, C, D)`` stacked along axis 0.
    time, inputs, kappa : arrays, shapes (N,), (N, nu), (N,)
        Uniform sampling; inputs are held, kappa is interpolated linearly.
    x0 : array, optional
    substeps : int
        Runge-Kutta steps per sample.

    Returns
    -------
    array (N, ny); a diverging model gives inf or nan from there on (its fit is 0).

    Raises
    ------
    InputError
        Bad arrays, or a step too long for the fastest pole (Runge-Kutta 4 would be unstable).
    """
    kappa = np.asarray(kappa, dtype=float)
    _, B, _, _ = stacked(np.ravel(kappa)[:1])
    time, inputs, kappa = check_trajectory(time, inputs, kappa, B.shape[2])
    if substeps < 1:
        raise InputError(f"substeps = {substeps}; expected at least 1")
    dt = (time[1] - time[0]) / substeps
    ends = stacked(np.array([kappa.min(), np.median(kappa), kappa.max()]))
    fastest = np.abs(np.linalg.eigvals(ends[0])).max() if ends[0].shape[1] else 0.0
    if fastest * dt > 2.5:
        raise InputError(
            f"the step {dt:.3g} s is too long for a pole of {fastest:.3g} rad/s; pass substeps >= "
            f"{int(np.ceil(fastest * dt * substeps / 1.5))}"
        )
    fine = np.interp(
        np.arange((time.size - 1) * 2 * substeps + 1) * dt / 2, time - time[0], kappa
    )
    A, B, C, D = stacked(fine)
    start = initial_state(x0, A.shape[1])
    states = _runge_kutta(A, B, inputs, dt, substeps, start)
    every = slice(None, None, 2 * substeps)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.einsum("kyn,kn->ky", C[every], states) + np.einsum("kyu,ku->ky", D[every], inputs)


@numba.njit(cache=True)
def _rate(A, B, x, u, out):
    for i in range(x.size):
        total = 0.0
        for j in range(x.size):
            total += A[i, j] * x[j]
        for j in range(u.size):
            total += B[i, j] * u[j]
        out[i] = total


@numba.njit(cache=True)
def _runge_kutta(A, B, inputs, dt, substeps, x0):
    n_samples = inputs.shape[0]
    n = x0.size
    states = np.empty((n_samples, n))
    x = x0.copy()
    k1, k2, k3, k4 = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for k in range(n_samples):
        states[k] = x
        if k == n_samples - 1:
            break
        for s in range(substeps):
            at = 2 * (k * substeps + s)
            _rate(A[at], B[at], x, inputs[k], k1)
            _rate(A[at + 1], B[at + 1], x + 0.5 * dt * k1, inputs[k], k2)
            _rate(A[at + 1], B[at + 1], x + 0.5 * dt * k2, inputs[k], k3)
            _rate(A[at + 2], B[at + 2], x + dt * k3, inputs[k], k4)
            x = x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return states
