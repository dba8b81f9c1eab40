"""Model matching: make structured models equal to given ones in the H-infinity norm.

    minimise over theta   F(theta)^(1/2) = max_i || G_i(s, theta) - target_i(s) ||_inf        (paper 002, eq.
    6, 14)

One operating point is the case of a single pair; several pairs that share theta give the joint fit of an LPV
model. This file holds the problem: values, derivatives (24)-(25), active frequencies, and two certificates, a
lower bound from what the structure cannot change and a stationarity measure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.optimize

from pwaid.errors import InputError
from pwaid.hinfstruct.norm import HinfNorm, hinf_norm
from pwaid.hinfstruct.statespace import Matrices, as_matrices, difference, frequency_response, resolvent_parts
from pwaid.hinfstruct.structured import StructuredModel

__all__ = ["ActiveSet", "MatchingProblem"]


@dataclass(frozen=True)
class ActiveSet:
    """The error at frequencies where it is large, linearised: E + sum_k dE_k d theta_k.

    Attributes
    ----------
    case, omega : arrays, shape (k,)
        Which pair, and at which frequency (rad/s).
    error : array, shape (k, ny, nu), complex
    slope : array, shape (k, size, ny, nu), complex
    """

    case: np.ndarray
    omega: np.ndarray
    error: np.ndarray
    slope: np.ndarray

    def gains(self, step: np.ndarray | None = None) -> np.ndarray:
        """sigma_max of the linearised error after the parameter step."""
        error = self.error if step is None else self.error + np.einsum("p,kpyu->kyu", step, self.slope)
        return np.linalg.svd(error, compute_uv=False)[:, 0]

    def gradients(self, step: np.ndarray | None = None) -> np.ndarray:
        """Gradients of these gains, shape (k, size): Re(u* dE v) with the leading singular vectors."""
        error = self.error if step is None else self.error + np.einsum("p,kpyu->kyu", step, self.slope)
        left, _, right = np.linalg.svd(error)
        return np.einsum("ky,kpyu,ku->kp", left[:, :, 0].conj(), self.slope, right[:, 0, :].conj()).real


@dataclass(frozen=True)
class MatchingProblem:
    """Structured models and the models they shall equal, all continuous and sharing one parameter vector.

    Attributes
    ----------
    models : tuple of StructuredModel
    targets : tuple of Matrices
    """

    models: tuple[StructuredModel, ...]
    targets: tuple[Matrices, ...]

    @classmethod
    def build(cls, models: StructuredModel | Sequence[StructuredModel], targets) -> MatchingProblem:
        """Check and pair models with targets (each a control.StateSpace or tuple).

        One of each may stand alone.
        """
        if isinstance(models, StructuredModel):
            models, targets = [models], [targets]
        models, targets = tuple(models), list(targets)
        if not models or len(models) != len(targets):
            raise InputError(
                f"{len(models)} models and {len(targets)} targets; expected one target per model, at least "
                "one"
            )
        checked = tuple(as_matrices(t, f"target {i}") for i, t in enumerate(targets))
        for i, (model, target) in enumerate(zip(models, checked, strict=True)):
            if model.size != models[0].size:
                raise InputError("the models must share one parameter vector")
            if target.dt:
                raise InputError(f"target {i} is discrete (dt = {target.dt} s); convert it with d2c first")
            if not target.stable:
                raise InputError(
                    f"target {i} is unstable (poles {np.sort_complex(target.poles)[-2:]}): its H-infinity "
                    "distance to any "
                    "stable model is infinite; identify again with more block rows or another order"
                )
            shape = model.evaluate(_probe(model))[3].shape
            if target.D.shape != shape:
                raise InputError(f"target {i} has {target.D.shape} outputs x inputs and its model {shape}")
        return cls(models, checked)

    @property
    def size(self) -> int:
        return self.models[0].size

    @cached_property
    def gain(self) -> float:
        """The largest gain of the targets at zero, infinity and their poles: what an error is small beside."""
        found = [np.abs(frequency_response(t, np.unique(np.abs([0.0, *t.poles, np.inf])))) for t in self.targets]
        found = [g[np.isfinite(g)].max(initial=0.0) for g in found]
        return float(max(found)) or 1.0

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return self.models[0].bounds

    def grid(self, points: int = 120) -> np.ndarray:
        """Log-spaced frequencies (rad/s) from well below the slowest to well above the fastest target pole.
        """
        size = np.concatenate([np.abs(t.poles) for t in self.targets])
        size = size[size > 0]
        if not size.size:
            raise InputError("the targets have no dynamics to choose a frequency grid from; pass omega=")
        return np.geomspace(size.min() / 30, 10 * size.max(), points)

    def stable(self, theta: np.ndarray) -> bool:
        return all(_finite_stable(m, theta) for m in self.models)

    def norms(self, theta: np.ndarray, fraction: float = 0.99) -> list[HinfNorm] | None:
        """The norm of every error system, or None when a structured model is unstable at theta."""
        if not self.stable(theta):
            return None
        pairs = zip(self.models, self.targets, strict=True)
        return [hinf_norm(difference(m.matrices(theta), t), fraction=fraction) for m, t in pairs]

    def value(self, theta: np.ndarray) -> float:
        """max_i ||G_i - target_i||_inf; inf when unstable."""
        norms = self.norms(theta)
        return np.inf if norms is None else max(n.value for n in norms)

    def active(self, theta: np.ndarray, fraction: float) -> tuple[float, ActiveSet] | None:
        """Value, and the linearised error at every peak of at least ``fraction`` of it.

        None when unstable.
        """
        norms = self.norms(theta, fraction)
        if norms is None:
            return None
        value = max(n.value for n in norms)
        picks = [
            (i, w) for i, n in enumerate(norms) for w, g in zip(
                n.frequencies, n.gains, strict=True
            ) if g >= fraction * value
        ]
        return value, self.linearise(theta, [p[0] for p in picks], [p[1] for p in picks])

    def linearise(self, theta: np.ndarray, case, omega) -> ActiveSet:
        """Error and its derivative at chosen (case, frequency) pairs."""
        case, omega = np.asarray(case, dtype=int), np.asarray(omega, dtype=float)
        ny, nu = self.targets[0].D.shape
        error = np.empty((case.size, ny, nu), dtype=complex)
        slope = np.empty((case.size, self.size, ny, nu), dtype=complex)
        for i in np.unique(case):
            rows = case == i
            response, derivative = response_and_slope(self.models[i], theta, omega[rows])
            error[rows] = response - frequency_response(self.targets[i], omega[rows])
            slope[rows] = derivative
        return ActiveSet(case, omega, error, slope)

    def residual(self, theta: np.ndarray, omega: np.ndarray, derivative: bool = False) -> np.ndarray:
        """Stacked real and imaginary parts of the error on a grid, divided by sqrt(points).

        Or its Jacobian.
        """
        parts = []
        for model, target in zip(self.models, self.targets, strict=True):
            if derivative:
                _, slope = response_and_slope(model, theta, omega)
                parts.append(np.moveaxis(slope, 1, -1).reshape(-1, self.size))
            else:
                error = frequency_response(model.matrices(theta), omega) - frequency_response(target, omega)
                parts.append(error.ravel())
        stacked = np.concatenate(parts) / np.sqrt(omega.size)
        return np.concatenate([stacked.real, stacked.imag])

    def static_gains(self) -> list[np.ndarray | None]:
        """G(0) of each model where it does not depend on theta, None where it does."""
        return [fixed_responses(model)[0] for model in self.models]

    def lower_bound(self, rng=None) -> tuple[float, str]:
        """A value no theta can beat, from frequencies where the structure fixes the response; and where it
        comes from.

        G(0) and G(inf) are compared at several random theta: a dependence that is rational in theta and equal
        there is a constant with probability one. 0 when the structure fixes neither.
        """
        best, reason = 0.0, "the structure fixes no response"
        for i, (model, target) in enumerate(zip(self.models, self.targets, strict=True)):
            for where, fixed, wanted in zip(
                ("0", "inf"), fixed_responses(model, rng), (target.at_zero(), target.D), strict=True
            ):
                if fixed is None:
                    continue
                bound = float(np.linalg.norm(fixed - wanted, 2))
                if bound > best:
                    best, reason = bound, f"pair {i}: G(j {where}) does not depend on theta"
        return best, reason

    def stationarity(self, theta: np.ndarray, scale: np.ndarray, tolerance: float = 1e-3) -> float:
        """Length of the shortest convex combination of the active gradients, per unit of value, in scaled
        parameters.

        0 at a stationary (Clarke) point. s means: relative parameter changes of norm r lower the linearised
        maximum by at most s r value. Peaks within ``tolerance`` of the maximum count as active. inf when
        theta is unstable.
        """
        found = self.active(theta, 1 - tolerance)
        if found is None:
            return np.inf
        value, active = found
        if value == 0:
            return 0.0
        return float(np.linalg.norm(_shortest(active.gradients() * scale))) / value


def response_and_slope(
    model: StructuredModel, theta: np.ndarray, omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """G(j omega), shape (k, ny, nu), and its derivatives (k, size, ny, nu): eq. (24)."""
    m = model.matrices(theta)
    dA, dB, dC, dD = model.differentiate(theta)
    response = frequency_response(m, omega)
    slope = np.broadcast_to(dD, (omega.size, *dD.shape)).astype(complex)
    finite = np.isfinite(omega)
    if not finite.any():
        return response, slope
    X, Y = resolvent_parts(m, omega[finite])
    k, n, nu = X.shape
    ny = Y.shape[1]
    outer = np.einsum("kyi,kju->kyuij", Y, X).reshape(k, ny * nu, n * n)
    through_a = (outer @ dA.reshape(-1, n * n).T).reshape(k, ny, nu, -1)
    slope[finite] += np.moveaxis(through_a, -1, 1)
    slope[finite] += np.einsum("kyi,piu->kpyu", Y, dB) + np.einsum("pyi,kiu->kpyu", dC, X)
    return response, slope


def fixed_responses(model: StructuredModel, rng=None) -> tuple[np.ndarray | None, np.ndarray | None]:
    """(G(0), G(inf)) where they do not depend on theta, None where they do."""
    rng = np.random.default_rng(rng if rng is not None else 0)
    base = _probe(model)
    at_zero, at_infinity = [], []
    for _ in range(12):
        shifted = np.where(
            base == 0, rng.uniform(-1, 1, model.size), base * rng.uniform(0.6, 1.4, model.size)
        )
        m = model.matrices(np.clip(shifted, *model.bounds))
        if np.linalg.matrix_rank(m.A) == m.order:
            at_zero.append(m.at_zero())
        at_infinity.append(m.D)
        if len(at_zero) == 4:
            break
    size = max(np.abs(s).max(initial=0.0) for s in (*at_zero, *at_infinity))
    return _if_constant(at_zero, size), _if_constant(at_infinity, size)


def _if_constant(samples: list[np.ndarray], size: float) -> np.ndarray | None:
    """The samples' common value, if they differ by nothing beside the largest gain `size`."""
    if len(samples) < 3:
        return None
    spread = max(np.abs(s - samples[0]).max(initial=0.0) for s in samples)
    return samples[0] if spread <= 1e-9 * size else None


def _probe(model: StructuredModel) -> np.ndarray:
    """Some admissible theta: the nominal one, or numbers between one and two inside the bounds."""
    generic = 1.0 + np.modf(0.6180339887 * np.arange(1, model.size + 1))[0]
    low, high = model.bounds
    return np.where(np.isfinite(model.nominal), model.nominal, np.clip(generic, low, high))


def _finite_stable(model: StructuredModel, theta: np.ndarray) -> bool:
    m = model.matrices(theta)
    return bool(all(np.isfinite(part).all() for part in m[:4]) and m.stable)


def _shortest(gradients: np.ndarray) -> np.ndarray:
    """Shortest vector in the convex hull of the rows."""
    size = np.linalg.norm(gradients, axis=1).max()
    if len(gradients) == 1 or size == 0:
        return gradients[0]
    # Minimise |G' w|² + heavy (sum w - 1)² over w >= 0, then normalise.
    heavy = 1e3
    system = np.vstack([gradients.T / size, np.full(len(gradients), heavy)])
    weights, _ = scipy.optimize.nnls(system, np.concatenate([np.zeros(gradients.shape[1]), [heavy]]))
    return gradients.T @ (weights / weights.sum())
