"""Of which two variables is the unknown input a function? Maps over pairs on a Delaunay mesh.

Second tier of the hinge microscope: tried where no single variable carries the unknown input, or where a pair adds
materially to the one that does. Ranking and its null use the mesh and hinge matrix with a squared penalty, so that
a circular shift is one more right-hand side; the winner's map is learned by the ℓ1 hinge engine.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pwaid.delaunay import SimplexMesh
from pwaid.lerp import hinge_matrix, interpolation_matrix
from pwaid.mismatch.mapfit import heldout_errors, learn_map, linear_block, shifted_copies, time_folds
from pwaid.mismatch.microscope import LEAST, SHIFTS, map_blocks, middle
from pwaid.pwa_map import PWAMap

__all__ = ["PairShape", "examine_pairs"]

VERTICES = 64
RIDGES = (1e-3, 1e-2, 1e-1)
MOST_PAIRS = 10


@dataclass(frozen=True)
class PairShape:
    """A map over two variables.

    `ranking`: pair to held-out gain over what one variable and the linear block explain; `threshold`: 95 % of the
    largest gain under circular shifts; `variables`: the responsible pair; `map`: PWA over it, by the ℓ1 engine;
    `gain`: its held-out gain over the linear block; `partial` (N,): d without the linear share of the others.
    """

    ranking: dict[tuple[str, str], float]
    threshold: float
    variables: tuple[str, str]
    map: PWAMap
    gain: float
    partial: np.ndarray = field(repr=False)


def _mesh(z) -> tuple[SimplexMesh, np.ndarray]:
    """Evenly spread vertices over 98 % of the samples of each variable; samples clipped to that box."""
    box = np.array([middle(column) for column in z.T])
    return SimplexMesh.blue_noise(box, VERTICES, 0), np.clip(z, *box.T)


def _design(z, rest):
    """Interpolation over the pair beside the other variables, and the hinges' penalty."""
    mesh, inside = _mesh(z)
    A, F = interpolation_matrix(mesh, inside), hinge_matrix(mesh, "hinge")
    n = A.shape[1]
    P = np.zeros((n + rest.shape[1],) * 2)
    P[:n, :n] = (F.T @ F).toarray()
    return mesh, A, F, np.column_stack([A.toarray(), rest]), P


def examine_pairs(d, deviation, candidates: Mapping[str, np.ndarray], single: str = "", single_gain: float = 0.0,
                  rng=0) -> PairShape | None:
    """Find the pair behind d; None when no pair says more than one variable does.

    Parameters
    ----------
    d, deviation : (N,) the unknown input and its posterior standard deviation.
    candidates : variable to samples (N,); pairs are formed of all but time and rates.
    single, single_gain : the variable already found responsible and its map's gain; a pair then has to remove a
        tenth of what that leaves, and a twentieth of all.
    """
    rng = np.random.default_rng(rng)
    d = np.asarray(d, dtype=float)
    names = [n for n, z in candidates.items() if np.ptp(z) > 1e-12 * (1 + np.max(np.abs(z)))]
    pairs = list(itertools.combinations([n for n in names if n != "t" and not n.endswith("/dt")], 2))[:MOST_PAIRS]
    if not pairs or len(d) < 5 * VERTICES or not np.ptp(d) > 0:
        return None
    w = 1.0 / (deviation**2 + np.median(deviation) ** 2)
    w, fold = w / w.mean(), time_folds(len(d))
    Z = linear_block(candidates, names)
    base, penalty = np.column_stack([np.ones(len(d)), Z]), np.zeros((Z.shape[1] + 1,) * 2)
    if single:
        _, A, F = map_blocks(candidates[single])
        base = np.column_stack([A.toarray(), np.delete(Z, names.index(single), axis=1)])
        penalty = np.zeros((base.shape[1],) * 2)
        penalty[:A.shape[1], :A.shape[1]] = 1e-3 * (F.T @ F).toarray()
    left = d - _fitted(base, penalty, d, w)
    D = shifted_copies(left, rng, SHIFTS)
    before = heldout_errors(base, penalty, D, w, fold)
    gains = np.empty((len(pairs), D.shape[1]))
    for k, pair in enumerate(pairs):
        rest = np.column_stack([Z[:, [n not in pair for n in names]], base if single else Z[:, :0]])
        _, _, _, X, P = _design(np.column_stack([candidates[n] for n in pair]), rest)
        if single:
            P[-len(penalty):, -len(penalty):] = penalty
        gains[k] = np.max([1 - heldout_errors(X, r * P, D, w, fold) / before for r in RIDGES], axis=0)
    threshold = max(float(np.quantile(gains[:, 1:].max(axis=0), 0.95)), LEAST)
    order = np.argsort(-gains[:, 0])
    if gains[order[0], 0] <= threshold:
        return None
    pair = pairs[order[0]]
    others = Z[:, [n not in pair for n in names]]
    mesh, A, F, _, _ = _design(np.column_stack([candidates[n] for n in pair]), others)
    values, partial, gain = learn_map(mesh, A, F, d, w, others, fold, np.column_stack([np.ones(len(d)), Z]))
    added = gain - single_gain
    if added < (LEAST if not single else max(LEAST * (1.0 - single_gain), 0.5 * LEAST)):
        return None
    ranking = {pairs[k]: float(gains[k, 0]) for k in order}
    return PairShape(ranking, threshold, pair, PWAMap(mesh, values), gain, partial)


def _fitted(X, penalty, d, w) -> np.ndarray:
    XtW = X.T * w
    H = XtW @ X
    scale = np.trace(H) / len(H)
    return X @ np.linalg.solve(H + scale * (penalty + 1e-9 * np.eye(len(H))), XtW @ d)
