"""Compiled code for a right-hand side from running it: its arithmetic is written down, branch by branch.

The Python function is run on symbols in place of numbers, once for every way through its conditions. What it did
becomes a function of plain arithmetic.
"""

from __future__ import annotations

import copy
import inspect
import opcode
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from pwaid.mismatch.symbolic import FUNCTIONS, Symbol, Tape, TraceFailure
from pwaid.mismatch.traced_scopes import catches, replaced

__all__ = ["traced"]

MOST_PATHS, MOST_LINES = 128, 2000
_RAISE = opcode.opmap["RAISE_VARARGS"]


@dataclass
class _Branch:
    """A condition with what follows when it holds and when not; or, without one, the results: None where it raises."""

    condition: int | None = None
    results: list[int] | None = None
    ways: dict[bool, _Branch] = field(default_factory=dict)


def traced(function: Callable, size: int, nx: int, nu: int, names: Mapping[str, int],
           constants: Mapping[str, object]) -> tuple[Callable, bool]:
    """A function (t, x, u, p, result) that fills result (size,), to be compiled, and whether it can raise.

    Where the original raises, results are NaN.

    Raises
    ------
    TraceFailure
        When the function needs a number, has too many ways through, or does not return `size` numbers.
    """
    if catches(function):
        raise TraceFailure("it handles errors, which symbols do not raise")
    function, tape = _copied(function), Tape()
    x, u = (np.array([tape.symbol("input", f"{letter}[{i}]") for i in range(n)], dtype=object)
            for letter, n in (("x", nx), ("u", nu)))

    def once():
        params = {**constants, **{n: tape.symbol("input", f"p[{k}]") for n, k in names.items()}}
        return _flat(tape, function(tape.symbol("input", "t"), x.copy(), u.copy(), params), size)

    with replaced(function):
        root, raises = _explore(tape, once)
    if getattr(function, "linear", False) and any(name == "expm" for name, *_ in tape.nodes):
        raise TraceFailure("its matrices are an exponential, which is not to be taken in every step")
    writer = _Writer(tape)
    lines = writer.block(root, {}, 1)
    text = "def traced(t, x, u, p, result):\n" + "\n".join(lines)
    space = {"np": np, "_solve": _solve_columns, "_expm": _exponential, "_interp": _interpolate, **writer.tables}
    exec(compile(text, "<pwaid traced>", "exec"), space)
    return space["traced"], raises


def _copied(function: Callable) -> Callable:
    """A copy of the object behind a method or a callable: it may keep what it is called with."""
    try:
        if inspect.ismethod(function) and not inspect.isclass(function.__self__):
            return types.MethodType(function.__func__, copy.deepcopy(function.__self__))
        return function if inspect.isroutine(function) or inspect.isclass(function) else copy.deepcopy(function)
    except Exception as error:
        raise TraceFailure(f"its object cannot be copied ({type(error).__name__})") from error


def _explore(tape: Tape, once: Callable) -> tuple[_Branch, bool]:
    """All ways through, as a tree, and whether any ends in an error that the function itself raises."""
    root, waiting, runs, raises = _Branch(), [()], 0, False
    while waiting:
        prefix = waiting.pop()
        runs += 1
        if runs > MOST_PATHS:
            raise TraceFailure(f"there are more than {MOST_PATHS} ways through its conditions")
        tape.start(prefix)
        try:
            results = once()
        except Exception as error:
            if not _raised_on_purpose(error):
                raise TraceFailure(f"{type(error).__name__}: {error}") from error
            results, raises = None, True
        here = root
        for k, (condition, choice) in enumerate(tape.path):
            here.condition = condition
            if k >= len(prefix):
                waiting.append(tuple(c for _, c in tape.path[:k]) + (not choice,))
            here = here.ways.setdefault(choice, _Branch())
        here.results = results
    return root, raises


def _raised_on_purpose(error: Exception) -> bool:
    """Whether the innermost frame was executing a raise statement (an assert is one)."""
    step = error.__traceback__
    while step.tb_next is not None:
        step = step.tb_next
    code = step.tb_frame.f_code.co_code
    return code[step.tb_lasti] == _RAISE and "numpy" not in step.tb_frame.f_globals.get("__name__", "")


def _flat(tape: Tape, result, size: int) -> list[int]:
    values = np.array(result, dtype=object).ravel()
    if values.size != size or not all(isinstance(v, Symbol | int | float | np.number | np.bool_) for v in values):
        raise TraceFailure(f"it did not return {size} numbers")
    return [v.node if isinstance(v, Symbol) else tape.constant(float(v)) for v in values]


