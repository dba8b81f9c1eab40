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
        get_cython_function_address("scipy.linalg.cython_blas", "dgemm"),
    ],
    dtype=np.int64,
)
_POTRF, _TRSM, _SYRK, _TRSV, _GEMV, _GEMM = range(6)
# The letters that BLAS takes, and numbers; both are passed by address.
_LETTERS = np.frombuffer(b"LNTR", dtype=np.uint8).copy()
_L, _N, _T, _R = range(4)
_NUMBERS = np.array([1.0, -1.0, 0.0])
_ONE, _MINUS, _ZERO = 0, 8, 16
# Columns of a front factorised at a time: triangular solves are slow, so little is left to them.
_BLOCK = 32


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
        self._entries = _gather(H, F, tree)
        self._entry_starts = np.searchsorted(self._entries[0], tree.panel_starts)
        self._diagonal, self._nothing = tree.entries(tree.order, tree.order), np.zeros(n)
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
        if diagonal is None:
            h_factor, diagonal = 1.0, self._nothing
        else:
            h_factor, diagonal = 0.0, diagonal[tree.order]
        integers = np.empty(6, np.int32)
        return _factorise(
            self._panels, tree.panel_starts, tree.starts, tree.parents, tree.row_starts, tree.places, tree.run_ends,
            tree.n_inner, self._stack, self._stack_starts, self._entry_starts, self._entries, weights, h_factor,
            diagonal, self._diagonal, shift, integers, _ADDRESSES, _LETTERS, _NUMBERS,
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


def _gather(H: sparse.csc_matrix, F: sparse.csr_matrix, tree: Any) -> tuple[np.ndarray, ...]:
    """For each entry of K: its place, H's value, and the products of entries of F that sum to it, with their rows."""
    counts = np.diff(F.indptr)
    starts = np.concatenate([[0], np.cumsum(counts * (counts + 1) // 2)])
    i, j, values = np.empty(starts[-1], np.int64), np.empty(starts[-1], np.int64), np.empty(starts[-1])
    _pairs(F.indptr, F.indices, F.data, starts, i, j, values)
    upper = sparse.coo_matrix(sparse.triu(H))
    of_h, of_f = tree.entries(upper.coords[0], upper.coords[1]), tree.entries(i, j)
    places = np.unique(np.concatenate([of_h, of_f]))
    h_values = np.zeros(places.size)
    h_values[np.searchsorted(places, of_h)] = upper.data
    row = np.repeat(np.arange(F.shape[0], dtype=np.int32), np.diff(starts))
    order = np.argsort(of_f, kind="stable")
    begins = np.searchsorted(of_f[order], np.append(places, tree.n_stored))
    return places, h_values, begins, row[order], values[order]


@numba.njit(cache=True)
def _pairs(indptr, indices, data, starts, i, j, values):
    for r in range(indptr.size - 1):
        t = starts[r]
        for a in range(indptr[r], indptr[r + 1]):
            for b in range(indptr[r], a + 1):
                i[t], j[t], values[t] = indices[a], indices[b], data[a] * data[b]
                t += 1


@numba.njit(cache=True)
def _fill(panel, low, high, places, first, h_values, begins, rows, values, weights, h_factor):
    """Sum the entries low … high − 1 of K into their front's panel, which begins at place `first`."""
    panel[:] = 0.0
    for e in range(low, high):
        total = h_factor * h_values[e]
        for t in range(begins[e], begins[e + 1]):
            total += weights[rows[t]] * values[t]
        panel[places[e] - first] = total


@numba.njit(cache=True)
def _extend_add(target, stride, shift, child, places, run_ends, low, high):
    """Add columns low … high − 1 of a child's update matrix to its parent's columns or update matrix."""
    mc = places.size
    for j in range(low, high):
        column = (places[j] - shift) * stride - shift
        i = j
        while i < mc:
            length = run_ends[i] - i
            into = target[column + places[i] : column + places[i] + length]
            added = child[j * mc + i : j * mc + i + length]
            for t in range(length):
                into[t] += added[t]
            i += length


@numba.njit(cache=True)
def _eliminate(at, k, size, ints, chars, reals, integers, routines):
    """Factorise a front's k columns in place, a block of columns at a time; whether it worked.

    A block is brought up to date by one product with all columns before it, its diagonal part factorised, and the
    rows below solved with that. `integers` holds: columns, rows, stride, info, columns before, rows below.
    """
    integers[2] = size
    for j in range(0, k, _BLOCK):
        width = min(_BLOCK, k - j)
        corner = at + 8 * (j * size + j)
        integers[0], integers[1], integers[3] = width, size - j, 0
        integers[4], integers[5] = j, size - j - width
        if j > 0:
            left = at + 8 * j
            _call(
                routines[5],
                (
                    chars + 1, chars + 2, ints + 4, ints, ints + 16, reals + 8, left, ints + 8, left, ints + 8, reals,
                    corner, ints + 8,
                ),
            )  # fmt: skip
        _call(routines[0], (chars, ints, corner, ints + 8, ints + 12))
        if integers[3] != 0:
            return False
        if integers[5] > 0:
            _call(
                routines[1],
                (
                    chars + 3, chars, chars + 2, chars + 1, ints + 20, ints, reals, corner, ints + 8,
                    corner + 8 * width, ints + 8,
                ),
            )  # fmt: skip
    return True


@numba.njit(cache=True)
def _factorise(
    panels, panel_starts, starts, parents, row_starts, places, run_ends, n_inner, stack, stack_starts, entry_starts,
    entries, weights, h_factor, diagonal, diagonal_places, shift, integers, routines, letters, numbers,
):  # fmt: skip
    entry_places, h_values, begins, rows, values = entries
    n_fronts = parents.size
    child, sibling = np.full(n_fronts, -1), np.full(n_fronts, -1)
    ints, chars, reals = integers.ctypes.data, letters.ctypes.data, numbers.ctypes.data
    for f in range(n_fronts):
        k = starts[f + 1] - starts[f]
        m = row_starts[f + 1] - row_starts[f]
        panel = panels[panel_starts[f] : panel_starts[f + 1]]
        _fill(
            panel, entry_starts[f], entry_starts[f + 1], entry_places, panel_starts[f], h_values, begins, rows, values,
            weights, h_factor,
        )  # fmt: skip
        for v in range(starts[f], starts[f + 1]):
            panels[diagonal_places[v]] = (panels[diagonal_places[v]] + diagonal[v]) * (1.0 + shift)
        update = stack[stack_starts[f] : stack_starts[f] + m * m]
        for j in range(m):
            update[j * m + j : (j + 1) * m] = 0.0
        c = child[f]
        while c >= 0:
            first, end, inner = row_starts[c], row_starts[c + 1], n_inner[c]
            its, to, ends = stack[stack_starts[c] :], places[first:end], run_ends[first:end]
            _extend_add(panel, k + m, 0, its, to, ends, 0, inner)
            _extend_add(update, m, k, its, to, ends, inner, end - first)
            c = sibling[c]
        at = panel.ctypes.data
        if not _eliminate(at, k, k + m, ints, chars, reals, integers, routines):
            return False
        if m > 0:
            integers[0], integers[1] = k, m
            _call(
                routines[2],
                (
                    chars, chars + 1, ints + 4, ints, reals + 8, at + 8 * k, ints + 8, reals, update.ctypes.data,
                    ints + 4,
                ),
            )  # fmt: skip
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
