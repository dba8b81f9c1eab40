"""NumPy, math, scipy.linalg, control.ss, control.tf and a few builtins as a function on symbols sees them: functions
of numbers take symbols, and arrays that are made can hold them."""

from __future__ import annotations

import functools
import math
import operator
import types
from collections.abc import Callable

import control
import numpy as np
import scipy.linalg

from pwaid.mismatch.symbolic import (
    FUNCTIONS,
    OTHER_NAMES,
    Symbol,
    TraceFailure,
    apply,
    as_numbers,
    by_name,
    elementwise,
    is_symbolic,
)
from pwaid.mismatch.traced_linalg import NUMPY_LINALG, SCIPY_LINALG

__all__ = ["BUILTINS", "replacements"]


def _function(name: str, original: Callable) -> Callable:
    spread, known = by_name(name), FUNCTIONS[name][0]
    most = known.nin if isinstance(known, np.ufunc) else 2  # min, max and the operators

    @functools.wraps(original, updated=())
    def either(*arguments, **options):
        if any(is_symbolic(a) for a in arguments):
            if set(options) - {"dtype"}:
                raise TraceFailure(f"it calls numpy's {name} with {', '.join(options)}")
            if len(arguments) > most:
                raise TraceFailure(f"it calls {name} with {len(arguments)} arguments")
            return spread(*arguments)
        return original(*(as_numbers(a) for a in arguments), **options)

    return either


def _where(condition, *choices):
    if not choices or not any(is_symbolic(a) for a in (condition, *choices)):
        return np.where(as_numbers(condition), *(as_numbers(c) for c in choices))
    return elementwise(_choose)(condition, *choices)


def _first_that_holds(conditions, choices, default=0):
    """`numpy.select`."""
    if not is_symbolic([*conditions, *choices, default]):
        return np.select(conditions, choices, default)
    for condition, choice in zip(conditions[::-1], choices[::-1], strict=True):
        default = _where(condition, choice, default)
    return default


def _choose(condition, a, b):
    if not isinstance(condition, Symbol):
        return a if condition else b
    return apply("select", condition if condition.truth else apply("not_equal", condition, 0.0), a, b)


def _clip(a, a_min=None, a_max=None, **bounds):
    if bounds.keys() - {"min", "max"}:
        raise TraceFailure(f"it calls numpy's clip with {', '.join(bounds)}")
    low, high = bounds.get("min", a_min), bounds.get("max", a_max)
    a = a if low is None else _MINE["maximum"](a, low)
    return a if high is None else _MINE["minimum"](a, high)


def _holding_objects(make: Callable) -> Callable:
    """An array function whose floats become objects, so that symbols can be stored among them."""

    @functools.wraps(make, updated=())
    def made(*arguments, **options):
        dtype = options.get("dtype")
        symbolic = any(is_symbolic(a) for a in arguments)
        if symbolic:
            options["dtype"] = object
            arguments = arguments[:1] if make in (np.array, np.asarray, np.asanyarray) else arguments
        result = make(*arguments, **options)
        if symbolic and dtype in (int, bool, "int", "bool"):
            raise TraceFailure("it turns a number into an integer")
        return result.astype(object) if result.dtype.kind == "f" else result

    return made


def _like(make: Callable) -> Callable:
    return lambda a, dtype=None, **options: make(np.shape(a), **options).astype(object)


def _interp(x, xp, fp, left=None, right=None, period=None):
    if not any(is_symbolic(a) for a in (x, xp, fp)):
        return np.interp(as_numbers(x), as_numbers(xp), as_numbers(fp), left, right, period)
    if is_symbolic(xp) or is_symbolic(fp) or period is not None:
        raise TraceFailure("it interpolates in a table that is not fixed")
    table = (tuple(float(v) for v in xp), tuple(float(v) for v in fp),
             float(fp[0] if left is None else left), float(fp[-1] if right is None else right))
    return elementwise(lambda v: v.tape.symbol("interp", v.node, table) if isinstance(v, Symbol)
                       else np.interp(v, table[0], table[1], table[2], table[3]))(x)


class _Stand:
    """A module with some of its functions replaced."""

    def __init__(self, module, mine):
        self.__dict__.update(mine)
        self._module = module

    def __getattr__(self, name):
        return getattr(self._module, name)


class _FloatKind(type):
    def __instancecheck__(cls, value):
        return isinstance(value, float | Symbol)


class _Float(float, metaclass=_FloatKind):
    """`float` that leaves a symbol as it is."""

    def __new__(cls, value=0.0):
        if is_symbolic(value):
            value = value if isinstance(value, Symbol) else np.asarray(value).item()
            return apply("number", value) if value.truth else value
        return float(value)


