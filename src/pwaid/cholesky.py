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
from llvmlite import ir
from numba import types
from numba.extending import get_cython_function_address, intrinsic
from scipy import sparse

from pwaid.dissection import dissect

__all__ = ["NormalMatrix"]

_ADDRESSES = np.array(
    [
        get_cython_function_address("scipy.linalg.cython_lapack", "dpotrf"),
        get_cython_function_address("scipy.linalg.cython_blas", "dtrsm"),
        get_cython_function_address("scipy.linalg.cython_blas", "dsyrk"),
        get_cython_function_address("scipy.linalg.cython_blas", "dtrsv"),
        get_cython_function_address("scipy.linalg.cython_blas", "dgemv"),
    ],
    dtype=np.int64,
)
_POTRF, _TRSM, _SYRK, _TRSV, _GEMV = range(5)
# The letters that BLAS takes, and numbers; both are passed by address.
_LETTERS = np.frombuffer(b"LNTR", dtype=np.uint8).copy()
_L, _N, _T, _R = range(4)
_NUMBERS = np.array([1.0, -1.0, 0.0])
_ONE, _MINUS, _ZERO = 0, 8, 16


@intrinsic
def _call(typingctx, address, arguments):
    """Call the routine at `address`; all its arguments are addresses, as in Fortran."""

    def generate(context, builder, signature, values):
        pointer = ir.IntType(8).as_pointer()
        given = [
            builder.inttoptr(builder.extract_value(values[1], i), pointer) for i in range(signature.args[1].count)
        ]
        routine = ir.FunctionType(ir.VoidType(), [pointer] * len(given)).as_pointer()
        builder.call(builder.inttoptr(values[0], routine), given)
        return context.get_dummy_value()

    return types.void(types.int64, arguments), generate


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
        upper = sparse.coo_matrix(sparse.triu(H))
        self._h_places = tree.entries(upper.coords[0], upper.coords[1])
        self._h_values = upper.data.astype(float)
        self._f_starts, self._f_places, self._f_values = _products(F, tree)
        self._diagonal = tree.entries(np.arange(n), np.arange(n))
        self._panels = np.zeros(tree.n_stored)
        starts, peak = tree.stack_starts
        self._stack_starts, self._stack = starts, np.empty(max(1, peak))
        m = np.diff(tree.row_starts)
        self._work = np.empty(int(m.max(initial=1)) + n)
        self.n_factorisations = 0

    def factorise(self, weights: np.ndarray, *, shift: float = 0.0, diagonal: np.ndarray | None = None) -> bool:
        """Factorise K for D = diag(weights); whether it worked.

        Parameters
        ----------
        weights : ndarray, shape (m,)
        shift : float
            Raise the diagonal by this fraction of itself, against breakdown by rounding.
        diagonal : ndarray, shape (n,), optional
            Put this diagonal matrix in the place of H.
        """
        self.n_factorisations += 1
        tree = self.tree
        values = self._h_values if diagonal is None else self._h_values[:0]
        _fill(self._panels, self._h_places, values, self._f_starts, self._f_places, self._f_values, weights)
        if diagonal is not None:
            self._panels[self._diagonal] += diagonal
        if shift > 0.0:
            self._panels[self._diagonal] *= 1.0 + shift
        integers = np.empty(4, np.int32)
        return _factorise(
            self._panels, tree.panel_starts, tree.starts, tree.parents, tree.row_starts, tree.places,
            self._stack, self._stack_starts, integers, _ADDRESSES, _LETTERS, _NUMBERS,
        )  # fmt: skip

    def solve(self, b: np.ndarray) -> np.ndarray:
        """K⁻¹ b for the last factorisation, b of shape (n,)."""
        tree = self.tree
        x = b[tree.order]
        integers = np.empty(4, np.int32)
        _solve(
            self._panels, tree.panel_starts, tree.starts, tree.row_starts, tree.rows, x, self._work,
            integers, _ADDRESSES, _LETTERS, _NUMBERS,
        )  # fmt: skip
        out = np.empty_like(x)
        out[tree.order] = x
        return out


