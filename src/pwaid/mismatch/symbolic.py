"""Numbers that remember how they were computed, so that running a Python function once shows its arithmetic.

A `Symbol` stands for one number or truth value. Operators and functions on symbols are written to a `Tape`, each
distinct one once. A condition of an ``if`` has to be decided when Python asks for it: the tape answers from the prefix
of decisions it was started with, then with True, and keeps the path, so that its caller can walk all branches.
"""

from __future__ import annotations

import operator
from collections.abc import Callable

import numpy as np

__all__ = ["FUNCTIONS", "Symbol", "Tape", "TraceFailure", "apply", "as_numbers", "by_name", "elementwise",
           "is_symbolic"]


LONGEST = 200  # decisions on one way through: beyond it a loop waits for a number


class TraceFailure(BaseException):
    """The function needs a number where only a symbol is known; no `except Exception` of its code may swallow it."""


def _select(condition, a, b):
    return a if condition else b


def _heaviside(x, at_zero):
    return at_zero if x == 0 else float(x > 0)


# how each is computed from plain numbers, and its text in compiled code
FUNCTIONS: dict[str, tuple[Callable, str]] = {
    "add": (operator.add, "({} + {})"), "subtract": (operator.sub, "({} - {})"),
    "multiply": (operator.mul, "({} * {})"), "divide": (np.true_divide, "({} / {})"),
    "power": (np.float_power, "({} ** {})"), "remainder": (np.remainder, "np.remainder({}, {})"),
    "floor_divide": (np.floor_divide, "({} // {})"), "negative": (operator.neg, "(-{})"),
    "less": (operator.lt, "({} < {})"), "less_equal": (operator.le, "({} <= {})"),
    "equal": (operator.eq, "({} == {})"), "not_equal": (operator.ne, "({} != {})"),
    "logical_and": (np.logical_and, "({} and {})"), "logical_or": (np.logical_or, "({} or {})"),
    "logical_not": (np.logical_not, "(not {})"), "number": (float, "(1.0 if {} else 0.0)"),
    "select": (_select, "({1} if {0} else {2})"),
    "smaller": (min, "({1} if {1} < {0} else {0})"), "larger": (max, "({1} if {1} > {0} else {0})"),
    "minimum": (np.minimum, "np.minimum({}, {})"), "maximum": (np.maximum, "np.maximum({}, {})"),
    "arctan2": (np.arctan2, "np.arctan2({}, {})"), "hypot": (np.hypot, "np.hypot({}, {})"),
    "copysign": (np.copysign, "np.copysign({}, {})"), "fmod": (np.fmod, "np.fmod({}, {})"),
    "heaviside": (_heaviside, "({1} if {0} == 0 else (1.0 if {0} > 0 else 0.0))"),
    "square": (np.square, "({0} * {0})"), "reciprocal": (np.reciprocal, "(1.0 / {})"), "rint": (np.rint, "np.rint({})"),
    "absolute": (abs, "abs({})"), "sign": (np.sign, "np.sign({})"),
} | {name: (getattr(np, name), f"np.{name}({{}})") for name in (
    "sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh", "arcsinh", "arccosh", "arctanh", "exp",
    "expm1", "exp2", "log", "log2", "log10", "log1p", "sqrt", "cbrt", "floor", "ceil", "trunc", "deg2rad", "rad2deg",
    "isnan", "isfinite", "isinf")}
TRUTHS = {"less", "less_equal", "equal", "not_equal", "logical_and", "logical_or", "logical_not", "isnan", "isfinite",
          "isinf"}
OTHER_NAMES = {"true_divide": "divide", "abs": "absolute", "fabs": "absolute", "conjugate": "conj", "mod": "remainder",
               "radians": "deg2rad", "degrees": "rad2deg", "float_power": "power"}


class Tape:
    """The distinct operations (name, arguments) of a function, and the path of decisions of the present run.

    An argument is the index of an earlier operation. Leaves are ("constant", value) and ("input", text).
    """

    def __init__(self):
        self.nodes: list[tuple] = []
        self._index: dict[tuple, int] = {}
        self.start(())

    def start(self, prefix: tuple[bool, ...]) -> None:
        """Begin a run that decides as `prefix` says, and then True."""
        self.prefix, self.path, self._known = prefix, [], {}

    def node(self, *operation) -> int:
        """The index of this operation."""
        if operation not in self._index:
            self._index[operation] = len(self.nodes)
            self.nodes.append(operation)
        return self._index[operation]

    def symbol(self, *operation) -> Symbol:
        return Symbol(self, self.node(*operation))

    def constant(self, value) -> int:
        value = bool(value) if isinstance(value, bool | np.bool_) else float(value)
        return self.node("constant", repr(value), value)

    def decide(self, node: int) -> bool:
        """Whether the condition holds on this path."""
        name, *rest = self.nodes[node]
        if name == "logical_not":
            return not self.decide(rest[0])
        if node not in self._known:
            k = len(self.path)
            if k >= LONGEST:
                raise TraceFailure(f"it takes more than {LONGEST} decisions: does a loop wait for a number?")
            self._known[node] = self.prefix[k] if k < len(self.prefix) else True
            self.path.append((node, self._known[node]))
        return self._known[node]


def is_symbolic(value) -> bool:
    """Whether there is a symbol in this number, sequence or array."""
    if isinstance(value, np.ndarray):
        return value.dtype == object and any(isinstance(v, Symbol) for v in value.flat)
    if isinstance(value, list | tuple):
        return any(is_symbolic(v) for v in value)
    return isinstance(value, Symbol)


