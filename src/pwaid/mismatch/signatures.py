"""Signatures: what a candidate effect does to the simulated outputs, beyond what parameters and start states absorb.

A candidate is injected at a few physically sized magnitudes on top of a fit; the change it makes in the outputs, with
what nominal parameters and start states could have done projected out, is its signature.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit, jacobian, output_rows
from pwaid.mismatch.model import LIMIT, Located, Model
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.units import KNOWN, factor_of

__all__ = ["Projector", "Signature", "Signatures", "StartsOut", "lattice", "mirrored", "one_signed"]

TEETH = 48  # periods of a ripple per turn


@dataclass(frozen=True)
class Signature:
    """One size of a candidate.

    Attributes
    ----------
    start : its parameters on the fitted axis.
    direction : (N ny,) weighted change of the outputs, projected, of length one; zeros where nothing is left.
    share : what projection leaves of its square.
    dot : its product with the residual.
    """

    start: np.ndarray
    direction: np.ndarray = field(repr=False)
    share: float
    dot: float

    @property
    def seen(self) -> bool:
        """Whether anything is left of it."""
        return bool(self.direction.any())


class Signatures:
    """Signatures on top of `fit`, a fit to `problem.coarse`, whose projected residual has the square `power`."""

    def __init__(self, problem: Problem, fit: Fit):
        self.problem, self.fit = problem, fit
        self.project = Projector(fit.model, fit, problem.coarse, problem.sigma, problem.ranges)
        self.residual = self.project(np.clip(((problem.coarse.Y - fit.Y) / problem.sigma).ravel(), -1e3, 1e3))
        self.power = float(self.residual @ self.residual)

    def of(self, candidate: Located) -> list[Signature]:
        """The signatures of every size at which its simulation does not run away and changes anything."""
        data, change = self.problem.coarse, _Changes(self.problem, self.fit, candidate)
        low, high = candidate.bounds(data.sample_time / change.substeps)
        grid = _probe_grid(candidate, self.problem, self.fit.residual(data)) or [np.zeros(0)]
        found = []
        for z in (np.clip(z, low, high) for z in grid):
            s = change(z)
            if s is None:
                continue
            full, s = float(s @ s), self.project(s)
            left = float(s @ s)
            s = s / np.sqrt(left) if left >= 1e-10 * data.Y.size else np.zeros_like(s)
            found.append(Signature(z, s, left / full, float(s @ self.residual)))
        return found

    def share_of_small(self, candidate: Located, z) -> float:
        """What projection leaves of a signature (its square) when the effect is a hundred times smaller than z."""
        z = np.array(z)
        if not z.size:
            return 1.0
        z[0] = z[0] - np.log(100.0) if candidate.effect.quantities[0].log else z[0] * 0.01
        s = _Changes(self.problem, self.fit, candidate)(z)
        return float(np.sum(self.project(s) ** 2)) / float(s @ s) if s is not None else 1.0


class _Changes:
    """Weighted change (N ny,) of the outputs by a candidate of given parameters; None where it is none or too much."""

    def __init__(self, problem: Problem, fit: Fit, candidate: Located):
        base, self.problem, self.fit = fit.model, problem, fit
        self.model, self.reference = Model(problem.settings, (*base.located, candidate)), fit.Y
        self.substeps = self.model.substeps
        if self.substeps != base.substeps:
            finer = Model(problem.settings, base.located, self.substeps)
            self.reference = finer.simulate(fit.theta, fit.X0, problem.coarse)[0]

    def __call__(self, z):
        Y, _ = self.model.simulate(np.concatenate([self.fit.theta, z]), self.fit.X0, self.problem.coarse)
        s = ((Y - self.reference) / self.problem.sigma).ravel()
        if not np.all(np.isfinite(s)) or np.max(np.abs(Y)) >= LIMIT or s @ s < 1e-12 * s.size:
            return None
        return s


def one_signed(candidate: Located) -> bool:
    """Whether the law acts one way only, whatever its parameters."""
    q = candidate.effect.quantities
    return not q or q[0].log or q[0].size.endswith("_level")


def mirrored(z) -> np.ndarray:
    """The parameters of a law that acts the other way."""
    z = np.array(z)
    z[0] = -z[0]
    return z


class StartsOut:
    """Removes from output signals (N ny,) or (N ny, n) what start states can explain; S (N ny, nx) responds to them."""

    def __init__(self, S, data: Dataset):
        self.rows = output_rows(data)
        self.blocks = [_basis(S[s]) for s in self.rows]

    def __call__(self, v):
        v = v.copy()
        for s, B in zip(self.rows, self.blocks, strict=True):
            v[s] -= B @ (B.T @ v[s])
        return v


class Projector:
    """Removes what parameters and start states can explain from a weighted output signal."""

    def __init__(self, model: Model, fit: Fit, data: Dataset, sigma, ranges):
        J = jacobian(model, fit.theta, fit.X0, data, sigma, fit.Y, ranges,
                     bounds=model.bounds(data.sample_time))
        self.starts_out = StartsOut(J.S, data)
        self.G = _basis(self.starts_out(J.G))

    def __call__(self, v):
        v = self.starts_out(v)
        return v - self.G @ (self.G.T @ v)


def _basis(M, tol: float = 1e-7):
    norms = np.linalg.norm(M, axis=0)
    M = M[:, norms > 0] / norms[norms > 0]
    if M.size == 0:
        return np.zeros((len(M), 0))
    Q, R = np.linalg.qr(M)
    keep = np.abs(np.diag(R)) > tol
    if not keep.all():
        U, s, _ = np.linalg.svd(M, full_matrices=False)
        return U[:, s > tol * s[0]]
    return Q


def _probe_grid(located: Located, problem: Problem, residual) -> list[np.ndarray]:
    """Starts on the fitted axis: the product of each parameter's probes, thinned to 36; of a ripple, all."""
    effect = located.effect
    options = []
    for q in effect.quantities:
        values = q.probes
        if effect.id == "position_ripple" and q.name == "wavenumber":
            finest = _finest(located, problem, residual)
            values = (*np.arange(3.0, finest, 1.2), *_per_turn(located, problem.structure, finest))
        elif effect.id == "periodic_disturbance" and q.name == "angular_frequency":
            values = tuple(w / located.scales[0] for w in _peaks(residual, problem.coarse, located))
        elif effect.id == "sensor_quantization":
            step = lattice(problem.coarse.Y[:, located.place.ii[7]])
            values = (step / located.scales[0],) if step else values
        options.append(values)
    grid = [located.internal(m) for m in product(*options)]
    if len(grid) > 36 and effect.id != "position_ripple":
        grid = [grid[i] for i in np.linspace(0, len(grid) - 1, 36).astype(int)]
    return grid


