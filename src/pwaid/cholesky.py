"""Sparse Cholesky factorisation of K(D) = H + FᵀDF for many diagonal D on one pattern.

The order and the fronts come from `pwaid.dissection`, once a problem. Each factorisation scatters the entries of H
and F into the dense columns of the fronts and runs the multifrontal method: a front's pivot block is factorised,
its update matrix added to the parent's front. The dense work is BLAS and LAPACK as shipped inside SciPy, called
from compiled code by the address of the routine, so nothing but NumPy, SciPy and Numba is needed.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from scipy import sparse

from pwaid import dense
from pwaid.dissection import dissect

__all__ = ["NormalMatrix"]

_LETTERS = dense.letters()
# A factorisation in single precision passes when a solve with it leaves at most this fraction of the right-hand side.
_PROBE_LEFT = 1e-2


class NormalMatrix:
    """K(D) = H + FᵀDF with one symbolic analysis for every positive diagonal D.

    Parameters
    ----------
    H : sparse matrix, shape (n, n)
        Symmetric positive semidefinite.
    F : sparse matrix, shape (m, n)
    coordinates : ndarray, shape (n, d), optional
        Where the unknowns lie; they make a good elimination order cheap.
    """

    def __init__(self, H: Any, F: Any, coordinates: Any = None):
        H, F = sparse.csc_matrix(H), sparse.csr_matrix(F)
        n = F.shape[1]
        ones = sparse.csr_matrix((np.ones(F.data.size), F.indices, F.indptr), F.shape)
        filled = sparse.csc_matrix((np.ones(H.data.size), H.indices, H.indptr), H.shape)
        pattern = sparse.csr_matrix(ones.T @ ones + filled + sparse.eye_array(n))
        self.tree = tree = dissect(pattern.indptr, pattern.indices, coordinates)
        self._H, self._F, self._FT = H, F, F.T.tocsr()
        self._terms = _terms(H, F, tree)
        self._entry_starts = np.searchsorted(self._terms[0], tree.panel_starts)
        self._values = np.empty(self._terms[0].size)
        self._diagonal = np.searchsorted(self._terms[0], tree.entries(tree.order, tree.order))
        self._scale = np.ones(n)
        self._stores: dict[bool, _Store] = {}
        self._store: _Store | None = None
        self._probe = np.random.default_rng(0).choice([-1.0, 1.0], n)
        self.n_factorisations = 0

    def factorise(
        self,
        weights: np.ndarray,
        *,
        shift: float = 0.0,
        diagonal: np.ndarray | None = None,
        single: bool = False,
    ) -> bool:
        """Factorise K for D = diag(weights); whether it worked.

        K is scaled to a unit diagonal first.

        Parameters
        ----------
        weights : ndarray, shape (m,)
        shift : float
            Raise the diagonal by this fraction of itself, against breakdown by rounding.
        diagonal : ndarray, shape (n,), optional
            Put this diagonal matrix in the place of H.
        single : bool
            In single precision: half the time and memory. It counts as a failure when a solve of a test equation
            leaves more than 1 % of its right-hand side.
        """
        self.n_factorisations += 1
        tree, (places, *sums) = self.tree, self._terms
        h_factor, added = (1.0, np.zeros(1)) if diagonal is None else (0.0, diagonal[tree.order])
        _scaled_values(self._values, self._scale, *sums, weights, h_factor, added, self._diagonal)
        self._store = store = self._stores.setdefault(single, _Store(tree, single))
        worked = _factorise(
            store.panels, tree.panel_starts, tree.starts, tree.parents, tree.row_starts, tree.places, tree.n_inner,
            store.stack, tree.stack_starts[0], places, self._entry_starts, self._values, shift, store.pivots,
            np.empty(6, np.int32), store.routines, _LETTERS, store.numbers,
        )  # fmt: skip
        return worked and (not single or self._passes(weights, diagonal))

    def solve(self, b: np.ndarray) -> np.ndarray:
        """K⁻¹ b for the last factorisation, b of shape (n,)."""
        tree, store, out = self.tree, self._store, np.empty(self.tree.order.size)
        _solve(
            store.panels, tree.panel_starts, tree.starts, tree.row_starts, tree.rows, store.pivots, tree.order,
            self._scale, b, store.x, store.work, out,
        )  # fmt: skip
        return out

    def _passes(self, weights: np.ndarray, diagonal: np.ndarray | None) -> bool:
        """Whether a solve for a right-hand side of all frequencies leaves little of it, in the scaled equation."""
        scale = np.empty_like(self._scale)
        scale[self.tree.order] = self._scale
        b = self._probe / scale
        x = self.solve(b)
        left = b - self._FT @ (weights * (self._F @ x)) - (self._H @ x if diagonal is None else diagonal * x)
        return float(np.linalg.norm(scale * left)) <= _PROBE_LEFT * np.sqrt(b.size)


class _Store:
    """What a factorisation in one precision fills."""

    def __init__(self, tree: Any, single: bool):
        dtype = np.float32 if single else np.float64
        self.panels = np.zeros(tree.n_stored, dtype)
        self.stack = np.empty(max(1, tree.stack_starts[1]), dtype)
        self.pivots, self.x = np.empty(tree.order.size, dtype), np.empty(tree.order.size, dtype)
        self.work = np.empty(int((np.diff(tree.starts) + np.diff(tree.row_starts)).max(initial=1)), dtype)
        self.routines = dense.routines("s" if single else "d")
        self.numbers = dense.numbers(dtype)


def _terms(H: sparse.csc_matrix, F: sparse.csr_matrix, tree: Any) -> tuple[np.ndarray, ...]:
    """The entries of K below the diagonal, in the order of their places, and the terms they are sums of.

    Returns their places, positions in the order of elimination (two arrays), H's values; and for FᵀDF, row by row of
    F, where each row's terms begin, the entry each term goes to, and the product of two of the row's entries.
    """
    counts = np.diff(F.indptr)
    starts = np.concatenate([[0], np.cumsum(counts * (counts + 1) // 2)])
    i, j, values = np.empty(starts[-1], np.int64), np.empty(starts[-1], np.int64), np.empty(starts[-1])
    _pairs(F.indptr, F.indices, F.data, starts, i, j, values)
    upper = sparse.coo_matrix(sparse.triu(H))
    of_h, of_f = tree.entries(upper.coords[0], upper.coords[1]), tree.entries(i, j)
    of_diagonal = tree.entries(tree.order, tree.order)
    places, first = np.unique(np.concatenate([of_h, of_f, of_diagonal]), return_index=True)
    one, other = (
        tree.position[np.concatenate([a, b, tree.order])[first]].astype(np.uint32)
        for a, b in zip(upper.coords, (i, j), strict=True)
    )
    h_values = np.zeros(places.size)
    h_values[np.searchsorted(places, of_h)] = upper.data
    return places, one, other, h_values, starts, np.searchsorted(places, of_f).astype(np.uint32), values


@numba.njit(cache=True)
def _pairs(indptr, indices, data, starts, i, j, values):
    for r in range(indptr.size - 1):
        t = starts[r]
        for a in range(indptr[r], indptr[r + 1]):
            for b in range(indptr[r], a + 1):
                i[t], j[t], values[t] = indices[a], indices[b], data[a] * data[b]
                t += 1


@numba.njit(cache=True)
def _scaled_values(out, scale, one, other, h_values, starts, entries, values, weights, h_factor, added, diagonal):
    """The entries of K, scaled to a unit diagonal by `scale` on either side."""
    for e in range(out.size):
        out[e] = h_factor * h_values[e]
    for r in range(weights.size):
        for t in range(starts[r], starts[r + 1]):
            out[entries[t]] += weights[r] * values[t]
    for v in range(diagonal.size):
        out[diagonal[v]] += added[v % added.size]
        d = out[diagonal[v]]
        scale[v] = 1.0 / np.sqrt(d) if d > 0.0 else 1.0
    for e in range(out.size):
        out[e] *= scale[one[e]] * scale[other[e]]


@numba.njit(cache=True)
def _extend_add(target, stride, shift, child, places, low, high):
    """Add columns low … high − 1 of a child's update matrix to its parent's columns or update matrix."""
    mc = places.size
    for j in range(low, high):
        column = np.uint64((places[j] - shift) * stride - shift)  # unsigned: no test for negative places
        added, rows = child[j * mc + j : (j + 1) * mc], places[j:]
        for t in range(rows.size):
            target[np.uint64(rows[t]) + column] += added[t]


@numba.njit(cache=True)
def _factorise(
    panels, panel_starts, starts, parents, row_starts, places, n_inner, stack, stack_starts, entry_places,
    entry_starts, values, shift, pivots, integers, routines, letters, numbers,
):  # fmt: skip
    """Factorise front by front; `pivots` takes the reciprocals of L's diagonal. Whether it worked."""
    n_fronts = parents.size
    child, sibling = np.full(n_fronts, -1), np.full(n_fronts, -1)
    for f in range(n_fronts):
        k = starts[f + 1] - starts[f]
        m = row_starts[f + 1] - row_starts[f]
        panel = panels[panel_starts[f] : panel_starts[f + 1]]
        panel[:] = 0.0
        for e in range(entry_starts[f], entry_starts[f + 1]):
            panel[entry_places[e] - panel_starts[f]] = values[e]
        for v in range(k):
            panel[v * (k + m) + v] *= 1.0 + shift
        update = stack[stack_starts[f] : stack_starts[f] + m * m]
        update[:] = 0.0
        c = child[f]
        while c >= 0:
            first, end, inner = row_starts[c], row_starts[c + 1], n_inner[c]
            its, to = stack[stack_starts[c] :], places[first:end]
            _extend_add(panel, k + m, 0, its, to, 0, inner)
            _extend_add(update, m, k, its, to, inner, end - first)
            c = sibling[c]
        if not dense.partial_cholesky(panel, update, k, m, integers, routines, letters, numbers):
            return False
        for v in range(k):
            pivots[starts[f] + v] = 1.0 / panel[v * (k + m) + v]
        p = parents[f]
        if p >= 0:
            sibling[f] = child[p]
            child[p] = f
    return True


