"""An effect's kernel rewritten as plain Python functions with names, for the repaired simulator's file.

A kernel is one function for all phases and places. Here its source is specialised to one phase and one place:
integers that say where it acts become constants, branches that can never be taken go, `push` and `react` become
additions to an input or a rate, `slide` becomes the level it is given, parameters, states and inputs get their names.
Each rewriting keeps the meaning; the tests compare the result with the engine for every effect of the catalogue.
"""

from __future__ import annotations

import ast
import builtins
import copy
import inspect
import keyword
import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pwaid.mismatch.model import Located

__all__ = ["Law", "identifier", "law_functions"]

ARRAYS = {"x": "state", "xs": "seen", "u": "inputs", "p": "params", "dx": "rates"}
_FORCES = {"push": (1, 2, 3), "react": (7, 8, 11)}  # integers of a place: how a force enters, where, what inertia
ROLES = {  # function suffix: phase, arguments
    "memory": (0, "t, h, state, inputs, params"),
    "seen": (1, "t, h, state, seen, inputs, params"),
    "rates": (2, "t, h, state, inputs, params, rates"),
    "sensor": (3, "t, h, state, inputs, params, outputs"),
    "level": (4, "t, h, state, before, inputs, params"),
    "mobility": (6, "t, h, state, inputs, params, column"),
}
SAYS = {"memory": "Update of its memory over a step h.", "seen": "What the nominal equations see.",
        "rates": "What it adds to the derivatives.", "sensor": "What it does to the outputs.",
        "level": "Size of the friction against the motion.",
        "mobility": "What it makes of what a unit of force adds to the derivatives."}


@dataclass(frozen=True)
class Law:
    """The plain functions of one located effect: source by role, and its parameters by name."""

    name: str
    located: Located
    functions: dict[str, str]
    values: dict[str, object]

    def call(self, role: str, arguments: str) -> str:
        """The text of a call; parameters come from the dictionary named like the law, in capitals."""
        return f"{self.name}_{role}({arguments}{f', **{self.name.upper()}' if self.values else ''})"


def identifier(text: str, taken: Sequence[str] = ()) -> str:
    """A Python name like `text` that is not taken."""
    name = "".join(c if c.isalnum() else "_" for c in text) or "value"
    name = f"_{name}" if name[0].isdigit() else name
    while name in taken or keyword.iskeyword(name) or hasattr(builtins, name) or hasattr(math, name):
        name += "_"
    return name


def law_functions(located: Located, row, values, plant, extra: Sequence[str], taken: Sequence[str] = ()) -> Law:
    """The functions of one effect.

    Parameters
    ----------
    row : (12,) integers of the place, the first extra state filled in. values : parameters in their units.
    extra : names of all extra states of the model. taken : names of laws that exist already.
    """
    e, constants = located.effect, located.place.constants
    name = identifier(e.id, taken)
    numbers = [*map(float, values), *map(float, constants)]
    tree = ast.parse(textwrap.dedent(inspect.getsource(e.kernel))).body[0]
    used = {n.id for n in ast.walk(tree) if isinstance(n, ast.Name)} | {a.arg for a in tree.args.args}
    names = [identifier(q.name, used) for q in e.quantities] + [f"constant_{k + 1}" for k in range(len(constants))]
    places = {"state": [*plant.state_names, *extra], "inputs": list(plant.input_names),
              "outputs": list(plant.output_names), "params": list(plant.parameters)}
    places |= dict.fromkeys(("seen", "rates", "before", "column"), places["state"])
    listed = any(isinstance(n, ast.Subscript) and isinstance(n.value, ast.Name) and n.value.id == "q"
                 and not isinstance(n.slice, ast.Constant) for n in ast.walk(tree))
    parameters = {"q": np.array(numbers)} if listed else dict(zip(names, numbers, strict=True))
    functions = {}
    for role, (phase, arguments) in ROLES.items():
        if (role == "level") != bool(e.proximal) and (role == "level" or phase >= 4):
            continue
        body = _specialise(tree, phase, np.asarray(row), [] if listed else names, places)
        if body:
            functions[role] = _function(f"{name}_{role}", arguments, parameters, body, SAYS[role], places)
    return Law(name, located, functions, parameters)


