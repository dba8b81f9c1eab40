"""Where to put the grid points of a mesh: uniform, Gaussian, blue noise, or where the data are.

Each function returns points of shape (n, d) in the units of its arguments. The box generators include the
corners of the box, so that the mesh covers it.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from pwaid.errors import InputError
from pwaid.recording import check_finite

__all__ = [
    "as_bounds",
    "as_points",
    "blue_noise_points",
    "box_corners",
    "data_points",
    "gaussian_points",
    "uniform_points",
]

# Points closer than this share of the range are one: rounding parted them.
TOGETHER = 1e-7


def as_bounds(bounds: Any) -> np.ndarray:
    """Bounds as an array of shape (d, 2) with low < high, in the order low, high."""
    box = np.asarray(bounds, dtype=float)
    if box.ndim == 1 and box.size == 2:
        box = box[None, :]
    if box.ndim != 2 or box.shape[1] != 2:
        raise InputError(f"bounds have shape {box.shape}; expected (d, 2): one (low, high) pair a dimension")
    check_finite(box, "bounds")
    if np.any(box[:, 0] >= box[:, 1]):
        k = int(np.argmax(box[:, 0] >= box[:, 1]))
        raise InputError(f"bounds of dimension {k} are {box[k].tolist()}; expected low < high")
    return box


def as_points(points: Any, name: str = "points") -> np.ndarray:
    """Points as a finite float array of shape (n, d)."""
    P = np.asarray(points, dtype=float)
    if P.ndim == 1:
        P = P[:, None]
    if P.ndim != 2 or P.shape[1] == 0:
        raise InputError(f"{name} have shape {P.shape}; expected (n, d): one point a row")
    check_finite(P, name)
    return P


def box_corners(bounds: Any) -> np.ndarray:
    """The 2^d corners of a box, shape (2^d, d)."""
    return np.array(list(product(*as_bounds(bounds))))


def _loose_corners(bounds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The corners; from d = 4 on moved outwards by a random 0–5 % of the box.

    The 2^(d−1) corners of one face lie in a plane, and with few other points on the hull their Delaunay simplices
    would be slivers. Moved corners are in general position, and the box stays covered.
    """
    corners, centre = box_corners(bounds), bounds.mean(axis=1)
    if len(bounds) < 4:
        return corners
    return centre + (corners - centre) * (1.0 + 0.1 * rng.uniform(size=(len(corners), 1)))


def _room_for_corners(n: int, corners: np.ndarray, what: str) -> int:
    if n < corners.shape[0] + 1:
        raise InputError(
            f"n = {n} points came for {what} in {corners.shape[1]} dimensions; "
            f"expected at least {corners.shape[0] + 1} (2^d corners and one point inside)"
        )
    return n - corners.shape[0]


def uniform_points(bounds: Any, n: int, rng: Any = None) -> np.ndarray:
    """`n` points uniform in a box, its 2^d corners among them (2014 Example 1); see `_loose_corners` for d ≥ 4."""
    box, rng = as_bounds(bounds), np.random.default_rng(rng)
    corners = _loose_corners(box, rng)
    inside = rng.uniform(box[:, 0], box[:, 1], (_room_for_corners(n, corners, "a uniform mesh"), len(box)))
    return np.vstack([corners, inside])


def gaussian_points(X: Any, n: int, rng: Any = None) -> np.ndarray:
    """`n` points normally distributed with the empirical mean and covariance of X (2014 Example 2)."""
    X, rng = as_points(X, "X"), np.random.default_rng(rng)
    if X.shape[0] < X.shape[1] + 1:
        raise InputError(f"{X.shape[0]} samples came; a covariance in {X.shape[1]} dimensions needs more")
    return rng.multivariate_normal(X.mean(axis=0), np.atleast_2d(np.cov(X.T)), size=n)


