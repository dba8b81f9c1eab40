"""What the functions of a law take from the module that they were written in, as lines of the repaired simulator.

The catalogue's kernels call a few functions of `math`; a user's kernel may call others, numbers of its module, and
functions of its own.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType

import numpy as np

from pwaid.errors import InputError

__all__ = ["module_text"]

_MATH = "from math import "


def module_text(kernels: Mapping[Callable, Sequence[str]]) -> str:
    """The imports, numbers and functions without which the texts made of each kernel do not run.

    Raises
    ------
    InputError
        A name stands for something that cannot be written into a file.
    """
    found: dict[str, str] = {}
    for kernel, texts in kernels.items():
        _find(kernel, [name for text in texts for name in _outside(text)], found)
    imports = [line for line in found.values() if line.startswith(("import ", "from "))]
    functions = sorted(line.removeprefix(_MATH) for line in imports if line.startswith(_MATH))
    lines = [_MATH + ", ".join(functions)] if functions else []
    lines += sorted(line for line in imports if not line.startswith(_MATH))
    lines += [line for line in found.values() if line not in imports and not line.startswith("def ")]
    return "\n\n\n".join(["\n".join(lines), *[text for text in found.values() if text.startswith("def ")]]).strip()


def _find(kernel: Callable, todo: list[str], found: dict[str, str]) -> None:
    """Add what stands behind the names in `todo` to `found`."""
    space = {**kernel.__globals__, **inspect.getclosurevars(kernel).nonlocals}
    while todo:
        name = todo.pop()
        if name in found:
            continue
        value = space.get(name)
        helper = getattr(value, "py_func", value)
        if isinstance(value, ModuleType):
            found[name] = f"import {value.__name__} as {name}"
        elif isinstance(value, int | float | np.number):
            found[name] = f"{name} = {np.asarray(value).item()!r}"
        elif hasattr(math, name):
            found[name] = f"from math import {name}"
        elif isinstance(value, np.ufunc):
            found[name] = f"from numpy import {value.__name__} as {name}"
        elif inspect.isfunction(helper):
            text = _undecorated(helper)
            found[name] = text
            _find(helper, _outside(text), found)  # its names are those of its own module
        else:
            raise InputError(f"the law {kernel.__name__} uses {name!r} of its module, which the repaired simulator "
                             "cannot hold; use functions of math and numpy, numbers, and functions of your own")


def _undecorated(function: Callable) -> str:
    """The text of a function without what compiles it."""
    text = textwrap.dedent(inspect.getsource(function))
    return text[text.index("def "):].rstrip()


def _outside(text: str) -> list[str]:
    """Names that a function loads and does not make itself."""
    tree = ast.parse(text).body[0]
    names = [n for n in ast.walk(tree) if isinstance(n, ast.Name)]
    own = {n.id for n in names if isinstance(n.ctx, ast.Store)} | {a.arg for a in ast.walk(tree)
                                                                   if isinstance(a, ast.arg)} | {tree.name}
    return [n.id for n in names if isinstance(n.ctx, ast.Load) and n.id not in own and not hasattr(builtins, n.id)]
