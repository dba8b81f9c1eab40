"""The signature screen: which effects could explain the residual, before any of them is fitted.

A candidate is injected at a few physically sized magnitudes; the change it makes in the simulated
outputs is its signature. What nominal parameters and start states could have absorbed is projected
out of signature and residual; the squared correlation of what is left is the score. This is a
Lagrange-multiplier test with a finite step, so thresholds whose derivative at zero vanishes are
seen too, and it costs two or three simulations per candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.effects.base import Effect
from pwaid.mismatch.fit import Fit, jacobian, output_rows
from pwaid.mismatch.model import LIMIT, Located, Model
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.structure import Structure

__all__ = ["Projector", "Screened", "StartsOut", "lattice", "locate_effects", "overlooked", "run_jobs", "screen",
           "shortlist"]

ABSORBED = 1e-5  # a small signature of which less than this share is left is a nominal parameter in disguise
AGAINST = 0.3  # factor on the score of a law that would have to act against its sign: the null may be bent far


@dataclass(frozen=True)
class Screened:
    """A candidate with its score, its best starts on the fitted axis, and the share of it that parameters absorb."""

    located: Located
    score: float
    starts: tuple[np.ndarray, ...]
    visible: float


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


def locate_effects(effects: Sequence[Effect], structure: Structure,
                   without: Sequence[str] = ()) -> list[Located]:
    """Every effect at every place where this simulator lets it in."""
    return [Located(e, place) for e in effects if e.id not in without for place in e.places(structure)]


def run_jobs(function, items, jobs: int):
    """Map over threads: the compiled loop releases the interpreter lock."""
    items = list(items)
    if jobs <= 1 or len(items) < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(function, items))


def _probe_grid(located: Located, problem: Problem, residual) -> list[np.ndarray]:
    """Starts on the fitted axis: the product of each parameter's probes, thinned to at most 48."""
    effect = located.effect
    options = []
    for q in effect.quantities:
        values = q.probes
        if effect.id == "position_ripple" and q.name == "wavenumber":
            values = tuple(np.arange(3.0, 50.0, 1.2))
        elif effect.id == "periodic_disturbance" and q.name == "angular_frequency":
            values = tuple(w / located.scales[0] for w in _peaks(residual, problem.coarse, located))
        elif effect.id == "sensor_quantization":
            step = lattice(problem.coarse.Y[:, located.place.ii[7]])
            values = (step / located.scales[0],) if step else values
        options.append(values)
    grid = [located.internal(m) for m in product(*options)]
    cap = 120 if effect.id == "position_ripple" else 36
    if len(grid) > cap:
        grid = [grid[i] for i in np.linspace(0, len(grid) - 1, cap).astype(int)]
    return grid


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