def _extreme(name: str, original: Callable) -> Callable:
    def either(*arguments, **options):
        values = arguments if len(arguments) > 1 else tuple(arguments[0])
        if options or not is_symbolic(values):
            return original(*arguments, **options)
        return functools.reduce(lambda a, b: apply(name, a, b), values)

    return either


def _over(original: Callable, symbolic: Callable) -> Callable:
    """A function of sequences, done by `symbolic` where they hold symbols."""

    def either(*sequences, **options):
        kept = [tuple(v) for v in sequences]
        if not options and any(is_symbolic(v) for v in kept):
            return symbolic(*kept)
        return original(*kept, **options)

    return either


def _linear(make: Callable) -> Callable:
    """A maker of linear systems that gives symbolic matrices as they are, with A, B, C, D as its names."""

    def made(*matrices, **options):
        if len(matrices) < 4 or not any(is_symbolic(m) for m in matrices):
            return make(*matrices, **options)
        A, B, C, D = (np.array(m, dtype=object) for m in matrices[:4])
        A, B, C = np.atleast_2d(A), B.reshape(-1, 1) if B.ndim < 2 else B, np.atleast_2d(C)
        return types.SimpleNamespace(A=A, B=B, C=C, D=np.broadcast_to(D, (len(C), B.shape[1])))

    return made


def _transfer(make: Callable) -> Callable:
    """A maker of transfer functions that gives symbolic polynomials of one channel as num and den, as control holds
    them."""

    def made(*polynomials, **options):
        if len(polynomials) < 2 or not any(is_symbolic(p) for p in polynomials):
            return make(*polynomials, **options)
        num, den = ([[np.atleast_1d(np.array(p, dtype=object))]] for p in polynomials[:2])
        return types.SimpleNamespace(num=num, den=den, num_array=np.array(num), den_array=np.array(den))

    return made


def _names(prefix) -> dict[str, Callable]:
    found = {n: _function(n, getattr(prefix, n)) for n in FUNCTIONS
             if isinstance(getattr(prefix, n, None), np.ufunc | types.BuiltinFunctionType)}
    return found | {n: _function(real, getattr(prefix, n)) for n, real in OTHER_NAMES.items()
                    if real in FUNCTIONS and callable(getattr(prefix, n, None))}


_MINE = _names(np) | {"where": _where, "select": _first_that_holds, "clip": _clip, "interp": _interp, "float64": _Float,
                      "diag": lambda v, k=0: np.diag(np.array(v, dtype=object), k)} | {
    n: _holding_objects(getattr(np, n)) for n in ("array", "asarray", "asanyarray", "zeros", "ones", "empty", "full",
                                                  "eye", "identity")} | {
    f"{n}_like": _like(getattr(np, n)) for n in ("zeros", "ones", "empty")}
_MATH = _names(math) | {name: _function(real, getattr(math, name)) for name, real in (
    ("asin", "arcsin"), ("acos", "arccos"), ("atan", "arctan"), ("atan2", "arctan2"), ("asinh", "arcsinh"),
    ("acosh", "arccosh"), ("atanh", "arctanh"), ("pow", "power"))}
_MATH |= {"fsum": _over(math.fsum, sum), "prod": _over(math.prod, lambda v: functools.reduce(operator.mul, v)),
          "dist": _over(math.dist, lambda p, q: apply("sqrt", sum((a - b) ** 2 for a, b in zip(p, q, strict=True))))}
BUILTINS = {"max": _extreme("larger", max), "min": _extreme("smaller", min), "float": _Float}


def replacements() -> dict[int, object]:
    """What stands for each module and function, by its identity."""
    numpys, scipys = _Stand(np.linalg, NUMPY_LINALG), _Stand(scipy.linalg, SCIPY_LINALG)
    found = {id(np): _Stand(np, _MINE | {"linalg": numpys}), id(np.linalg): numpys, id(math): _Stand(math, _MATH),
             id(scipy): _Stand(scipy, {"linalg": scipys}), id(scipy.linalg): scipys}
    for module, mine in ((np, _MINE), (np.linalg, NUMPY_LINALG), (math, _MATH), (scipy.linalg, SCIPY_LINALG)):
        found |= {id(getattr(module, n)): f for n, f in mine.items()}
    makers = {name: _linear(getattr(control, name)) for name in ("ss", "StateSpace")}
    makers |= {name: _transfer(getattr(control, name)) for name in ("tf", "TransferFunction")}
    found |= {id(getattr(control, n)): f for n, f in makers.items()} | {id(control): _Stand(control, makers)}
    return found
