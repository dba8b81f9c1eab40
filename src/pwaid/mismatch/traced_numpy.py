"""NumPy, math, scipy.linalg, control.ss, control.tf and a few builtins as a function on symbols sees them.

What a user's module, its classes and closures call `np`, `math`, `sin` or `max` is replaced for the time of one run:
functions of numbers take symbols, and arrays that are made can hold them.
"""

from __future__ import annotations

import dis
import functools
import inspect
import itertools
import math
import operator
import sysconfig
import threading
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import control
import numpy as np
import scipy.linalg

from pwaid.mismatch.symbolic import (
    FUNCTIONS,
    OTHER_NAMES,
    Symbol,
    TraceFailure,
    apply,
    by_name,
    elementwise,
    is_symbolic,
)

__all__ = ["as_numbers", "catches", "replaced"]

_LOCK = threading.RLock()  # modules are changed for the time of a run: one at a time
_INSTALLED = tuple(str(Path(sysconfig.get_path(k)).resolve()) for k in ("stdlib", "platstdlib", "purelib", "platlib"))


def as_numbers(value):
    """An array of objects that are all numbers, as floats; anything else as it came."""
    if isinstance(value, np.ndarray) and value.dtype == object and not is_symbolic(value):
        return value.astype(float)
    return value


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


def _solve(a, b):
    if not (is_symbolic(a) or is_symbolic(b)):
        return np.linalg.solve(as_numbers(np.asarray(a)), as_numbers(np.asarray(b)))
    a, b = np.asarray(a, dtype=object), np.asarray(b, dtype=object)
    n = len(a)
    if a.shape != (n, n) or b.ndim > 2 or len(b) != n:
        raise TraceFailure("it solves equations of a shape that is not square")
    columns = [_solution(a, column) for column in b.reshape(n, -1).T]
    return np.array(columns, dtype=object).T.reshape(b.shape)


def _solution(a, b):
    return _items("solve", [*a.flat, *b], len(b))


def _items(name: str, entries, count: int) -> list[Symbol]:
    """The `count` numbers that one operation on all of these entries gives."""
    tape = next(v.tape for v in entries if isinstance(v, Symbol))
    whole = tape.node(name, *(v.node if isinstance(v, Symbol) else tape.constant(v) for v in entries))
    return [tape.symbol("item", whole, k) for k in range(count)]


def _exponential(a):
    """`scipy.linalg.expm` of symbols: a simulator that samples its own matrices."""
    a = np.asarray(a, dtype=object)
    if a.ndim != 2 or len(set(a.shape)) != 1:
        raise TraceFailure("it takes the exponential of what is no square matrix")
    return np.array(_items("expm", list(a.flat), a.size), dtype=object).reshape(a.shape)


def _of_symbols(original: Callable, mine: Callable) -> Callable:
    """A function of arrays, done by `mine` where one holds symbols."""

    def either(*arguments, **options):
        if not options and any(is_symbolic(a) for a in arguments):
            return mine(*arguments)
        return original(*(as_numbers(a) for a in arguments), **options)

    return either


def _inverse(a):
    return _solve(a, np.eye(len(a), dtype=object) if is_symbolic(a) else np.eye(len(a)))


def _determinant(a):
    a = np.asarray(a)
    if not is_symbolic(a):
        return np.linalg.det(as_numbers(a))
    if len(a) == 1:
        return a[0, 0]
    return sum((-1) ** k * a[0, k] * _determinant(np.delete(a[1:], k, axis=1)) for k in range(len(a)))


def _norm(a, *arguments, **options):
    if not is_symbolic(a):
        return np.linalg.norm(as_numbers(np.asarray(a)), *arguments, **options)
    if arguments or options:
        raise TraceFailure("it takes a norm other than the Euclidean one")
    return apply("sqrt", sum(v * v for v in np.asarray(a, dtype=object).flat))


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


_LINALG = {"solve": _solve, "inv": _inverse, "det": _determinant, "norm": _norm}
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
_BUILTINS = {"max": _extreme("larger", max), "min": _extreme("smaller", min), "float": _Float}


def _replacements() -> dict[int, object]:
    """What stands for each module and function, by its identity."""
    linalg = _Stand(np.linalg, _LINALG)
    found = {id(np): _Stand(np, _MINE | {"linalg": linalg}), id(np.linalg): linalg, id(math): _Stand(math, _MATH)}
    for module, mine in ((np, _MINE), (np.linalg, _LINALG), (math, _MATH)):
        found |= {id(getattr(module, n)): f for n, f in mine.items()}
    matrices = {n: _of_symbols(getattr(scipy.linalg, n), f) for n, f in (_LINALG | {"expm": _exponential}).items()}
    scipys = _Stand(scipy.linalg, matrices)
    found |= {id(getattr(scipy.linalg, n)): f for n, f in matrices.items()}
    found |= {id(scipy.linalg): scipys, id(scipy): _Stand(scipy, {"linalg": scipys})}
    makers = {name: _linear(getattr(control, name)) for name in ("ss", "StateSpace")}
    makers |= {name: _transfer(getattr(control, name)) for name in ("tf", "TransferFunction")}
    found |= {id(getattr(control, n)): f for n, f in makers.items()} | {id(control): _Stand(control, makers)}
    return found