def _finest(located: Located, problem: Problem, residual, usual: float = 50.0, most: float = 400.0) -> float:
    """The largest wavenumber worth a try, in periods over the reach times 2 pi: where short segments keep the position
    close, ripples are told apart as far as that error lets them."""
    x, shown = located.place.ii[5], problem.structure.shown
    k = next((k for k, state in enumerate(shown.state) if state == x), None)
    if not problem.brief or k is None:
        return usual
    error = float(np.sqrt(np.mean(residual[:, k] ** 2))) / abs(shown.gain[k])
    return float(np.clip(4.0 * located.place.scales["position"] / max(error, 1e-300), usual, most))


def _per_turn(located: Located, structure, finest: float) -> np.ndarray:
    """Whole numbers of periods per turn, beyond the largest wavenumber tried, of an axis that turns on and on."""
    unit = structure.state_units[located.place.ii[5]]
    radian = next((factor_of(symbol) for symbol in unit if KNOWN[symbol] == "angle"), 0.0)
    reach = radian * located.place.scales["position"]
    found = reach * np.arange(1, TEETH + 1)
    return found[found > finest] if reach > 2 * np.pi else found[:0]


def lattice(y) -> float:
    """Step of the lattice that all samples y (N,) lie on; 0 where they lie on none, or nearly every one is unlike."""
    values = np.unique(y)
    if not 2 < len(values) < len(y) / 4:
        return 0.0
    step = float(np.min(np.diff(values)))
    marks = np.round((values - values[0]) / step)
    step = float((values[-1] - values[0]) / marks[-1])
    away = np.abs((values - values[0]) / step - np.round((values - values[0]) / step))
    return step if np.max(away) < 0.05 else 0.0


def _peaks(residual, data: Dataset, located, count: int = 3):
    a, b = data.recordings[0]
    r = residual[a:b, 0] - residual[a:b, 0].mean()
    spectrum = np.abs(np.fft.rfft(r * np.hanning(b - a)))
    spectrum[:2] = 0
    found = []
    for k in np.argsort(spectrum)[::-1]:
        if all(abs(k - other) > 3 for other in found):
            found.append(int(k))
        if len(found) == count:
            break
    return [2 * np.pi * k / ((b - a) * data.sample_time) for k in found]
