"""What a user's module, classes and closures call `np`, `math`, `sin` or `max`, replaced for the time of one run."""

from __future__ import annotations

import dis
import functools
import inspect
import itertools
import sysconfig
import threading
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pwaid.mismatch.symbolic import is_symbolic
from pwaid.mismatch.traced_numpy import BUILTINS, replacements

__all__ = ["catches", "replaced"]

_LOCK = threading.RLock()  # modules are changed for the time of a run: one at a time
_INSTALLED = tuple(str(Path(sysconfig.get_path(k)).resolve()) for k in ("stdlib", "platstdlib", "purelib", "platlib"))


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
    stands, undo = replacements(), []
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
                for key in BUILTINS.keys() - scope.keys():
                    undo.append(functools.partial(scope.pop, key))
                    scope[key] = BUILTINS[key]
            yield
        finally:
            for step in reversed(undo):
                step()