def _function(name, arguments, parameters, body, says, places) -> str:
    head = f"def {name}({arguments}"
    tail = f", *, {', '.join(parameters)}" if parameters else ""
    gap = f",\n{' ' * (len(name) + 5)}{tail[2:]}" if len(head + tail) > 112 else tail
    lines = [_commented(line, places) for line in ast.unparse(ast.Module(body, [])).splitlines()]
    return f"{head}{gap}):\n    \"\"\"{says}\"\"\"\n" + "".join(f"    {line}\n" for line in lines)


def _commented(line: str, places) -> str:
    """The line with the names behind its indices."""
    found = re.findall(r"\b(state|seen|before|inputs|outputs|rates)\[(\d+)\]", line)
    names = [f"d{places[a][int(k)]}/dt" if a == "rates" else places[a][int(k)] for a, k in found]
    known = line.split(" = ")[0] in names  # omega = state[1] needs no comment
    return f"{line}  # {', '.join(dict.fromkeys(names))}" if names and not known else line


def _specialise(tree, phase: int, row, names, places) -> list[ast.stmt]:
    body = ast.parse(ast.unparse(tree)).body[0].body
    if body and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
        body = body[1:]
    arrays = ARRAYS | {3: {"dx": "outputs"}, 4: {"xs": "before"}, 6: {"dx": "column"}}.get(phase, {})
    before = None
    while (now := ast.unparse(ast.Module(body, []))) != before:
        before, body = now, _flat(body)
        fold = _Fold({"phase": phase, **_single(body)}, row, names)
        body = _visit(fold, body)
    body = _visit(_Calls(phase, row), body)
    body = _visit(_Fold({"phase": phase}, row, names), body)
    body, _ = _alive(body, set())
    if phase == 4 and body:
        body.append(ast.Return(ast.Constant(0.0)))
        body = body[:-1] if isinstance(body[-2], ast.Return) else body
    body = _visit(_Fold(_copies(body), row, names), body)
    renamed = _Rename(arrays, places, body)
    body = _visit(renamed, body)
    body = renamed.reads + body
    return _visit(_Fold(_single(body), row, names), body) if body else []


def _visit(transformer, body) -> list[ast.stmt]:
    module = ast.fix_missing_locations(transformer.visit(ast.Module(body, [])))
    dropped, _ = _alive(module.body, set())
    return dropped


def _flat(body):
    """``a, b = c, d`` as two assignments, where neither reads the other."""
    out = []
    for s in body:
        if (isinstance(s, ast.Assign) and isinstance(s.targets[0], ast.Tuple) and isinstance(s.value, ast.Tuple)):
            written = {n.id for n in ast.walk(s.targets[0]) if isinstance(n, ast.Name)}
            if not written & _loads(s.value):
                out += [ast.Assign([t], v, lineno=0) for t, v in zip(s.targets[0].elts, s.value.elts, strict=True)]
                continue
        out.append(s)
    return out


def _loads(node) -> set[str]:
    return {n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)}


