"""Joint fits of an LPV model to all operating points at once, instead of restructuring first and
interpolating after.

* `fit_lpv_minimax`: minimise over polynomial coefficients the worst H-infinity error over the operating
  points, max_i || G(s, sum_k c_k kappa_i^k) - target_i ||_inf.
* `fit_inertia`: the physics-structured fit M(kappa) = M0 + kappa M1 (`InertiaStructure`), one small parameter
  vector.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pwaid.errors import InputError, SolverError
from pwaid.hinfstruct.inertia import InertiaLPV, InertiaStructure
from pwaid.hinfstruct.lpv import LPVModel, fit_polynomial
from pwaid.hinfstruct.norm import HinfNorm, hinf_norm
from pwaid.hinfstruct.problem import MatchingProblem
from pwaid.hinfstruct.proxlinear import prox_linear
from pwaid.hinfstruct.smooth import levenberg_marquardt
from pwaid.hinfstruct.statespace import as_matrices, difference, freeze
from pwaid.hinfstruct.structured import Parameter, StructuredModel

__all__ = ["InertiaFit", "LPVFit", "fit_inertia", "fit_lpv_minimax", "lpv_errors", "polynomial_models"]


@dataclass(frozen=True)
class LPVFit:
    """A joint polynomial fit.

    Attributes
    ----------
    lpv : LPVModel
    coefficients : array, shape (degree + 1, size)
        theta(kappa) in increasing powers.
    norms : tuple of HinfNorm
        Error at each operating point; ``worst`` is their maximum.
    two_step_worst, least_squares_worst : float
        The same maximum for interpolation of the given local theta, and for the joint least-squares fit (the
        start).
    converged : bool
    predicted_decrease : float
    """

    lpv: LPVModel
    coefficients: np.ndarray
    norms: tuple[HinfNorm, ...]
    two_step_worst: float
    least_squares_worst: float
    converged: bool
    predicted_decrease: float

    def __post_init__(self):
        freeze(self)

    @property
    def worst(self) -> float:
        return max(n.value for n in self.norms)


@dataclass(frozen=True)
class InertiaFit:
    """A joint physics-structured fit.

    Attributes
    ----------
    model : InertiaLPV
    parameters : dict of str to float
        In the torque unit of the structure's first gain.
    norms : tuple of HinfNorm
        H-infinity error at each operating point.
    """

    model: InertiaLPV
    parameters: dict[str, float]
    norms: tuple[HinfNorm, ...]

    @property
    def worst(self) -> float:
        return max(n.value for n in self.norms)


def polynomial_models(model: StructuredModel, kappas, degree: int) -> list[StructuredModel]:
    """The structured model at each kappa as a function of the stacked coefficients (degree + 1) * size.

    kappa is mapped to [-1, 1] and Legendre polynomials are used inside, which keeps the coefficients
    comparable.
    """
    kappas = np.asarray(kappas, dtype=float)
    basis = np.polynomial.legendre.legvander(_unit(kappas, kappas), degree)
    parameters = [Parameter(f"{p.name}_{k}") for k in range(degree + 1) for p in model.parameters]

    def at(row):
        spread = np.kron(row, np.eye(model.size))
        return model.reparametrise(parameters, lambda c: spread @ c, lambda c: spread)

    return [at(row) for row in basis]


def _unit(x, kappas):
    low, high = np.min(kappas), np.max(kappas)
    return (2 * np.asarray(x, dtype=float) - low - high) / (high - low)


def fit_lpv_minimax(
    model: StructuredModel, kappas, targets: Sequence, local_thetas, degree: int, *, max_iterations: int = 60
) -> LPVFit:
    """Joint minimax fit of a polynomial LPV model.

    Parameters
    ----------
    model : StructuredModel
        Affine pattern.
    kappas : array, shape (k,)
    targets : sequence of k black-box models
    local_thetas : array, shape (k, size)
        Restructured parameters: their interpolation is the two-step result and the start.
    degree : int
    max_iterations : int
        Of the prox-linear method.

    Returns
    -------
    LPVFit; the error norms are recomputed from the returned model.

    Raises
    ------
    InputError
        Numbers of points differ, or too high a degree.
    SolverError
        Neither the interpolation nor the joint least-squares fit is stable at all points.
    """
    kappas, local = np.asarray(kappas, dtype=float), np.asarray(local_thetas, dtype=float)
    if local.shape != (kappas.size, model.size) or len(targets) != kappas.size:
        raise InputError(
            f"{kappas.size} kappas, {len(targets)} targets, local_thetas {local.shape}: expected one target "
            "and one theta of "
            f"length {model.size} per kappa"
        )
    fit_polynomial(kappas, local, degree)  # checks the degree
    problem = MatchingProblem.build(polynomial_models(model, kappas, degree), targets)
    basis = np.polynomial.legendre.legvander(_unit(kappas, kappas), degree)
    two_step = np.linalg.lstsq(basis, local, rcond=None)[0].ravel()
    least_squares = levenberg_marquardt(problem, two_step)
    values = [problem.value(two_step), problem.value(least_squares)]
    if not np.isfinite(values).any():
        raise SolverError(
            "the interpolated model is unstable at an operating point; lower the degree or add points"
        )
    start = (two_step, least_squares)[int(np.argmin(values))]
    # of each theta; its higher coefficients are smaller
    size = np.abs(two_step.reshape(degree + 1, -1)).max(axis=0)
    run = prox_linear(problem, start, max_iterations=max_iterations, scale=np.tile(size, degree + 1))
    legendre = run.theta.reshape(degree + 1, model.size)
    coefficients = _to_powers(legendre, kappas)
    lpv = LPVModel.from_parameters(model, coefficients, (float(kappas.min()), float(kappas.max())))
    norms = lpv_errors(lpv, kappas, problem.targets)
    return LPVFit(lpv, coefficients, norms, float(values[0]), float(values[1]), run.converged, run.predicted)


def lpv_errors(lpv, kappas, targets) -> tuple[HinfNorm, ...]:
    """H-infinity error of an LPV model (anything with ``matrices(kappa)``) at each operating point.

    Raises
    ------
    InputError
        The model is unstable at one of them.
    """
    pairs = [
        (lpv.matrices(float(k)), as_matrices(t, f"target {i}"))
        for i, (k, t) in enumerate(zip(kappas, targets, strict=True))
    ]
    return tuple(hinf_norm(difference(mine, target)) for mine, target in pairs)


def _to_powers(legendre: np.ndarray, kappas) -> np.ndarray:
    """Legendre coefficients on the unit interval to powers of kappa."""
    degree = len(legendre) - 1
    nodes = np.linspace(np.min(kappas), np.max(kappas), degree + 1) if degree else np.array([np.mean(kappas)])
    values = np.polynomial.legendre.legvander(_unit(nodes, kappas), degree) @ legendre
    return np.linalg.solve(np.vander(nodes, degree + 1, increasing=True), values)


def fit_inertia(
    structure: InertiaStructure, kappas, targets: Sequence, local_thetas=None, *, start=None
) -> InertiaFit:
    """Joint Levenberg-Marquardt fit of M0, M1, stiffnesses and gains to the black-box models of all operating
    points.

    Parameters
    ----------
    structure : InertiaStructure
    kappas, targets : arrays and models, one per operating point
    local_thetas : sequence of arrays, optional
        Restructured theta of (32), for the closed-form start; or give ``start``.
    start : array, optional
        Parameter vector, in the order of ``structure.names``.

    Raises
    ------
    InputError
        Neither start nor local_thetas.
    SolverError
        The fit ended unstable.
    """
    if start is None:
        if local_thetas is None:
            raise InputError("fit_inertia needs local_thetas (for its closed-form start) or start=")
        start = structure.start(kappas, local_thetas)
    problem = MatchingProblem.build([structure.structured(float(k)) for k in kappas], targets)
    p = levenberg_marquardt(problem, np.asarray(start, dtype=float))
    norms = problem.norms(p)
    if norms is None:
        raise SolverError("the joint fit ended in an unstable model; give a start= near the physical values")
    return InertiaFit(
        structure.unpack(p), dict(zip(structure.names, map(float, p), strict=True)), tuple(norms)
    )
