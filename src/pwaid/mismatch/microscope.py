"""The hinge microscope: of which single variable is the unknown input a function, and where does it bend?

d is regressed on a linear block of all candidates plus a continuous piecewise affine map of one variable.
The linear block makes parameter errors cost nothing. Ranking and its null need thousands of fits, so they use
the same mesh and hinge matrix with a squared penalty, which is linear in d: every circular shift of d is
another column of the right-hand side. The winner's map is then learned by the ℓ1 hinge engine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares

from pwaid.delaunay import SimplexMesh
from pwaid.lerp import hinge_matrix, interpolation_matrix
from pwaid.mismatch.mapfit import BLOCKS, heldout_errors, learn_map, linear_block, shifted_copies, time_folds

__all__ = ["LEAST", "SHIFTS", "Bend", "Curve", "Shape", "examine", "map_blocks", "middle"]

POINTS = 33
RIDGES = (1e-3, 1e-1)
SHIFTS = 200
LEAST = 0.1  # a gain below this says nothing, however rare it is among the shifts


@dataclass(frozen=True)
class Bend:
    """A breakpoint with its 5 to 95 % block-bootstrap band; `jump` where d jumps there, `size` by how much."""

    position: float
    low: float
    high: float
    jump: bool
    size: float


@dataclass(frozen=True)
class Curve:
    """A continuous piecewise affine curve: `knots` and `values` (n,), linear beyond its ends."""

    knots: np.ndarray
    values: np.ndarray

    def __call__(self, z):
        return np.interp(z, self.knots, self.values)


@dataclass(frozen=True)
class Shape:
    """What the microscope saw.

    `ranking`: variable to held-out gain over the linear block; `threshold`: 95 % of the largest gain under
    circular shifts; `variable`: the responsible one, "" when none passes; `curve` of it, `gain`: held-out gain
    of the ℓ1 map; `partial` (N,): d without the other candidates' linear share; `memory`: whether rising and
    falling branches differ.
    """

    ranking: dict[str, float]
    threshold: float
    variable: str = ""
    curve: Curve | None = None
    gain: float = 0.0
    bends: tuple[Bend, ...] = ()
    memory: bool = False
    memory_gain: float = 0.0
    partial: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)


def middle(z) -> tuple[float, float]:
    """The range of 98 % of the samples; of all where so many rest at one value, as a valve that opens seldom."""
    low, high = np.quantile(z, [0.01, 0.99])
    return (low, high) if high - low > 1e-9 * (1 + np.max(np.abs(z))) else (np.min(z), np.max(z))


def _mesh(z) -> tuple[SimplexMesh, np.ndarray]:
    """A grid over 98 % of the samples, symmetric where the variable changes sign evenly; samples clipped to it."""
    low, high = middle(z)
    if low < 0 < high and min(-low, high) > 0.4 * max(-low, high):
        low, high = -max(-low, high), max(-low, high)
    return SimplexMesh.grid([[low, high]], POINTS), np.clip(z, low, high)


def _linear_gain_table(design, penalty, base, D, w, fold):
    """Held-out gain of ridge fits on `design` over fits on `base`, for every column of D (N, m)."""
    best = np.full(D.shape[1], -np.inf)
    before = heldout_errors(base, np.zeros((base.shape[1],) * 2), D, w, fold)
    for ridge in RIDGES:
        after = heldout_errors(design, ridge * penalty, D, w, fold)
        best = np.maximum(best, 1.0 - after / np.maximum(before, 1e-300))
    return best


def map_blocks(z):
    """Interpolation matrix, hinge penalty and mesh of one variable; the hinges in units of the slope."""
    mesh, clipped = _mesh(z)
    A = interpolation_matrix(mesh, clipped[:, None])
    F = hinge_matrix(mesh, "hinge")
    return mesh, A, F


def examine(d, deviation, candidates: Mapping[str, np.ndarray], slopes: Mapping[str, np.ndarray],
            rise: Mapping[str, float] | None = None, rng=0, bootstrap: int = 20) -> Shape:
    """Find the variable behind d.

    Parameters
    ----------
    d, deviation : (N,) the unknown input and its posterior standard deviation.
    candidates : variable to samples (N,). Time (``"t"``) may be among them: when it wins, it is a drift.
    slopes : variable to the sign-giving rate of change (N,), for the memory test.
    rise : variable to the distance it typically moves while a jump is smeared: bends closer than that are a jump.
    rng : seed or Generator of shifts and bootstrap.

    Fewer than 200 samples, or a constant d, give an empty ranking.
    """
    rng = np.random.default_rng(rng)
    names = [n for n, z in candidates.items() if np.ptp(z) > 1e-12 * (1 + np.max(np.abs(z)))]
    w = 1.0 / (deviation**2 + np.median(deviation) ** 2)
    w = w / w.mean()
    d = np.asarray(d, dtype=float)
    if len(d) < 10 * BLOCKS or not np.ptp(d) > 0:
        return Shape({}, LEAST)
    fold, D = time_folds(len(d)), shifted_copies(d, rng, SHIFTS)
    Z = linear_block(candidates, names)
    base = np.column_stack([np.ones(len(d)), Z])
    gains = np.empty((len(names), D.shape[1]))
    for k, name in enumerate(names):
        _, A, F = map_blocks(candidates[name])
        design = np.column_stack([A.toarray(), np.delete(Z, k, axis=1)])
        P = np.zeros((design.shape[1],) * 2)
        P[:POINTS, :POINTS] = (F.T @ F).toarray()
        gains[k] = _linear_gain_table(design, P, base, D, w, fold)
    threshold = max(float(np.quantile(gains[:, 1:].max(axis=0), 0.95)), LEAST)
    order = np.argsort(-gains[:, 0])
    ranking = {names[k]: float(gains[k, 0]) for k in order}
    if not len(order):
        return Shape(ranking, threshold)
    if gains[order[0], 0] > threshold:
        k = int(order[0])
        others = np.delete(Z, k, axis=1)
        memory_gain, limit = _memory(d, w, candidates[names[k]], others, slopes.get(names[k]), fold, rng)
    else:  # no static law of one variable: one with memory shows as two maps, rising and falling
        found = [(*_memory(d, w, candidates[n], np.delete(Z, k, axis=1), slopes.get(n), fold, rng), k)
                 for k, n in enumerate(names) if n in slopes]
        passed = [f for f in found if f[0] > f[1]]
        if not passed:
            return Shape(ranking, threshold)
        memory_gain, limit, k = max(passed)
        others = np.delete(Z, k, axis=1)
    z = candidates[names[k]]
    curve, partial, gain = _learn(d, w, z, others, fold, base)
    bends = _bends(z, partial, w, curve, (rise or {}).get(names[k], 0.0), rng, bootstrap)
    return Shape(ranking, threshold, names[k], curve, gain, bends, memory_gain > limit, memory_gain, partial)


# ------------------------------------------------------------------ the winner's map, by the package's engine
def _learn(d, w, z, others, fold, base):
    """Curve, partial residual of d and held-out gain of the ℓ1 map of one variable."""
    mesh, A, F = map_blocks(z)
    values, partial, gain = learn_map(mesh, A, F, d, w, others, fold, base)
    return Curve(mesh.points[:, 0], values), partial, gain


# ------------------------------------------------------------------ breakpoints
def _clusters(curve: Curve) -> np.ndarray:
    """Starting positions of the few bends that carry the curve's change of slope."""
    slope = np.diff(curve.values) / np.diff(curve.knots)
    change = np.diff(slope)
    keep = np.abs(change) > 0.15 * np.max(np.abs(change), initial=1e-300)
    found, k = [], 0
    while k < len(change):
        if keep[k]:
            m = k
            while m + 1 < len(change) and keep[m + 1] and np.sign(change[m + 1]) == np.sign(change[k]):
                m += 1
            weight = np.abs(change[k:m + 1])
            found.append((float(weight @ curve.knots[k + 1:m + 2] / weight.sum()), float(weight.sum())))
            k = m
        k += 1
    found = sorted(found, key=lambda f: -f[1])[:4]
    return np.sort([f[0] for f in found])


