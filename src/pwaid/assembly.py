"""AᵀA, Aᵀy and yᵀy from samples in chunks, never holding A.

All samples of one simplex share its d + 1 vertices, so their part of AᵀA is one small dense matrix. These are summed
simplex by simplex and put together once, at the end: memory is that of the mesh, whatever the number of samples.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numba
import numpy as np
from scipy import sparse

from pwaid.delaunay import SimplexMesh
from pwaid.errors import InputError
from pwaid.recording import check_samples

__all__ = ["SampleSums"]


class SampleSums:
    """Running sums over samples on a mesh.

    Parameters
    ----------
    mesh : SimplexMesh
    outside : {"raise", "drop"}
        Whether samples outside the mesh raise `OutsideMeshError` or are left out (counted in `n_dropped`).
    """

    def __init__(self, mesh: SimplexMesh, *, outside: str = "raise"):
        if outside not in ("raise", "drop"):
            raise InputError(f"outside is {outside!r}; expected 'raise' or 'drop'")
        k = mesh.dimension + 1
        self.mesh, self.outside = mesh, outside
        self._squares = np.zeros((mesh.n_simplices, k, k))
        self._products = np.zeros((mesh.n_simplices, k))
        self.yty, self.n, self.n_dropped = 0.0, 0, 0

    def add(self, X: Any, y: Any) -> None:
        """Add samples X, shape (n, d), and y, shape (n,)."""
        X, y = check_samples(X, y, dimension=self.mesh.dimension, part=True)
        simplex, weights = self.mesh.locate(X)
        if self.outside == "raise":
            self.mesh.require_inside(simplex, X)
        inside = simplex >= 0
        _accumulate(simplex, weights, y, self._squares, self._products)
        self.yty += float(y[inside] @ y[inside])
        self.n += int(inside.sum())
        self.n_dropped += int((~inside).sum())

    def add_all(self, chunks: Iterable[tuple[Any, Any]]) -> None:
        """Add every (X, y) of an iterable."""
        for chunk in chunks:
            if not isinstance(chunk, (tuple, list)) or len(chunk) != 2:
                raise InputError(f"a chunk is {type(chunk).__name__}; expected pairs (X, y)")
            self.add(*chunk)

    @property
    def AtA(self) -> sparse.csc_matrix:
        """AᵀA, shape (n_points, n_points)."""
        n, k = self.mesh.n_points, self.mesh.dimension + 1
        used = np.flatnonzero(self._products.any(axis=1) | self._squares.any(axis=(1, 2)))
        vertices = self.mesh.simplices[used]
        rows = np.repeat(vertices, k, axis=1).ravel()
        columns = np.tile(vertices, (1, k)).ravel()
        return sparse.coo_matrix((self._squares[used].ravel(), (rows, columns)), (n, n)).tocsc()

    @property
    def Aty(self) -> np.ndarray:
        """Aᵀy, shape (n_points,)."""
        return np.bincount(self.mesh.simplices.ravel(), self._products.ravel(), self.mesh.n_points)


@numba.njit(cache=True)
def _accumulate(simplex, weights, y, squares, products):
    k = weights.shape[1]
    for i in range(simplex.size):
        s = simplex[i]
        if s < 0:
            continue
        for a in range(k):
            products[s, a] += weights[i, a] * y[i]
            for b in range(k):
                squares[s, a, b] += weights[i, a] * weights[i, b]
