"""Turn a user's Python right-hand side into compiled code without changing what it computes.

The source is read, look-ups ``params["m"]`` and ``params.get("m", d)`` become positions, tuple
assignments from x, u become indexed ones, and the result is compiled with numba. The compiled
function is compared with the original at random points before it is used; on any difference or
any construct that does not compile, the caller falls back to the plain loop.
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

from pwaid.mismatch.engine import RHS_TYPE

__all__ = ["CompileFailure", "compile_function", "compiled_pair"]


CONSTANT = "_constant_"
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
        return seen[function]
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    except (OSError, TypeError, SyntaxError) as error:
        raise CompileFailure(f"the source of {getattr(function, '__name__', function)!r} cannot be read") from error
    node = tree.body[0]
    if not isinstance(node, ast.FunctionDef):
        raise CompileFailure("the right-hand side is not a plain def")
    arguments = [a.arg for a in node.args.args]
    seen[RAISES] = seen.get(RAISES, False) or any(isinstance(n, ast.Raise | ast.Assert) for n in ast.walk(node))
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


def _wrap(inner, size: int, signature, raises: bool = False):
    """The engine's calling convention around a function that returns its result; NaN where it raises."""

    def call(t, x, u, p, dx):
        r = inner(t, x, u, p)
        for i in range(size):
            dx[i] = r[i]

    def guarded(t, x, u, p, dx):
        dx[:] = np.nan
        try:
            r = inner(t, x, u, p)
            for i in range(size):
                dx[i] = r[i]
        except Exception:
            dx[:] = np.nan

    try:
        return njit(signature.signature, error_model="numpy", nogil=True)(guarded if raises else call)
    except Exception as error:  # numba raises many kinds; each means: no compiled counterpart
        raise CompileFailure(str(error).strip().splitlines()[0]) from error


def compiled_pair(update: Callable, output: Callable | None, sizes: tuple[int, int, int],
                  parameters: Mapping[str, float], scale: float = 1.0,
                  constants: Mapping[str, object] | None = None):
    """Compile update and output and verify both against the originals.

    Parameters
    ----------
    update, output : callables ``f(t, x, u, params)``; output None means y = x.
    sizes : numbers of states, inputs, outputs.
    parameters : default values, in the order of the positions.
    scale : typical magnitude of the states, for the random test points.
    constants : what else params holds: texts, arrays, switches.

    Returns
    -------
    rhs, out : compiled functions in the engine's convention; NaN where the originals raise.
    raises : whether they can raise.
    """
    nx, nu, ny = sizes
    names = {name: i for i, name in enumerate(parameters)}
    found, raises = [], False
    for original, size in ((update, nx), (_whole_state if output is None else output, ny)):
        seen: dict = {}
        inner = compile_function(original, names, seen, constants)
        compiled = _wrap(inner, size, RHS_TYPE, seen[RAISES])
        _verify(original, compiled, size, nx, nu, parameters, scale, constants or {})
        found.append(compiled)
        raises |= seen[RAISES]
    return found[0], found[1], raises


def _whole_state(t, x, u, params):
    return x


def _verify(original, compiled, size, nx, nu, parameters, scale, constants, points: int = 24):
    rng = np.random.default_rng(0)
    values, compared = np.array(list(parameters.values()), dtype=float), 0
    for _ in range(4 * points):
        t, x, u = rng.uniform(0, 10), scale * rng.normal(size=nx), rng.normal(size=nu)
        p = values * rng.uniform(0.9, 1.1, values.size)
        with np.errstate(all="ignore"):
            try:
                want = np.asarray(original(t, x, u, {**constants, **dict(zip(parameters, p, strict=True))}),
                                  dtype=float).ravel()
            except Exception:
                continue  # outside the function's domain: nothing to compare there
        got = np.empty(size)
        compiled(t, x.copy(), u.copy(), p.copy() if p.size else np.zeros(1), got)
        if want.shape != got.shape or not np.allclose(want, got, rtol=1e-9, atol=1e-12, equal_nan=True):
            raise CompileFailure("the compiled function does not reproduce the original")
        compared += 1
        if compared == points:
            return
    if compared < points // 4:
        raise CompileFailure("the original raises at most random points, so the compiled function cannot be verified")