def _refine(z, y, w, start):
    """Positions of the bends and their changes of slope, by variable projection."""
    low, high = middle(z)
    root = np.sqrt(w)

    def design(knots):
        return np.column_stack([np.ones_like(z), z, *(np.maximum(z - c, 0) for c in knots)]) * root[:, None]

    def left(knots):
        M = design(knots)
        return root * y - M @ np.linalg.lstsq(M, root * y, rcond=1e-9)[0]

    step = 0.02 * (high - low)
    fit = least_squares(left, np.clip(start, low + step, high - step), bounds=(low, high), x_scale=high - low,
                        diff_step=1e-4, max_nfev=15)
    order = np.argsort(fit.x)
    coefficients = np.linalg.lstsq(design(fit.x[order]), root * y, rcond=1e-9)[0]
    return fit.x[order], coefficients


def _bends(z, y, w, curve, width, rng, count):
    start = _clusters(curve)
    if not start.size:
        return ()
    skip = max(1, len(z) // 1000)
    z, y, w = z[::skip], y[::skip], w[::skip]
    knots, c = _refine(z, y, w, start)
    label = np.arange(len(z)) * BLOCKS // len(z)
    drawn = []
    for _ in range(count):
        times = np.bincount(rng.integers(0, BLOCKS, BLOCKS), minlength=BLOCKS)
        drawn.append(_refine(z, y, w * times[label], knots)[0])
    drawn, found, k = np.array(drawn), [], 0
    slopes = np.concatenate([[c[1]], c[1] + np.cumsum(c[2:])])
    while k < len(knots):
        pair = k + 1 < len(knots) and knots[k + 1] - knots[k] < width and max(
            abs(slopes[k]), abs(slopes[k + 2])) < 0.3 * abs(slopes[k + 1])
        columns = drawn[:, k:k + 2].mean(axis=1) if pair else drawn[:, k]
        low, high = np.quantile(columns, [0.05, 0.95])
        position = knots[k:k + 2].mean() if pair else knots[k]
        size = (slopes[k + 1] - 0.5 * (slopes[k] + slopes[k + 2])) * (knots[k + 1] - knots[k]) if pair else c[2 + k]
        found.append(Bend(float(position), float(low), float(high), bool(pair), float(size)))
        k += 2 if pair else 1
    return tuple(found)


# ------------------------------------------------------------------ memory
def _memory(d, w, z, others, slope, fold, rng):
    """Held-out gain of separate maps on rising and falling branches, and 95 % of it under shifted branches."""
    if slope is None:
        return 0.0, LEAST
    _, A, F = map_blocks(z)
    A, P = A.toarray(), (F.T @ F).toarray()
    base = np.column_stack([A, others])
    side = np.where(slope >= 0, 0.5, -0.5)
    plain = np.zeros((base.shape[1],) * 2)
    plain[:POINTS, :POINTS] = RIDGES[0] * P
    before = heldout_errors(base, plain, d[:, None], w, fold)[0]

    def gain(s):
        M = np.column_stack([base, A * s[:, None]])
        Q = np.zeros((M.shape[1],) * 2)
        Q[:len(plain), :len(plain)] = plain
        Q[len(plain):, len(plain):] = RIDGES[0] * P + 1e-6 * np.eye(POINTS)
        return 1.0 - heldout_errors(M, Q, d[:, None], w, fold)[0] / max(before, 1e-300)

    n = len(d)
    null = [gain(np.roll(side, int(s))) for s in rng.integers(n // 20, n - n // 20, 19)]
    return float(gain(side)), max(float(np.max(null)), 3 * LEAST)
