"""Smooth stages of the restructuring:

Levenberg-Marquardt on a frequency grid, then L-BFGS on the squared norm.
"""

from __future__ import annotations

import numpy as np
import scipy.optimize

from pwaid.hinfstruct.problem import MatchingProblem

__all__ = ["lbfgs", "levenberg_marquardt", "parameter_scale"]


def parameter_scale(theta: np.ndarray) -> np.ndarray:
    """Size of each parameter; a thousandth of the median for those that are zero beside it, so that they keep a
    sensible step. A mass of 2 kg beside stiffnesses of 1e5 N/m is not zero."""
    size = np.abs(theta)
    middle = float(np.median(size))
    return np.where(size > 1e-6 * middle, size, max(1e-3 * middle, 1e-12))


def levenberg_marquardt(
    problem: MatchingProblem, theta: np.ndarray, *, omega: np.ndarray | None = None, max_iterations: int = 200
) -> np.ndarray:
    """Minimise the squared error summed over a frequency grid (analytic Jacobian; bounds respected).

    Returns the last theta; it may be unstable when the start was far away, which the caller checks.
    """
    omega = problem.grid() if omega is None else np.asarray(omega, dtype=float)
    low, high = problem.bounds
    free = not (np.isfinite(low).any() or np.isfinite(high).any())
    scale = parameter_scale(theta)

    def residual(z):
        with np.errstate(all="ignore"):
            found = problem.residual(z * scale, omega) / problem.gain
            return np.nan_to_num(found, nan=1e6, posinf=1e6, neginf=-1e6)

    def jacobian(z):
        with np.errstate(all="ignore"):
            return np.nan_to_num(
                problem.residual(z * scale, omega, derivative=True) * scale / problem.gain, posinf=1e6, neginf=-1e6
            )

    options = {"xtol": 1e-13, "ftol": 1e-13, "gtol": 1e-13, "max_nfev": max_iterations}
    try:
        if free:
            run = scipy.optimize.least_squares(
                residual, theta / scale, jac=jacobian, method="lm", x_scale="jac", **options
            )
        else:
            start = np.clip(theta, low + 1e-9 * scale, high - 1e-9 * scale)
            run = scipy.optimize.least_squares(
                residual, start / scale, jac=jacobian, method="trf", x_scale="jac",
                bounds=(low / scale, high / scale), **options,
            )
    except np.linalg.LinAlgError:
        return theta
    return run.x * scale


def lbfgs(problem: MatchingProblem, theta: np.ndarray, *, max_iterations: int = 150) -> np.ndarray:
    """L-BFGS on F = ||error||_inf² with the gradient at the highest peak (remark 2 of Vizer et al. 2014).

    F is not smooth, so this stops at a kink; an unstable trial counts as a large value. Returns the best
    stable theta.
    """
    scale = parameter_scale(theta)
    best_value, best = problem.value(theta), theta
    if not np.isfinite(best_value):
        return theta
    wall = 1e3 * best_value**2

    def cost(z):
        nonlocal best_value, best
        found = problem.active(z * scale, 1 - 1e-9)
        if found is None:
            return wall, np.zeros_like(z)
        value, active = found
        if value < best_value:
            best_value, best = value, z * scale
        return value**2, 2 * value * active.gradients()[0] * scale

    bounds = [(lo / s, hi / s) for lo, hi, s in zip(*problem.bounds, scale, strict=True)]
    scipy.optimize.minimize(
        cost, theta / scale, jac=True, method="L-BFGS-B", bounds=bounds, options={
            "maxiter": max_iterations, "maxcor": 20
        }
    )
    return best
