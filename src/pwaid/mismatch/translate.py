"""A Python right-hand side translated to numba from its source.

Look-ups ``params["m"]`` and ``params.get("m", d)`` become positions, tuple assignments from x, u become indexed ones;
the rest is numba's.
"""

from __future__ import annotations

import ast
import inspect
import linecache
import math
import textwrap
import types as pytypes
from collections.abc import Callable, Mapping

import numpy as np
from numba import njit

__all__ = ["RAISES", "CompileFailure", "compile_function"]

CONSTANT = "_constant_"
MOST_ROUNDS = 10_000  # of a while loop
RAISES = "raises"  # whether any function compiled so far can raise an error


class CompileFailure(Exception):
    """The function cannot be compiled faithfully; the text says why."""


class _Positions(ast.NodeTransformer):
    """Replace look-ups by name with positions or constants, and unpacking of arrays with indexing."""

    def __init__(self, names: Mapping[str, int], arrays: set[str], constants: Mapping[str, object]):
        self.names, self.arrays, self.constants = names, arrays, constants

    def _constant(self, name: str):
        value = self.constants[name]
        plain = isinstance(value, str | bool | int | float | None)
        return ast.Constant(value) if plain else ast.Name(f"{CONSTANT}{name}", ast.Load())

    def visit_Subscript(self, node):
        self.generic_visit(node)
        key = node.slice
        if isinstance(key, ast.Constant) and isinstance(key.value, str):
            if key.value in self.constants:
                return self._constant(key.value)
            if key.value not in self.names:
                raise CompileFailure(f"the parameter {key.value!r} has no default in params")
            node.slice = ast.Constant(self.names[key.value])
        return node

    def visit_Call(self, node):
        self.generic_visit(node)
        f = node.func
        if isinstance(f, ast.Attribute) and f.attr == "get" and isinstance(f.value, ast.Name) and node.args:
            key = node.args[0]
            if isinstance(key, ast.Constant) and isinstance(key.value, str):
                if key.value in self.constants:
                    return self._constant(key.value)
                if key.value in self.names:
                    return ast.Subscript(f.value, ast.Constant(self.names[key.value]), ast.Load())
                return node.args[1] if len(node.args) > 1 else ast.Constant(None)
        return node

    def visit_While(self, node):
        """A loop that never ends, on numbers that run away, raises."""
        self.generic_visit(node)
        name = f"{CONSTANT}rounds_{node.lineno}"
        count, check = ast.parse(f"{name} += 1\nif {name} > {MOST_ROUNDS}:\n    raise ArithmeticError").body
        node.body = [count, check, *node.body]
        return [*ast.parse(f"{name} = 0").body, node]

    def visit_Assign(self, node):
        """``a, b = x`` and ``a, b = x[2:]`` as one indexed assignment a name."""
        self.generic_visit(node)
        if len(node.targets) != 1 or not isinstance(node.targets[0], ast.Tuple):
            return node
        targets, value = node.targets[0].elts, node.value
        if isinstance(value, ast.Name) and value.id in self.arrays:
            return [
                ast.Assign([t], ast.Subscript(value, ast.Constant(i), ast.Load())) for i,
                t in enumerate(targets)
            ]
        if (isinstance(value, ast.Subscript) and isinstance(value.value, ast.Name)
            and value.value.id in self.arrays
                and isinstance(value.slice, ast.Slice) and value.slice.step is None):
            low = value.slice.lower.value if isinstance(value.slice.lower, ast.Constant) else 0
            return [
                ast.Assign([t], ast.Subscript(value.value, ast.Constant(low + i), ast.Load()))
                for i, t in enumerate(targets)
            ]
        return node


def _namespace(function: Callable, names: Mapping[str, int], seen: dict, constants: Mapping[str, object]) -> dict:
    """Globals and closure of `function`, with the plain Python helpers it calls compiled too."""
    space = {"np": np, "math": math} | {f"{CONSTANT}{n}": v for n, v in constants.items()}
    code = function.__code__
    used = set(code.co_names) | set(code.co_freevars)
    stack = [c for c in code.co_consts if isinstance(c, pytypes.CodeType)]
    while stack:
        inner = stack.pop()
        used |= set(inner.co_names)
        stack += [c for c in inner.co_consts if isinstance(c, pytypes.CodeType)]
    pool = dict(function.__globals__)
    if function.__closure__:
        pool.update(zip(code.co_freevars, (c.cell_contents for c in function.__closure__), strict=True))
    for name in used:
        if name in pool:
            item = pool[name]
            space[name] = compile_function(item, names, seen, constants) if inspect.isfunction(item) else item
    return space


def compile_function(function: Callable, names: Mapping[str, int], seen: dict | None = None,
                     constants: Mapping[str, object] | None = None):
    """Compile one Python function of (t, x, u, params) or a helper it calls.

    Parameters
    ----------
    names : position of every number in params. constants : texts, arrays and the like in params.
    seen : functions compiled so far, and under RAISES whether any of them can raise.

    Raises
    ------
    CompileFailure
        When the source cannot be read or uses something that has no compiled counterpart.
    """
    seen, constants = {} if seen is None else seen, constants or {}
    if function in seen:
        if seen[function] is None:
            raise CompileFailure(f"{function.__name__} calls itself")
        return seen[function]
    seen[function] = None
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    except (OSError, TypeError, SyntaxError) as error:
        raise CompileFailure(f"the source of {getattr(function, '__name__', function)!r} cannot be read") from error
    node = tree.body[0]
    if not isinstance(node, ast.FunctionDef) or node.name != function.__name__:
        raise CompileFailure("it is not a plain def")
    arguments = [a.arg for a in node.args.args]
    seen[RAISES] = seen.get(RAISES, False) or any(
        isinstance(n, ast.Raise | ast.Assert | ast.While) for n in ast.walk(node))
    node.decorator_list, node.returns = [], None
    for a in node.args.args:
        a.annotation = None
    tree = ast.fix_missing_locations(_Positions(names, set(arguments), constants).visit(tree))
    space = _namespace(function, names, seen, constants)
    text = ast.unparse(tree)
    filename = f"<pwaid compiled {function.__name__} {id(function):x}>"
    linecache.cache[filename] = (len(text), None, text.splitlines(True), filename)
    exec(compile(text, filename, "exec"), space)
    seen[function] = njit(space[function.__name__], error_model="numpy")
    return seen[function]