def screen(problem: Problem, fit: Fit, located: Sequence[Located], jobs: int = 1) -> list[Screened]:
    """Score every candidate on top of `fit` (the null, or a hypothesis already accepted), best first.

    `fit` is a fit to `problem.coarse`.
    """
    data, sigma = problem.coarse, problem.sigma
    base = fit.model
    e = ((data.Y - fit.Y) / sigma).ravel()
    project = Projector(base, fit, data, sigma, problem.ranges)
    e = project(np.clip(e, -1e3, 1e3))
    residual = fit.residual(data)
    norm = float(e @ e)

    def small(candidate, model, reference, z) -> float:
        """Share of the signature left by projection when the effect is a hundred times smaller."""
        z = np.array(z)
        if not z.size:
            return 1.0
        z[0] = z[0] - np.log(100.0) if candidate.effect.quantities[0].log else z[0] * 0.01
        s = ((model.simulate(np.concatenate([fit.theta, z]), fit.X0, data)[0] - reference) / sigma).ravel()
        full = float(s @ s)
        left = project(s)
        return float(left @ left) / full if full > 0 else 1.0

    def one(candidate: Located) -> Screened:
        """Score one candidate by its best probe."""
        model = Model(problem.settings, (*base.located, candidate))
        reference = fit.Y
        if model.substeps != base.substeps:
            reference = Model(problem.settings, base.located, model.substeps).simulate(fit.theta, fit.X0,
                                                                                       data)[0]
        scored, visible = [], 0.0
        low, high = candidate.bounds(data.sample_time / model.substeps)
        for z in _probe_grid(candidate, problem, residual) or [np.zeros(0)]:
            z = np.clip(z, low, high)
            Y, _ = model.simulate(np.concatenate([fit.theta, z]), fit.X0, data)
            s = ((Y - reference) / sigma).ravel()
            if not np.all(np.isfinite(s)) or np.max(np.abs(Y)) >= LIMIT:
                continue
            full = float(s @ s)
            if full < 1e-12 * data.Y.size:
                continue
            s = project(s)
            left = float(s @ s)
            visible = max(visible, left / full)
            if left < 1e-10 * data.Y.size:
                continue
            dot = float(s @ e)
            signed = dot < 0 and (not candidate.effect.quantities or candidate.effect.quantities[0].log
                                  or candidate.effect.quantities[0].size.endswith("_level"))
            score = (AGAINST if signed else 1.0) * dot * dot / (left * norm)
            start = z.copy()
            if dot < 0 and not signed:
                start[0] = -start[0]
            scored.append((score, tuple(start)))
        scored.sort(key=lambda item: -item[0])
        best = scored[0][0] if scored else 0.0
        if best > 0 and visible < 0.02 and small(candidate, model, reference, scored[0][1]) < ABSORBED:
            best = 0.0
        return Screened(candidate, best, tuple(np.array(z) for _, z in scored[:4]), visible)

    found = run_jobs(one, located, jobs)
    return sorted(found, key=lambda s: -s.score)


def shortlist(screened: Sequence[Screened], top: int = 8, per_family: float = 0.3,
              limit: int = 14) -> list[Screened]:
    """The best few, the best of each family within reach of the winner, one place per law unless it scores alike."""
    alive = [s for s in screened if s.score > 0]
    if not alive:
        return []
    best = alive[0].score
    chosen = [s for s in screened if not s.located.effect.quantities]  # no size to probe: the fit must tell
    seen: dict[tuple, int] = {}
    for s in alive:
        key = (s.located.effect.id, s.located.effect.law)
        if s in chosen:
            continue
        if len(chosen) < top and seen.get(key, 0) < 2 and (s.score > 0.12 * best or len(chosen) < 3):
            chosen.append(s)
            seen[key] = seen.get(key, 0) + 1
    for s in alive:  # a law inside a chosen law is always fitted beside it
        inside = any(s.located.effect.id in c.located.effect.contains
                     and s.located.place.signal == c.located.place.signal for c in chosen)
        if inside and s not in chosen:
            chosen.append(s)
    ids = {s.located.effect.id for s in chosen}
    families = {s.located.effect.family for s in chosen}
    for s in alive:
        effect = s.located.effect
        if len(chosen) >= limit:
            break
        fresh = effect.family not in families and s.score > per_family * best
        nested = effect.id not in ids and bool(set(effect.contains) & ids)
        parent = effect.id not in ids and any(effect.id in c.located.effect.contains for c in chosen[:4])
        if fresh or nested or parent:
            chosen.append(s)
            families.add(effect.family)
            ids.add(effect.id)
    return chosen


def overlooked(screened: Sequence[Screened], chosen: Sequence[Screened]) -> list[Screened]:
    """The best place of every effect that is not among the chosen.

    A threshold that the null has absorbed with bent parameters, such as a small backlash, has no signature there.
    """
    ids, found = {s.located.effect.id for s in chosen}, []
    for s in screened:
        if s.score > 0 and s.located.effect.id not in ids:
            ids.add(s.located.effect.id)
            found.append(s)
    return found