def _lloyd(points: np.ndarray, cloud: np.ndarray, n_fixed: int, steps: int) -> np.ndarray:
    """Move every point but the first `n_fixed` to the centroid of the cloud nearest to it, a few times.

    A few steps of this k-means iteration turn random points into blue noise: near-equal spacing without a
    lattice.
    """
    P = points.copy()
    for _ in range(steps):
        owner = cKDTree(P).query(cloud)[1]
        count = np.bincount(owner, minlength=len(P))
        sums = np.column_stack([np.bincount(owner, cloud[:, k], len(P)) for k in range(cloud.shape[1])])
        move = (count > 0) & (np.arange(len(P)) >= n_fixed)
        P[move] = sums[move] / count[move, None]
    return P


def blue_noise_points(bounds: Any, n: int, rng: Any = None, *, steps: int = 10) -> np.ndarray:
    """`n` evenly spread points in a box: blue noise, with corners and with points on every face.

    Uniform points are relaxed by `steps` Lloyd iterations; those within 0.6 of the mean spacing of a face are
    put on it, and the others relaxed again. Compared with random points this gives fewer slivers.
    """
    box, rng = as_bounds(bounds), np.random.default_rng(rng)
    d = len(box)
    low, width = box[:, 0], box[:, 1] - box[:, 0]
    corners = box_corners(np.tile([0.0, 1.0], (d, 1)))
    free = _room_for_corners(n, corners, "a blue-noise mesh")
    P = np.vstack([corners, rng.uniform(size=(free, d))])
    cloud = rng.uniform(size=(min(50 * n, 400_000), d))
    P = _lloyd(P, cloud, len(corners), steps)
    reach = 0.6 * n ** (-1.0 / d)
    inner = P[len(corners) :]
    inner[inner < reach] = 0.0
    inner[inner > 1.0 - reach] = 1.0
    inner = np.unique(inner, axis=0)
    at_corner = np.all((inner == 0.0) | (inner == 1.0), axis=1)
    inner = np.vstack([inner[~at_corner], rng.uniform(reach, 1.0 - reach, (free, d))])[:free]
    on_face = np.any((inner == 0.0) | (inner == 1.0), axis=1)
    fixed = np.vstack([corners, inner[on_face]])
    P = _lloyd(np.vstack([fixed, inner[~on_face]]), cloud, len(fixed), steps)
    return low + width * P


def data_points(X: Any, n: int | None = None, rng: Any = None, *, margin: float = 0.05, steps: int = 5) -> np.ndarray:
    """`n` points that follow the density of the data, and the corners of the data's box.

    Parameters
    ----------
    X : array_like, shape (N, d)
        Data in comparable units (normalise first).
    n : int, optional
        How many points in all; every distinct sample when None or when there are fewer of them.
    margin : float
        The box is the data's, larger by this fraction on each side, so that new data rarely fall outside.
    steps : int
        Lloyd iterations that spread the chosen points evenly.

    Raises
    ------
    InputError
        A channel is constant, or `n` is too small.
    """
    X, rng = as_points(X, "X"), np.random.default_rng(rng)
    low, high = X.min(axis=0), X.max(axis=0)
    if np.any(low == high):
        k = int(np.argmax(low == high))
        raise InputError(f"column {k} of X is constant ({low[k]:g}); expected every input to vary: leave it out")
    wide = margin * (high - low)
    corners = _loose_corners(np.column_stack([low - wide, high + wide]), rng)
    apart = np.round((X - low) / (high - low) / TOGETHER + 0.2347)  # an offset at which no round share is halved
    distinct = X[np.unique(apart, axis=0, return_index=True)[1]]
    distinct = distinct[np.lexsort(distinct.T[::-1])]
    if n is None or len(distinct) + len(corners) <= n:
        return np.vstack([corners, distinct])
    free = _room_for_corners(n, corners, "a mesh of the data")
    seeds = distinct[rng.choice(len(distinct), free, replace=False)]
    cloud = X if len(X) <= 400_000 else X[rng.choice(len(X), 400_000, replace=False)]
    return np.vstack([corners, np.unique(_lloyd(seeds, cloud, 0, steps), axis=0)])