class _Writer:
    """Lines of Python for a tree: operations are written where they are first needed, on each way through."""

    def __init__(self, tape: Tape):
        self.tape, self.tables, self.count = tape, {}, 0

    def block(self, branch: _Branch, known: dict[int, str], depth: int) -> list[str]:
        """The lines of a branch and all below it; `known` names what was written on the way to it."""
        pad, lines = "    " * depth, []

        def value(node):
            return self._value(node, known, lines, pad)

        if branch.condition is not None:
            lines.append(f"{pad}if {value(branch.condition)}:")
            lines += self.block(branch.ways[True], dict(known), depth + 1)
            lines.append(f"{pad}else:")
            return lines + self.block(branch.ways[False], dict(known), depth + 1)
        if branch.results is None:
            return [f"{pad}result[:] = np.nan"]
        texts = [value(node) for node in branch.results]
        lines += [f"{pad}result[{k}] = {text}" for k, text in enumerate(texts)]
        return lines or [f"{pad}pass"]

    def _value(self, node: int, known: dict[int, str], lines: list[str], pad: str) -> str:
        """The name of an operation's result, after writing it and what it needs."""
        waiting = [node]
        while waiting:
            top = waiting[-1]
            missing = [] if top in known else [a for a in self._needs(top) if a not in known]
            if missing:
                waiting += missing
                continue
            waiting.pop()
            if top not in known:
                known[top] = self._written(top, known, lines, pad)
        return known[node]

    def _needs(self, node: int) -> tuple[int, ...]:
        name, *rest = self.tape.nodes[node]
        return () if name in ("constant", "input") else tuple(rest[:1]) if name in ("item", "interp") else tuple(rest)

    def _written(self, node: int, known, lines, pad) -> str:
        name, *rest = self.tape.nodes[node]
        if name == "input":
            return rest[0]
        if name == "constant":
            return self._constant(rest[1])
        if name in ("solve", "expm"):
            text = f"_{name}({self._array([known[a] for a in rest])})"
        elif name == "item":
            return f"{known[rest[0]]}[{rest[1]}]"
        elif name == "interp":
            text = f"_interp({known[rest[0]]}, {self._table(rest[1])})"
        elif name == "power" and (whole := self._whole(rest[1])) is not None:
            text = f"({known[rest[0]]} ** {whole})"
        else:
            text = FUNCTIONS[name][1].format(*(known[a] for a in rest))
        self.count += 1
        if self.count > MOST_LINES:
            raise TraceFailure(f"its arithmetic takes more than {MOST_LINES} lines")
        lines.append(f"{pad}v{node} = {text}")
        return f"v{node}"

    def _whole(self, node: int) -> int | None:
        """A small whole number, of which a power is a product."""
        name, *rest = self.tape.nodes[node]
        return int(rest[1]) if name == "constant" and 0 < rest[1] <= 4 and rest[1] == int(rest[1]) else None

    @staticmethod
    def _constant(value) -> str:
        if np.isfinite(value):
            return repr(value) if value >= 0 else f"({value!r})"
        return "np.nan" if np.isnan(value) else "np.inf" if value > 0 else "(-np.inf)"

    @staticmethod
    def _array(texts) -> str:
        return "np.array((" + ", ".join(f"float({t})" for t in texts) + ",))"

    def _table(self, table) -> str:
        name = f"table{len(self.tables) // 2}"
        self.tables |= {f"{name}x": np.array(table[0]), f"{name}y": np.array(table[1])}
        return f"{name}x, {name}y, {table[2]!r}, {table[3]!r}"


@njit(error_model="numpy", nogil=True)
def _solve_columns(entries):
    """x of A x = b by elimination with row exchanges; entries: A (n, n) by rows, then b (n,). NaN where singular."""
    n = int(np.sqrt(entries.size + 0.25))
    while n * n + n > entries.size:
        n -= 1
    b = entries[n * n:]
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(entries[i * n + k]) > abs(entries[best * n + k]):
                best = i
        if best != k:
            for j in range(k, n):
                entries[k * n + j], entries[best * n + j] = entries[best * n + j], entries[k * n + j]
            b[k], b[best] = b[best], b[k]
        for i in range(k + 1, n):
            factor = entries[i * n + k] / entries[k * n + k]
            for j in range(k + 1, n):
                entries[i * n + j] -= factor * entries[k * n + j]
            b[i] -= factor * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= entries[k * n + j] * b[j]
        b[k] /= entries[k * n + k]
    return b


@njit(error_model="numpy", nogil=True)
def _exponential(entries):
    """The exponential of a matrix given by rows, by rows: ten terms of its series at 2⁻ˢ of it, squared s times."""
    n = int(np.sqrt(entries.size) + 0.5)
    size = np.max(np.abs(entries)) * n
    squarings = 0
    while size > 0.1 and squarings < 60:
        size /= 2.0
        squarings += 1
    small = entries.reshape(n, n) / 2.0**squarings
    term, total = np.eye(n), np.eye(n)
    for k in range(1, 11):
        term = _product(term, small) / k
        total += term
    for _ in range(squarings):
        total = _product(total, total)
    return total.ravel()


@njit(error_model="numpy", nogil=True)
def _product(a, b):
    found = np.zeros_like(a)
    for i in range(a.shape[0]):
        for j in range(a.shape[0]):
            for k in range(a.shape[0]):
                found[i, j] += a[i, k] * b[k, j]
    return found


@njit(error_model="numpy", nogil=True)
def _interpolate(v, x, y, left, right):
    """`numpy.interp` of one value."""
    if v < x[0]:
        return left
    if v >= x[-1]:
        return y[-1] if v == x[-1] else right
    k = min(max(np.searchsorted(x, v, side="right") - 1, 0), x.size - 2)
    return y[k] + (y[k + 1] - y[k]) / (x[k + 1] - x[k]) * (v - x[k])
