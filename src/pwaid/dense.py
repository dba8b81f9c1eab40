"""The dense arithmetic of one front: a partial Cholesky factorisation, and solves with its columns.

A front of k own columns and m later rows holds its columns in a panel, (k + m) × k, and what they subtract from later
columns in an update matrix, m × m; both column-major, lower triangles only. Large fronts go to the BLAS and LAPACK
shipped inside SciPy, called from compiled code by the address of the routine; a small front costs less in a few
compiled loops than in calls.
"""

from __future__ import annotations

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import get_cython_function_address, intrinsic

__all__ = ["back_substitute", "forward_substitute", "letters", "numbers", "partial_cholesky", "routines"]

_POTRF, _TRSM, _SYRK, _GEMM = range(4)
# Columns factorised at a time by the BLAS: triangular solves are slow, so little is left to them.
_BLOCK = 32
# Fronts of at most this many rows are factorised without the BLAS.
_SMALL = 96

_compiled = numba.njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})


def routines(letter: str) -> np.ndarray:
    """The addresses of the routines for one precision ("s" or "d")."""
    lapack = [get_cython_function_address("scipy.linalg.cython_lapack", letter + "potrf")]
    names = ("trsm", "syrk", "gemm")
    blas = [get_cython_function_address("scipy.linalg.cython_blas", letter + name) for name in names]
    return np.array(lapack + blas, dtype=np.int64)


def letters() -> np.ndarray:
    """The letters that BLAS takes; passed by address."""
    return np.frombuffer(b"LNTR", dtype=np.uint8).copy()


def numbers(dtype: type) -> np.ndarray:
    """The numbers that BLAS takes; passed by address."""
    return np.array([1.0, -1.0], dtype)


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


@_compiled
def partial_cholesky(panel, update, k, m, integers, routines, letters, numbers):
    """Factorise a front's k columns in place and subtract their products from its update matrix; whether it worked.

    `integers` is work of 7 int32 whose addresses the BLAS gets.
    """
    if k + m <= _SMALL:
        return _by_loops(panel, update, k, m)
    return _by_blas(panel, update, k, m, integers, routines, letters, numbers)


@_compiled
def _by_loops(panel, update, k, m):
    size = k + m
    for j in range(k):
        column = panel[j * size + j : (j + 1) * size]
        _subtract(column, panel, size, j, j)
        pivot = column[0]
        if not pivot > 0.0:
            return False
        factor = 1.0 / np.sqrt(pivot)
        for i in range(column.size):
            column[i] *= factor
    for j in range(0, m - 1, 2):
        _subtract_two(update[j * m + j : j * m + m], update[(j + 1) * m + j : (j + 1) * m + m], panel, size, k + j, k)
    if m % 2 == 1:
        _subtract(update[m * m - 1 : m * m], panel, size, size - 1, k)
    return True


@_compiled
def _subtract(target, panel, size, row, count):
    """target −= Σ L[row, t] L[row:, t] over the first `count` columns, four at a time."""
    n = target.size
    t = 0
    while t + 4 <= count:
        a0, a1 = panel[t * size + row : (t + 1) * size], panel[(t + 1) * size + row : (t + 2) * size]
        a2, a3 = panel[(t + 2) * size + row : (t + 3) * size], panel[(t + 3) * size + row : (t + 4) * size]
        f0, f1, f2, f3 = a0[0], a1[0], a2[0], a3[0]
        for i in range(n):
            target[i] -= f0 * a0[i] + f1 * a1[i] + f2 * a2[i] + f3 * a3[i]
        t += 4
    while t < count:
        a0 = panel[t * size + row : (t + 1) * size]
        f0 = a0[0]
        for i in range(n):
            target[i] -= f0 * a0[i]
        t += 1


@_compiled
def _subtract_two(one, other, panel, size, row, count):
    """`_subtract` for two neighbouring columns; the entry above the second one's diagonal is filled too."""
    n = one.size
    t = 0
    while t + 4 <= count:
        a0, a1 = panel[t * size + row : (t + 1) * size], panel[(t + 1) * size + row : (t + 2) * size]
        a2, a3 = panel[(t + 2) * size + row : (t + 3) * size], panel[(t + 3) * size + row : (t + 4) * size]
        f0, f1, f2, f3 = a0[0], a1[0], a2[0], a3[0]
        g0, g1, g2, g3 = a0[1], a1[1], a2[1], a3[1]
        for i in range(n):
            one[i] -= f0 * a0[i] + f1 * a1[i] + f2 * a2[i] + f3 * a3[i]
            other[i] -= g0 * a0[i] + g1 * a1[i] + g2 * a2[i] + g3 * a3[i]
        t += 4
    while t < count:
        a0 = panel[t * size + row : (t + 1) * size]
        f0, g0 = a0[0], a0[1]
        for i in range(n):
            one[i] -= f0 * a0[i]
            other[i] -= g0 * a0[i]
        t += 1


