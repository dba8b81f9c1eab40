"""Output-error polish: refine the parameters of a structured model on the recordings themselves.

    minimise over theta   sum_k |y(k) - y_model(k)|²,   model discretised with the hold of
    the inputs, starting at rest.

For white measurement noise this is maximum likelihood; start it from the restructured theta.
Levenberg-Marquardt with exact sensitivities (Frechet derivatives of the matrix exponential).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize

from pwaid.errors import InputError, SolverError
from pwaid.hinfstruct.smooth import parameter_scale
from pwaid.hinfstruct.statespace import Matrices, freeze, simulate_discrete, simulate_states
from pwaid.hinfstruct.structured import StructuredModel

__all__ = ["Polished", "polish_output_error"]


@dataclass(frozen=True)
class Polished:
    """Result of the output-error polish.

    Attributes
    ----------
    theta : array
    rmse : array, shape (outputs,)
    rmse_start : array, shape (outputs,)
    standard_error : array
        Of theta, from the Jacobian and the residual, valid for white noise.
    """

    theta: np.ndarray
    rmse: np.ndarray
    rmse_start: np.ndarray
    standard_error: np.ndarray

    def __post_init__(self):
        freeze(self)


def polish_output_error(
    model: StructuredModel, theta, inputs, outputs, dt: float, *, max_iterations: int = 30
) -> Polished:
    """Refine theta on one recording (inputs (N, nu) held between samples, outputs (N, ny)), starting at rest.

    Raises
    ------
    InputError
        Shapes, NaN, too few samples, or an unstable start.
    SolverError
        The iteration left the stable region.
    """
    theta = model.check(theta)
    inputs, outputs = np.asarray(inputs, dtype=float), np.asarray(outputs, dtype=float)
    m = model.matrices(theta)
    fits = inputs.ndim == 2 and inputs.shape[1] == m.B.shape[1] and outputs.shape == (len(inputs), len(m.C))
    if not fits:
        raise InputError(
            f"inputs {inputs.shape} and outputs {outputs.shape}; expected (N, {m.B.shape[1]}) and (N, "
            f"{len(m.C)})"
        )
    if not (np.isfinite(inputs).all() and np.isfinite(outputs).all()):
        raise InputError("inputs or outputs contain NaN or infinite values; cut or interpolate them first")
    if outputs.size <= theta.size or not dt > 0:
        raise InputError(
            f"{outputs.size} output samples for {theta.size} parameters at dt = {dt}: too few, or a bad dt"
        )
    if not m.stable:
        raise InputError("the model is unstable at the starting theta; restructure first")
    scale = parameter_scale(theta)
    weight = 1 / outputs.std(axis=0)

    def residual(z):
        with np.errstate(all="ignore"):
            simulated = simulate_discrete(_hold(model.matrices(z * scale), dt), inputs)
        return np.nan_to_num(((simulated - outputs) * weight).ravel(), nan=1e6, posinf=1e6, neginf=-1e6)

    def jacobian(z):
        return (
            _sensitivities(model, z * scale, inputs, dt) * weight[None, :, None]
        ).reshape(outputs.size, -1) * scale

    low, high = model.bounds
    bounds = (low / scale, high / scale)
    run = scipy.optimize.least_squares(
        residual, theta / scale, jac=jacobian, bounds=bounds, x_scale="jac",
        max_nfev=max_iterations, xtol=1e-12, ftol=1e-12,
    )
    polished = run.x * scale
    if not model.matrices(polished).stable:
        raise SolverError(
            "the polish ended in an unstable model; the recording may be too short or the structure wrong"
        )
    rmse = [
        np.sqrt(np.mean((residual(z).reshape(outputs.shape) / weight) ** 2, axis=0))
        for z in (run.x, theta / scale)
    ]
    J = jacobian(run.x)
    covariance = np.linalg.pinv(J.T @ J) * 2 * run.cost / max(outputs.size - theta.size, 1)
    return Polished(polished, rmse[0], rmse[1], np.sqrt(np.diag(covariance)) * scale)


def _hold(m: Matrices, dt: float) -> Matrices:
    n, nu = m.B.shape
    block = scipy.linalg.expm(np.block([[m.A, m.B], [np.zeros((nu, n + nu))]]) * dt)
    return Matrices(block[:n, :n], block[:n, n:], m.C, m.D, dt)


def _sensitivities(model: StructuredModel, theta: np.ndarray, inputs: np.ndarray, dt: float) -> np.ndarray:
    """d y / d theta, shape (N, ny, size)."""
    m = model.matrices(theta)
    dA, dB, dC, dD = model.differentiate(theta)
    n, nu = m.B.shape
    block = np.block([[m.A, m.B], [np.zeros((nu, n + nu))]]) * dt
    held = _hold(m, dt)
    states = simulate_states(held.A, inputs @ held.B.T, np.zeros(n))
    out = np.empty((len(inputs), len(m.C), theta.size))
    for k in range(theta.size):
        change = np.zeros_like(block)
        change[:n, :n], change[:n, n:] = dA[k] * dt, dB[k] * dt
        slope = scipy.linalg.expm_frechet(block, change, compute_expm=False)
        drive = states @ slope[:n, :n].T + inputs @ slope[:n, n:].T
        moved = simulate_states(held.A, drive, np.zeros(n))
        out[:, :, k] = moved @ m.C.T + states @ dC[k].T + inputs @ dD[k].T
    return out
