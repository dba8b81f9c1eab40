"""Functions of matrices, of `numpy.linalg` and `scipy.linalg`, as a function on symbols sees them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg

from pwaid.mismatch.symbolic import Symbol, TraceFailure, apply, as_numbers, is_symbolic

__all__ = ["NUMPY_LINALG", "SCIPY_LINALG"]


def _solve(a, b):
    a, b = np.asarray(a, dtype=object), np.asarray(b, dtype=object)
    n = len(a)
    if a.shape != (n, n) or b.ndim > 2 or len(b) != n:
        raise TraceFailure("it solves equations of a shape that is not square")
    columns = [_items("solve", [*a.flat, *column], n) for column in b.reshape(n, -1).T]
    return np.array(columns, dtype=object).T.reshape(b.shape)


def _items(name: str, entries, count: int) -> list[Symbol]:
    """The `count` numbers that one operation on all of these entries gives."""
    tape = next(v.tape for v in entries if isinstance(v, Symbol))
    whole = tape.node(name, *(v.node if isinstance(v, Symbol) else tape.constant(v) for v in entries))
    return [tape.symbol("item", whole, k) for k in range(count)]


def _inverse(a):
    return _solve(a, np.eye(len(a), dtype=object))


def _determinant(a):
    a = np.asarray(a, dtype=object)
    if len(a) == 1:
        return a[0, 0]
    return sum((-1) ** k * a[0, k] * _determinant(np.delete(a[1:], k, axis=1)) for k in range(len(a)))


def _norm(a):
    return apply("sqrt", sum(v * v for v in np.asarray(a, dtype=object).flat))


def _exponential(a):
    """Matrix exponential: a simulator that samples its own matrices."""
    a = np.asarray(a, dtype=object)
    if a.ndim != 2 or len(set(a.shape)) != 1:
        raise TraceFailure("it takes the exponential of what is no square matrix")
    return np.array(_items("expm", list(a.flat), a.size), dtype=object).reshape(a.shape)


def _either(original: Callable, name: str) -> Callable:
    """A function of matrices, done by ours where one holds symbols."""
    mine, most = _MINE[name]

    def either(*arguments, **options):
        if not any(is_symbolic(a) for a in arguments):
            return original(*(as_numbers(np.asarray(a)) if isinstance(a, list | tuple) else as_numbers(a)
                              for a in arguments), **options)
        if options or len(arguments) > most:
            raise TraceFailure(f"it calls {name} of linalg with options")
        return mine(*arguments)

    return either


_MINE = {"solve": (_solve, 2), "inv": (_inverse, 1), "det": (_determinant, 1), "norm": (_norm, 1),
         "expm": (_exponential, 1)}  # with the arguments that they take
NUMPY_LINALG, SCIPY_LINALG = ({name: _either(getattr(module, name), name) for name in _MINE if hasattr(module, name)}
                              for module in (np.linalg, scipy.linalg))