def _plain(function: Callable) -> Iterator[types.FunctionType]:
    """The Python functions behind a callable: of a method, a partial, an object that can be called.

    pwaid's own functions list the user's functions that they call as `runs`.
    """
    if isinstance(function, functools.partial):
        yield from _plain(function.func)
    elif inspect.ismethod(function):
        yield function.__func__
    elif inspect.isfunction(function):
        yield function
        for other in (getattr(function, "__wrapped__", None), *getattr(function, "runs", ())):
            yield from _plain(other)
    elif callable(function) and not inspect.isclass(function) and inspect.isfunction(type(function).__call__):
        yield type(function).__call__


def _scopes(function: Callable, seen: set[int]) -> Iterator[tuple]:
    """Global dictionaries and closure cells that the function and its helpers use, installed packages left out."""
    for f in _plain(function):
        if id(f) in seen or _foreign(f.__globals__):
            continue
        seen.add(id(f))
        for cell in f.__closure__ or ():
            try:
                value = cell.cell_contents
            except ValueError:
                continue
            yield None, cell
            yield from _scopes(value, seen) if callable(value) else ()
        if id(f.__globals__) not in seen:
            seen.add(id(f.__globals__))
            yield f.__globals__, None
            for value in list(f.__globals__.values()):
                yield from _helpers(value, seen)


def _helpers(value, seen: set[int]) -> Iterator[tuple]:
    if isinstance(value, types.ModuleType):
        if _foreign(vars(value)) or id(vars(value)) in seen:
            return
        seen.add(id(vars(value)))
        yield vars(value), None
        for inner in list(vars(value).values()):
            yield from _helpers(inner, seen)
    elif inspect.isclass(value):
        for member in vars(value).values():
            member = member.__func__ if isinstance(member, staticmethod | classmethod) else member
            yield from _scopes(member, seen) if inspect.isfunction(member) else ()
    elif inspect.isfunction(value):
        yield from _scopes(value, seen)


def _foreign(scope: dict) -> bool:
    """Whether a module is no part of the user's simulator: built in, installed, or pwaid's own."""
    name, file = scope.get("__name__", ""), scope.get("__file__")
    if name == "__main__":
        return False
    return file is None or name.partition(".")[0] == "pwaid" or str(Path(file).resolve()).startswith(_INSTALLED)


def catches(function: Callable) -> bool:
    """Whether the function, or a helper of its module, handles errors: symbols raise none."""
    functions = [f for f in _plain(function) if not _foreign(f.__globals__)]
    for f in functions:
        names = [v for n in f.__code__.co_names if inspect.isfunction(v := f.__globals__.get(n))]
        functions += [v for v in names if v not in functions and not _foreign(v.__globals__)]
    return any(_handles(f.__code__) for f in functions)


def _handles(code: types.CodeType) -> bool:
    """Whether there is an ``except`` in it, for certain errors or for all; ``with`` and ``finally`` are none."""
    names = [step.opname for step in dis.get_instructions(code)]
    return "CHECK_EXC_MATCH" in names or ("PUSH_EXC_INFO", "POP_TOP") in itertools.pairwise(names)


def _forget(scope: dict, before: dict) -> None:
    """Take out of a module what a run on symbols left there."""
    for key, value in list(scope.items()):
        if is_symbolic(value) and key in before:
            scope[key] = before[key]
        elif is_symbolic(value):
            del scope[key]


@contextmanager
def replaced(function: Callable):
    """While it lasts, the function and the helpers of its module see the replacements; what it kept of a run in its
    closure or its module goes afterwards."""
    stands, undo = _replacements(), []
    with _LOCK:
        try:
            for scope, cell in list(_scopes(function, set())):
                if cell is not None:
                    undo.append(functools.partial(setattr, cell, "cell_contents", cell.cell_contents))
                    if id(cell.cell_contents) in stands:
                        cell.cell_contents = stands[id(cell.cell_contents)]
                    continue
                undo.append(functools.partial(_forget, scope, dict(scope)))
                for key, value in list(scope.items()):
                    if id(value) in stands:
                        undo.append(functools.partial(scope.__setitem__, key, value))
                        scope[key] = stands[id(value)]
                for key in _BUILTINS.keys() - scope.keys():
                    undo.append(functools.partial(scope.pop, key))
                    scope[key] = _BUILTINS[key]
            yield
        finally:
            for step in reversed(undo):
                step()