@_compiled
def _by_blas(panel, update, k, m, integers, routines, letters, numbers):
    """Right-looking and recursive, unrolled: after block b, the last 2^s blocks update the next 2^s, 2^s | b + 1."""
    size, unit = k + m, panel.itemsize
    at, ints, chars, reals = panel.ctypes.data, integers.ctypes.data, letters.ctypes.data, numbers.ctypes.data
    L, N, T, R, one, minus = chars, chars + 1, chars + 2, chars + 3, reals, reals + unit
    width, below, stride, info, source, rest = ints, ints + 4, ints + 8, ints + 12, ints + 16, ints + 20
    integers[2] = size
    for j in range(0, k, _BLOCK):
        integers[0] = min(_BLOCK, k - j)
        end = j + integers[0]
        integers[1], integers[3] = size - end, 0
        corner = at + unit * (j * size + j)
        _call(routines[_POTRF], (L, width, corner, stride, info))
        if integers[3] != 0:
            return False
        if end == size:
            break
        _call(
            routines[_TRSM],
            (R, L, T, N, below, width, one, corner, stride, at + unit * (j * size + end), stride),
        )
        if end == k:
            break
        blocks = end // _BLOCK
        integers[4] = _BLOCK * (blocks & -blocks)
        integers[0] = min(integers[4], k - end)
        integers[5] = size - end - integers[0]
        left, target = at + unit * ((end - integers[4]) * size + end), at + unit * (end * size + end)
        _call(routines[_SYRK], (L, N, width, source, minus, left, stride, one, target, stride))
        if integers[5] > 0:
            lower = unit * integers[0]
            _call(
                routines[_GEMM],
                (N, T, rest, width, source, minus, left + lower, stride, left, stride, one, target + lower, stride),
            )
    if m > 0:
        integers[0], integers[1] = k, m
        _call(
            routines[_SYRK],
            (L, N, below, width, minus, at + unit * k, stride, one, update.ctypes.data, below),
        )
    return True


@_compiled
def forward_substitute(panel, pivots, k, w):
    """Solve for a front's unknowns w[:k] and subtract what they contribute to the later rows w[k:]; L w = b."""
    size = w.size
    j = 0
    while j + 4 <= k:
        a0, a1 = panel[j * size + j : (j + 1) * size], panel[(j + 1) * size + j : (j + 2) * size]
        a2, a3 = panel[(j + 2) * size + j : (j + 3) * size], panel[(j + 3) * size + j : (j + 4) * size]
        x0 = w[j] * pivots[j]
        x1 = (w[j + 1] - a0[1] * x0) * pivots[j + 1]
        x2 = (w[j + 2] - a0[2] * x0 - a1[2] * x1) * pivots[j + 2]
        x3 = (w[j + 3] - a0[3] * x0 - a1[3] * x1 - a2[3] * x2) * pivots[j + 3]
        w[j], w[j + 1], w[j + 2], w[j + 3] = x0, x1, x2, x3
        rest, a0, a1, a2, a3 = w[j + 4 :], a0[4:], a1[4:], a2[4:], a3[4:]
        for i in range(rest.size):
            rest[i] -= a0[i] * x0 + a1[i] * x1 + a2[i] * x2 + a3[i] * x3
        j += 4
    while j < k:
        x0 = w[j] * pivots[j]
        w[j] = x0
        rest, a0 = w[j + 1 :], panel[j * size + j + 1 : (j + 1) * size]
        for i in range(rest.size):
            rest[i] -= a0[i] * x0
        j += 1


@_compiled
def back_substitute(panel, pivots, k, w):
    """Solve for a front's unknowns w[:k] from the later rows w[k:]; Lᵀ w = b."""
    size = w.size
    j = k
    while j % 4 != 0:
        j -= 1
        rest, a0 = w[j + 1 :], panel[j * size + j + 1 : (j + 1) * size]
        total = w[j]
        for i in range(rest.size):
            total -= a0[i] * rest[i]
        w[j] = total * pivots[j]
    while j > 0:
        j -= 4
        b0, b1 = panel[j * size + j : (j + 1) * size], panel[(j + 1) * size + j : (j + 2) * size]
        b2, b3 = panel[(j + 2) * size + j : (j + 3) * size], panel[(j + 3) * size + j : (j + 4) * size]
        rest, a0, a1, a2, a3 = w[j + 4 :], b0[4:], b1[4:], b2[4:], b3[4:]
        s0, s1, s2, s3 = w[j], w[j + 1], w[j + 2], w[j + 3]
        for i in range(rest.size):
            s0 -= a0[i] * rest[i]
            s1 -= a1[i] * rest[i]
            s2 -= a2[i] * rest[i]
            s3 -= a3[i] * rest[i]
        x3 = s3 * pivots[j + 3]
        x2 = (s2 - b2[3] * x3) * pivots[j + 2]
        x1 = (s1 - b1[2] * x2 - b1[3] * x3) * pivots[j + 1]
        x0 = (s0 - b0[1] * x1 - b0[2] * x2 - b0[3] * x3) * pivots[j]
        w[j], w[j + 1], w[j + 2], w[j + 3] = x0, x1, x2, x3