def _single(body) -> dict[str, object]:
    """Names assigned once, at the top level, to a constant or to a name that does not change after."""
    stores = [n.id for n in ast.walk(ast.Module(body, [])) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
    found, settled = {}, set()
    for s in body:
        if not (isinstance(s, ast.Assign) and isinstance(s.targets[0], ast.Name)
                and stores.count(s.targets[0].id) == 1):
            continue
        name, value = s.targets[0].id, s.value
        if isinstance(value, ast.Constant):
            found[name] = value.value
        elif isinstance(value, ast.Name) and (value.id not in stores or value.id in settled):
            found[name] = value
        settled.add(name)
    return found


def _copies(body) -> dict[str, object]:
    """Names assigned once, at the top level, to an element of x, xs or u that the function never changes."""
    written = _written(body)
    stores = [n.id for n in ast.walk(ast.Module(body, [])) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
    found = {}
    for s in body:
        if (isinstance(s, ast.Assign) and isinstance(s.targets[0], ast.Name) and stores.count(s.targets[0].id) == 1
                and isinstance(s.value, ast.Subscript) and isinstance(s.value.slice, ast.Constant)
                and isinstance(s.value.value, ast.Name) and s.value.value.id in ("x", "xs", "u")
                and (s.value.value.id, s.value.slice.value) not in written):
            found[s.targets[0].id] = s.value
    return found


def _written(body) -> set[tuple[str, int]]:
    """(array, index) of every element that is assigned."""
    return {(n.value.id, n.slice.value) for n in ast.walk(ast.Module(body, [])) if isinstance(n, ast.Subscript)
            and isinstance(n.ctx, ast.Store) and isinstance(n.value, ast.Name) and isinstance(n.slice, ast.Constant)}


class _Fold(ast.NodeTransformer):
    """Constants put in and worked out, branches that cannot be taken removed."""

    def __init__(self, known: dict[str, object], row, names):
        self.known, self.row, self.names = known, row, names

    def visit_Name(self, node):
        if isinstance(node.ctx, ast.Load) and node.id in self.known:
            value = self.known[node.id]
            return copy.deepcopy(value) if isinstance(value, ast.AST) else ast.Constant(value)
        return node

    def visit_Subscript(self, node):
        self.generic_visit(node)
        if isinstance(node.value, ast.Name) and isinstance(node.slice, ast.Constant):
            k = node.slice.value
            if node.value.id == "ii":
                return ast.Constant(int(self.row[k]))
            if node.value.id == "q" and k < len(self.names):  # beyond them only in branches never taken
                return ast.Name(self.names[k], ast.Load())
        return node

    def visit_BinOp(self, node):
        self.generic_visit(node)
        return self._worked(node, node.left, node.right)

    def visit_UnaryOp(self, node):
        self.generic_visit(node)
        return self._worked(node, node.operand) if isinstance(node.op, ast.Not) else node

    def visit_Compare(self, node):
        self.generic_visit(node)
        return self._worked(node, node.left, *node.comparators)

    @staticmethod
    def _worked(node, *parts):
        if all(isinstance(p, ast.Constant) for p in parts):
            return ast.Constant(eval(compile(ast.fix_missing_locations(ast.Expression(node)), "<law>", "eval")))
        return node

    def visit_BoolOp(self, node):
        """Constants taken out of ``and`` and ``or``; one that decides ends the chain."""
        self.generic_visit(node)
        stop = isinstance(node.op, ast.Or)
        left = []
        for v in node.values:
            if not isinstance(v, ast.Constant):
                left.append(v)
            elif bool(v.value) == stop:
                if not left:
                    return ast.Constant(stop)
                left.append(v)
                break
        if not left:
            return ast.Constant(not stop)
        return left[0] if len(left) == 1 else ast.BoolOp(node.op, left)

    def visit_IfExp(self, node):
        self.generic_visit(node)
        return (node.body if node.test.value else node.orelse) if isinstance(node.test, ast.Constant) else node

    def visit_If(self, node):
        self.generic_visit(node)
        return (node.body if node.test.value else node.orelse) if isinstance(node.test, ast.Constant) else node


class _Calls(ast.NodeTransformer):
    """`push` and `react` as additions in their phase, `slide` as the level it is given."""

    def __init__(self, phase: int, row):
        self.phase, self.row = phase, row

    def visit_Expr(self, node):
        """A call of one of them as a plain statement; None where the force belongs to the other phase."""
        call = node.value
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name)):
            return node
        if call.func.id == "slide":
            return ast.Return(call.args[1])
        if call.func.id not in _FORCES:
            return node
        through, target, inertia = (int(self.row[k]) for k in _FORCES[call.func.id])
        if self.phase != (2 if through == 1 else 1):
            return None
        force, sign = call.args[1], ast.Add()
        if isinstance(force, ast.UnaryOp) and isinstance(force.op, ast.USub):
            force, sign = force.operand, ast.Sub()
        elif isinstance(force, ast.BinOp) and isinstance(force.op, ast.Mult):
            force, negative = _without_minus(force)
            sign = ast.Sub() if negative else sign
        if through == 1 and inertia >= 0:
            force = ast.BinOp(force, ast.Div(), _element("p", inertia))
        if through == 2:
            sign = ast.Add() if isinstance(sign, ast.Sub) else ast.Sub()
        return ast.AugAssign(_element("dx" if through == 1 else "u", target, ast.Store()), sign, force)