@numba.njit(cache=True)
def _solve(panels, panel_starts, starts, row_starts, rows, pivots, order, scale, b, x, work, out):
    """Both triangular solves; x and work are work."""
    n_fronts = starts.size - 1
    for i in range(order.size):
        x[i] = b[order[i]] * scale[i]
    for f in range(n_fronts):
        begin, k = starts[f], starts[f + 1] - starts[f]
        later = rows[row_starts[f] : row_starts[f + 1]]
        w = work[: k + later.size]
        w[:k] = x[begin : begin + k]
        w[k:] = 0.0
        dense.forward_substitute(panels[panel_starts[f] : panel_starts[f + 1]], pivots[begin : begin + k], k, w)
        x[begin : begin + k] = w[:k]
        for t in range(later.size):
            x[later[t]] += w[k + t]
    for f in range(n_fronts - 1, -1, -1):
        begin, k = starts[f], starts[f + 1] - starts[f]
        later = rows[row_starts[f] : row_starts[f + 1]]
        w = work[: k + later.size]
        w[:k] = x[begin : begin + k]
        for t in range(later.size):
            w[k + t] = x[later[t]]
        dense.back_substitute(panels[panel_starts[f] : panel_starts[f + 1]], pivots[begin : begin + k], k, w)
        x[begin : begin + k] = w[:k]
    for i in range(order.size):
        out[order[i]] = x[i] * scale[i]