def as_numbers(value):
    """An array of objects that are all numbers, as floats; anything else as it came."""
    if isinstance(value, np.ndarray) and value.dtype == object and not is_symbolic(value):
        return value.astype(float)
    return value


def apply(name: str, *arguments):
    """The function `name` of FUNCTIONS of numbers and symbols: a number when all are numbers."""
    tape = next((a.tape for a in arguments if isinstance(a, Symbol)), None)
    if tape is None:
        return FUNCTIONS[name][0](*arguments)
    known = _shortcut(name, arguments)
    if known is not None:
        return known
    if name not in ("select", "logical_and", "logical_or", "logical_not", "number"):
        arguments = [apply("number", a) if isinstance(a, Symbol) and a.truth else a for a in arguments]
    nodes = [a.node if isinstance(a, Symbol) else tape.constant(a) for a in arguments]
    return tape.symbol(name, *nodes)


def _shortcut(name, arguments):
    """What needs no operation: adding zero, multiplying by zero or one, and the like; None otherwise."""
    for this, other in ((0, 1), (1, 0)):
        if len(arguments) == 2 and isinstance(arguments[this], int | float | np.number):
            rest, v = arguments[other], arguments[this]
            plain = not (isinstance(rest, Symbol) and rest.truth)
            if v == 0 and plain and (name == "add" or (name == "subtract" and this == 1)):
                return rest
            if v == 1 and plain and (name == "multiply" or (name in ("divide", "power") and this == 1)):
                return rest
            if v == 0 and name == "multiply":
                return 0.0
    return None


class Symbol:
    """A number or truth value that is not known, only how it is computed."""

    __slots__ = ("node", "tape")

    def __init__(self, tape: Tape, node: int):
        self.tape, self.node = tape, node

    @property
    def truth(self) -> bool:
        """Whether it is a truth value."""
        return self.tape.nodes[self.node][0] in TRUTHS

    def __bool__(self):
        return self.tape.decide(self.node if self.truth else apply("not_equal", self, 0.0).node)

    def __hash__(self):
        return hash(self.node)

    def _refuse(self, *ignored):
        raise TraceFailure("it asks for the number itself")

    __float__ = __int__ = __index__ = __complex__ = _refuse

    def __array_ufunc__(self, ufunc, method, *inputs, out=None, **options):
        name = OTHER_NAMES.get(ufunc.__name__, ufunc.__name__)
        if method != "__call__" or options or name not in _BY_UFUNC:
            raise TraceFailure(f"it uses numpy's {ufunc.__name__}")
        result = _BY_UFUNC[name](*inputs)
        if out is None:
            return result
        out[0][...] = result
        return out[0]

    def __round__(self, digits=None):
        return self._refuse() if digits else apply("rint", self)

    def __pos__(self):
        return self

    def __abs__(self):
        return apply("absolute", self)

    def __neg__(self):
        return apply("negative", self)

    def __invert__(self):
        return apply("logical_not", self) if self.truth else self._refuse()

    def __getattr__(self, name):
        """NumPy calls methods named like its functions on the elements of an object array."""
        name = OTHER_NAMES.get(name, name)
        if name in ("conj", "copy", "item", "real"):
            return self if name == "real" else lambda: self
        if name in FUNCTIONS:
            return lambda *others: apply(name, self, *others)
        raise AttributeError(name)


def _operate(name, a, b):
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray) or not all(
            isinstance(v, Symbol | int | float | np.number | np.bool_) for v in (a, b)):
        return NotImplemented  # an array handles its own elements
    return apply(name, a, b)


def _define():
    """The operators, and those that compare, of Symbol."""
    for name, text in (("add", "add"), ("subtract", "sub"), ("multiply", "mul"), ("divide", "truediv"),
                       ("remainder", "mod"), ("floor_divide", "floordiv"), ("logical_and", "and"),
                       ("logical_or", "or"), ("power", "pow")):
        setattr(Symbol, f"__{text}__", lambda a, b, name=name: _operate(name, a, b))
        setattr(Symbol, f"__r{text}__", lambda b, a, name=name: _operate(name, a, b))
    for name, text in (("less", "lt"), ("less_equal", "le"), ("equal", "eq"), ("not_equal", "ne")):
        setattr(Symbol, f"__{text}__", lambda a, b, name=name: _operate(name, a, b))
    Symbol.__gt__ = lambda a, b: _operate("less", b, a)
    Symbol.__ge__ = lambda a, b: _operate("less_equal", b, a)


_define()


def elementwise(function: Callable) -> Callable:
    """`function` of scalars, numbers or symbols, applied to arrays by numpy's rules."""

    def over_arrays(*arguments):
        boxed = []
        for a in arguments:
            box = np.empty((), dtype=object) if isinstance(a, Symbol) else np.asarray(a, dtype=object)
            if isinstance(a, Symbol):
                box[()] = a
            boxed.append(box)
        return np.frompyfunc(function, len(boxed), 1)(*boxed)

    return over_arrays


def by_name(name: str) -> Callable:
    """The function `name` of FUNCTIONS, of arrays too."""
    return elementwise(lambda *values: apply(name, *values))


_BY_UFUNC = {name: by_name(name) for name in FUNCTIONS} | {
    "conj": lambda a: a, "positive": lambda a: a,
    "greater": lambda a, b: _BY_UFUNC["less"](b, a), "greater_equal": lambda a, b: _BY_UFUNC["less_equal"](b, a),
    "bitwise_and": by_name("logical_and"), "bitwise_or": by_name("logical_or"), "invert": by_name("logical_not")}