def _without_minus(product):
    """``-a * b`` as ``a * b`` and whether a minus was taken off."""
    if isinstance(product, ast.BinOp) and isinstance(product.op, ast.Mult):
        left, negative = _without_minus(product.left)
        return ast.BinOp(left, product.op, product.right), negative
    if isinstance(product, ast.UnaryOp) and isinstance(product.op, ast.USub):
        return product.operand, True
    return product, False


def _element(array: str, k: int, context=None):
    return ast.Subscript(ast.Name(array, ast.Load()), ast.Constant(k), context or ast.Load())


class _Rename(ast.NodeTransformer):
    """Arrays by their meaning; elements that are only read, by the names of state, input or parameter."""

    def __init__(self, arrays, places, body):
        self.arrays, self.places = arrays, places
        self.written = _written(body)
        used = {n.id for n in ast.walk(ast.Module(body, [])) if isinstance(n, ast.Name)}
        self.taken = (used - set(arrays)) | {*arrays.values(), "t", "h", "q"}
        self.given: dict[tuple[str, int], str] = {}
        self.reads: list[ast.stmt] = []

    def visit_Subscript(self, node):
        """The element by its new array's name, or by a name of its own, noted in `reads`, where it is only read."""
        if not (isinstance(node.value, ast.Name) and node.value.id in self.arrays
                and isinstance(node.slice, ast.Constant)):
            return self.generic_visit(node)
        array, k = self.arrays[node.value.id], node.slice.value
        if array == "params":
            return ast.Subscript(ast.Name(array, ast.Load()), ast.Constant(self.places[array][k]), node.ctx)
        whole = ast.Subscript(ast.Name(array, ast.Load()), ast.Constant(k), node.ctx)
        if isinstance(node.ctx, ast.Store) or (node.value.id, k) in self.written or array in ("rates", "outputs"):
            return whole
        key = (array, k)
        if key not in self.given:
            name = self.places[array][k] + ("_before" if array == "before" else "")
            self.given[key] = identifier(name, self.taken)
            self.taken.add(self.given[key])
            self.reads.append(ast.Assign([ast.Name(self.given[key], ast.Store())], whole, lineno=0))
        return ast.Name(self.given[key], ast.Load())

    def visit_Name(self, node):
        return ast.Name(self.arrays.get(node.id, node.id), node.ctx)


def _alive(body, live: set[str]) -> tuple[list[ast.stmt], set[str]]:
    """The statements that matter, by liveness from the end; and the names live before them."""
    kept: list[ast.stmt] = []
    for s in reversed(body):
        if isinstance(s, ast.Pass):
            continue
        if isinstance(s, ast.Return):
            kept, live = [s], _loads(s)
            continue
        if isinstance(s, ast.Assign) and isinstance(s.targets[0], ast.Name):
            if s.targets[0].id not in live:
                continue
            live = (live - {s.targets[0].id}) | _loads(s.value)
        elif isinstance(s, ast.If):
            inner, a = _alive(s.body, set(live))
            other, b = _alive(s.orelse, set(live))
            if not inner and not other:
                continue
            if not inner:
                s = ast.If(ast.UnaryOp(ast.Not(), s.test), other, [])
            else:
                s = ast.If(s.test, inner, other)
            live = a | b | _loads(s.test)
        elif isinstance(s, ast.AugAssign) and isinstance(s.target, ast.Name):
            if s.target.id not in live:
                continue
            live = live | _loads(s.value) | {s.target.id}
        else:
            live = live | _loads(s)
        kept.append(s)
    return kept[::-1], live