def _products(F: sparse.csr_matrix, tree: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each row of F the pairwise products of its entries and where they go."""
    counts = np.diff(F.indptr)
    starts = np.concatenate([[0], np.cumsum(counts * (counts + 1) // 2)])
    i, j, values = np.empty(starts[-1], np.int64), np.empty(starts[-1], np.int64), np.empty(starts[-1])
    _pairs(F.indptr, F.indices, F.data, starts, i, j, values)
    return starts, tree.entries(i, j), values


@numba.njit(cache=True)
def _pairs(indptr, indices, data, starts, i, j, values):
    for r in range(indptr.size - 1):
        t = starts[r]
        for a in range(indptr[r], indptr[r + 1]):
            for b in range(indptr[r], a + 1):
                i[t], j[t], values[t] = indices[a], indices[b], data[a] * data[b]
                t += 1


@numba.njit(cache=True)
def _fill(panels, h_places, h_values, f_starts, f_places, f_values, weights):
    panels[:] = 0.0
    for e in range(h_values.size):
        panels[h_places[e]] += h_values[e]
    for r in range(weights.size):
        w = weights[r]
        for e in range(f_starts[r], f_starts[r + 1]):
            panels[f_places[e]] += w * f_values[e]


@numba.njit(cache=True)
def _extend_add(panel, k, size, update, m, child, places, mc):
    """Add a child's update matrix to its parent's panel (first k columns); the rest to the parent's update matrix."""
    for j in range(mc):
        column = places[j]
        base = j * mc
        if column < k:
            to = column * size
            for i in range(j, mc):
                panel[to + places[i]] += child[base + i]
        else:
            to = (column - k) * m - k
            for i in range(j, mc):
                update[to + places[i]] += child[base + i]


@numba.njit(cache=True)
def _factorise(
    panels, panel_starts, starts, parents, row_starts, places, stack, stack_starts, integers, routines, letters, numbers
):
    n_fronts = parents.size
    child, sibling = np.full(n_fronts, -1), np.full(n_fronts, -1)
    ints, chars, reals = integers.ctypes.data, letters.ctypes.data, numbers.ctypes.data
    top = 0
    for f in range(n_fronts):
        k = starts[f + 1] - starts[f]
        m = row_starts[f + 1] - row_starts[f]
        size = k + m
        panel = panels[panel_starts[f] : panel_starts[f + 1]]
        update = stack[top : top + m * m]
        update[:] = 0.0
        c = child[f]
        while c >= 0:
            mc = row_starts[c + 1] - row_starts[c]
            _extend_add(
                panel, k, size, update, m, stack[stack_starts[c] : stack_starts[c] + mc * mc],
                places[row_starts[c] : row_starts[c + 1]], mc,
            )  # fmt: skip
            c = sibling[c]
        integers[0], integers[1], integers[2], integers[3] = k, m, size, 0
        at = panel.ctypes.data
        _call(routines[0], (chars, ints, at, ints + 8, ints + 12))
        if integers[3] != 0:
            return False
        if m > 0:
            below = at + 8 * k
            _call(
                routines[1],
                (chars + 3, chars, chars + 2, chars + 1, ints + 4, ints, reals, at, ints + 8, below, ints + 8),
            )
            _call(
                routines[2],
                (chars, chars + 1, ints + 4, ints, reals + 8, below, ints + 8, reals, update.ctypes.data, ints + 4),
            )
            to = stack_starts[f]
            if to != top:
                for t in range(m * m):
                    stack[to + t] = stack[top + t]
            top = to + m * m
        else:
            top = stack_starts[f]
        p = parents[f]
        if p >= 0:
            sibling[f] = child[p]
            child[p] = f
    return True


@numba.njit(cache=True)
def _solve(panels, panel_starts, starts, row_starts, rows, x, work, integers, routines, letters, numbers):
    n_fronts = starts.size - 1
    ints, chars, reals = integers.ctypes.data, letters.ctypes.data, numbers.ctypes.data
    integers[3] = 1
    for f in range(n_fronts):
        k = starts[f + 1] - starts[f]
        m = row_starts[f + 1] - row_starts[f]
        integers[0], integers[1], integers[2] = k, m, k + m
        at = panels.ctypes.data + 8 * panel_starts[f]
        here = x.ctypes.data + 8 * starts[f]
        _call(routines[3], (chars, chars + 1, chars + 1, ints, at, ints + 8, here, ints + 12))
        if m > 0:
            _call(
                routines[4],
                (
                    chars + 1, ints + 4, ints, reals, at + 8 * k, ints + 8, here, ints + 12, reals + 16,
                    work.ctypes.data, ints + 12,
                ),
            )  # fmt: skip
            first = row_starts[f]
            for t in range(m):
                x[rows[first + t]] -= work[t]
    for f in range(n_fronts - 1, -1, -1):
        k = starts[f + 1] - starts[f]
        m = row_starts[f + 1] - row_starts[f]
        integers[0], integers[1], integers[2] = k, m, k + m
        at = panels.ctypes.data + 8 * panel_starts[f]
        here = x.ctypes.data + 8 * starts[f]
        if m > 0:
            first = row_starts[f]
            for t in range(m):
                work[t] = x[rows[first + t]]
            _call(
                routines[4],
                (
                    chars + 2, ints + 4, ints, reals + 8, at + 8 * k, ints + 8, work.ctypes.data, ints + 12, reals,
                    here, ints + 12,
                ),
            )  # fmt: skip
        _call(routines[3], (chars, chars + 2, chars + 1, ints, at, ints + 8, here, ints + 12))
