"""What a fit cannot know of itself: small effects that no recording shows and the step of the integration.

Every machine has a little drag, a spring that hardens, a sensor that bends. Such an effect is mostly absorbed by the
parameters: a large bias, a small residual, so no covariance made of residuals knows of it. Here each candidate of a
fixed list is simulated at a small size on top of the fitted model. With s its signature, start states taken out,

    b = (GᵀG + P)⁻¹ Gᵀ s        the bias it causes when it is left out
    v = ‖s - G b‖ / (√N floor)  what it would leave visible

Its size a (in units of the one simulated, at most 1) is taken as normal with zero mean and a variance that lets about
`PRESENT` of the candidates be there; it is scaled so that it leaves no more than `HIDDEN` times the noise floor, or
what the residual has above the floor. The residual then narrows it (linear regression with that prior). The second
moment of a, mean included because the estimate is not corrected, times the biases is added to the covariance. This is
a model-discrepancy term (Kennedy and O'Hagan 2001) with the catalogue as its basis.
"""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.effects.actuator import one_sided_gain
from pwaid.mismatch.effects.registry import CATALOGUE
from pwaid.mismatch.fit import Fit
from pwaid.mismatch.model import LIMIT, Located, Model
from pwaid.mismatch.normal import NormalEquations
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.refit import noise_of
from pwaid.mismatch.screen import locate_effects

__all__ = ["discrepancy", "signatures", "step_error"]

# Smooth laws that every machine may have a little of, in multiples of their scale (the force at full speed or stroke,
# the time scale; sensors are better).
SMALL = {"quadratic_drag": 0.02, "cubic_stiffness": 0.02, "quadratic_stiffness": 0.02, "constant_load": 0.02,
         "actuator_gain_asymmetry": 0.02, "actuator_lag": 0.02, "sensor_lag": 0.02, "leakage": 0.02,
         "radiation": 0.02, "sensor_offset": 0.01, "sensor_nonlinearity": 0.01}
PRESENT = 2.5  # of them at a time
HIDDEN = 0.3  # of the noise floor may be left visible by one of them
FACTOR = 1.2  # on the standard deviation; set on calibration cases (docs/mismatch.md, "Intervals")


def discrepancy(problem: Problem, fit: Fit, normal: NormalEquations) -> np.ndarray:
    """Second moment (n, n) of the parameters' bias by small effects left out, by the step, and by stopping early."""
    step = normal.bias(normal.without_starts(step_error(problem, fit)))
    total = np.outer(step, step) + np.outer(normal.left, normal.left)
    S = signatures(problem, fit)
    if S.shape[1] and len(fit.theta):
        total += FACTOR**2 * _biases(problem, normal, normal.without_starts(S))
    return total


def signatures(problem: Problem, fit: Fit) -> np.ndarray:
    """Weighted change of the training outputs by each small effect on top of the fit, (N ny, m)."""
    taken = {(e.effect.id, e.place.signal) for e in fit.model.located}
    room = len(fit.model.located) < 3
    found = []
    small = [e for e in CATALOGUE if e.id in SMALL and e.kernel is not one_sided_gain]
    for c in locate_effects(small, problem.structure) if room else ():
        if (c.effect.id, c.place.signal) not in taken:
            s = _signature(problem, fit, c)
            if s is not None:
                found.append(s)
    return np.column_stack(found) if found else np.zeros((problem.train.Y.size, 0))


def _signature(problem: Problem, fit: Fit, small: Located) -> np.ndarray | None:
    """The change by one of them; None where it does nothing or the simulation runs away."""
    model = Model(problem.settings, (*fit.model.located, small), fit.model.substeps)
    z = small.internal([SMALL[small.effect.id]] + [0.0] * (small.size - 1))
    return _change(problem, fit, model, np.concatenate([fit.theta, z]))


def step_error(problem: Problem, fit: Fit) -> np.ndarray:
    """Weighted change of the training outputs (N ny,) when the integration step is halved."""
    nothing = np.zeros(problem.train.Y.size)
    if problem.plant.dt or problem.plant.black_box is not None:
        return nothing
    finer = Model(problem.settings, fit.model.located, 2 * fit.model.substeps)
    change = _change(problem, fit, finer, fit.theta)
    return nothing if change is None else change


def _change(problem: Problem, fit: Fit, model: Model, theta) -> np.ndarray | None:
    Y = model.simulate(theta, fit.X0, problem.train)[0]
    s = ((Y - fit.Y) / problem.sigma).ravel()
    return s if np.all(np.isfinite(s)) and np.max(np.abs(Y)) < LIMIT and np.any(s) else None


def _biases(problem: Problem, normal: NormalEquations, S) -> np.ndarray:
    """Second moment of the bias by the effects with signatures S, given the residual."""
    floor = float(np.sqrt(np.mean((noise_of(problem) / problem.sigma) ** 2)))
    left = normal.unabsorbed(S)
    visible = np.sqrt(np.mean(left**2, axis=0)) / floor
    above = float(np.mean(normal.r**2)) / floor**2 - 1.0
    scale = np.minimum(1.0, max(HIDDEN, np.sqrt(max(above, 0.0))) / np.maximum(visible, 1e-12))
    left, biases = left * scale, normal.bias(S) * scale
    e = normal.unabsorbed(normal.r)
    variance = max(floor**2, float(np.mean(e**2))) * _dependence(e.reshape(-1, problem.train.Y.shape[1]))
    m = S.shape[1]
    spread = np.linalg.inv(left.T @ left / variance + np.eye(m) / min(1.0, PRESENT / m))
    mean = spread @ (left.T @ e) / variance
    return biases @ (spread + np.outer(mean, mean)) @ biases.T


def _dependence(e) -> float:
    """How many neighbouring errors (N, ny) count as one, from their correlation at lag one; at least 1."""
    power = np.sum(e**2, axis=0)
    rho = np.max(np.sum(e[1:] * e[:-1], axis=0) / np.maximum(power, 1e-300), initial=0.0)
    rho = min(float(rho), 0.99)
    return (1.0 + rho) / (1.0 - rho)
