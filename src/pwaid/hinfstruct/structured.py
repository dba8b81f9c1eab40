"""Structured models: (A(theta), B(theta), C(theta), D(theta)) with a known dependence on a few parameters.

Three ways to one: a pattern of free entries (`StructuredModel.from_pattern`), a Python function of named
physical parameters (`StructuredModel.from_function`), or a change of parameters of an existing model
(`reparametrise`).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import control
import numpy as np

from pwaid.errors import InputError
from pwaid.hinfstruct.statespace import Matrices, to_control

__all__ = ["Parameter", "StructuredModel"]

Jacobian = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Parameter:
    """A named parameter.

    Attributes
    ----------
    name : str
    nominal : float
        First guess, in ``unit``; nan when there is none.
    unit : str
    low, high : float
        Bounds; infinite when free.
    """

    name: str
    nominal: float = np.nan
    unit: str = ""
    low: float = -np.inf
    high: float = np.inf

    def __post_init__(self):
        if not self.low < self.high:
            raise InputError(f"parameter {self.name!r}: low {self.low} must be below high {self.high}")
        if np.isfinite(self.nominal) and not self.low <= self.nominal <= self.high:
            raise InputError(
                f"parameter {self.name!r}: nominal {self.nominal} lies outside [{self.low}, {self.high}] "
                f"{self.unit}"
            )


@dataclass(frozen=True)
class StructuredModel:
    """State-space matrices as smooth functions of a parameter vector.

    Use the constructors `from_pattern` and `from_function`; the fields are what the solvers read.

    Attributes
    ----------
    parameters : tuple of Parameter
    evaluate : callable
        ``theta -> (A, B, C, D)``.
    differentiate : callable
        ``theta -> (dA, dB, dC, dD)``, each with the parameter along axis 0.
    affine : bool
        The matrices are affine in theta (patterns are).
    """

    parameters: tuple[Parameter, ...]
    evaluate: Callable[[np.ndarray], tuple]
    differentiate: Callable[[np.ndarray], Jacobian]
    affine: bool = False

    @classmethod
    def from_pattern(
        cls, A, B, C, D=None, *, parameters: Sequence[Parameter] | None = None
    ) -> StructuredModel:
        """Model from matrices whose entries are numbers or parameter names with a factor, such as ``"-k"`` or
        ``"2*k"``.

        Parameters
        ----------
        A, B, C, D : nested sequences of numbers and strings
            One name may stand in several places. D defaults to zero.
        parameters : sequence of Parameter, optional
            Units and bounds; its order fixes the order of theta. Default: order of first appearance, column
            by column through A, B, C, D.

        Raises
        ------
        InputError
            An entry that cannot be read, a name that is not declared or never used, shapes that do not fit.
        """
        if D is None:
            D = [[0.0] * len(B[0]) for _ in C]
        parsed = [_parse(block, label) for block, label in zip((A, B, C, D), "ABCD", strict=True)]
        order = list(dict.fromkeys(name for _, terms in parsed for name, *_ in terms))
        if parameters is None:
            parameters = [Parameter(name) for name in order]
        names = [p.name for p in parameters]
        _check_names(names)
        if set(names) != set(order):
            raise InputError(
                f"the pattern uses the parameters {sorted(order)} and {sorted(names)} were declared"
            )
        index = {name: k for k, name in enumerate(names)}
        constants, slopes = [], []
        for constant, terms in parsed:
            slope = np.zeros((len(names), *constant.shape))
            for name, i, j, factor in terms:
                slope[index[name], i, j] += factor
            constants.append(constant)
            slopes.append(slope)
        _check_shapes(*constants)
        evaluate = partial(_affine, tuple(constants), tuple(slopes))
        return cls(tuple(parameters), evaluate, partial(_fixed, tuple(slopes)), affine=True)

    @classmethod
    def from_function(
        cls,
        function: Callable,
        parameters: Sequence[Parameter],
        *,
        jacobian: Callable[[np.ndarray], Jacobian] | str = "complex-step",
    ) -> StructuredModel:
        """Model from ``function(theta) -> (A, B, C, D)`` with theta in the order of ``parameters``.

        Parameters
        ----------
        jacobian : callable or "complex-step"
            ``theta -> (dA, dB, dC, dD)``, parameter along axis 0. The complex step is exact to rounding when
            the function is analytic and accepts complex theta (no abs, max, comparisons or ``float()`` on
            it); this is tested once at the nominal values against central differences.

        Raises
        ------
        InputError
            The function fails, gives matrices that do not fit, or is not complex-analytic.
        """
        parameters = tuple(parameters)
        _check_names([p.name for p in parameters])
        nominal = np.array([p.nominal for p in parameters])
        if not np.isfinite(nominal).all():
            raise InputError(
                "every parameter of a function model needs a finite nominal value, to test the function there"
            )
        blocks = function(nominal)
        if not isinstance(blocks, tuple | list) or len(blocks) != 4:
            raise InputError("the function must return four matrices (A, B, C, D)")
        _check_shapes(*(np.atleast_2d(np.asarray(b, dtype=float)) for b in blocks))
        evaluate = partial(_blocks, function)
        if jacobian == "complex-step":
            differentiate = partial(_complex_step, evaluate)
            _check_analytic(evaluate, differentiate, nominal)
        elif callable(jacobian):
            differentiate = jacobian
        else:
            raise InputError(f"jacobian = {jacobian!r}; expected a callable or 'complex-step'")
        return cls(parameters, evaluate, differentiate)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @property
    def size(self) -> int:
        return len(self.parameters)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([p.low for p in self.parameters]), np.array([p.high for p in self.parameters])

    @property
    def nominal(self) -> np.ndarray:
        return np.array([p.nominal for p in self.parameters])

    def check(self, theta) -> np.ndarray:
        """theta as a finite float vector of the right length."""
        theta = np.asarray(theta, dtype=float)
        if theta.shape != (self.size,):
            raise InputError(
                f"theta has shape {theta.shape}; this model has {self.size} parameters {self.names}"
            )
        if not np.isfinite(theta).all():
            bad = [n for n, v in zip(self.names, theta, strict=True) if not np.isfinite(v)]
            raise InputError(f"theta is not finite for {bad}; give finite values")
        return theta

    def matrices(self, theta) -> Matrices:
        """(A, B, C, D) at theta."""
        return Matrices(*self.evaluate(np.asarray(theta, dtype=float)))

    def statespace(self, theta) -> control.StateSpace:
        """`control.StateSpace` at theta."""
        return to_control(self.matrices(self.check(theta)))

    def reparametrise(
        self, parameters: Sequence[Parameter], function: Callable, jacobian: Callable | None = None
    ) -> StructuredModel:
        """The same model in new parameters p, with theta = function(p), d theta/d p = jacobian(p) of shape
        (size, len(p)).

        Without a jacobian the complex step is used.
        """
        parameters = tuple(parameters)
        _check_names([p.name for p in parameters])
        if jacobian is None:
            jacobian = partial(_complex_step_slope, function)
        return replace(
            self,
            parameters=parameters,
            evaluate=partial(_evaluate_through, self.evaluate, function),
            differentiate=partial(_differentiate_through, self.differentiate, function, jacobian),
            affine=False,
        )


# What models hold: functions of this module with their first arguments bound, so that models can be pickled.
def _affine(constants, slopes, theta):
    return tuple(c + np.tensordot(theta, s, 1) for c, s in zip(constants, slopes, strict=True))


def _fixed(slopes, theta):
    return slopes


def _blocks(function: Callable, theta):
    return tuple(np.atleast_2d(np.asarray(b)) for b in function(theta))


def _stepped(function: Callable, theta):
    """(value, step) of the function a tiny imaginary step from theta along each parameter in turn."""
    theta = np.asarray(theta, dtype=float)
    for k in range(theta.size):
        step = 1e-30 * max(abs(theta[k]), 1e-30)
        shifted = theta.astype(complex)
        shifted[k] += 1j * step
        yield function(shifted), step


def _complex_step(evaluate: Callable, theta):
    columns = [[np.imag(block) / step for block in blocks] for blocks, step in _stepped(evaluate, theta)]
    return tuple(np.stack([c[b] for c in columns]) for b in range(4))


def _complex_step_slope(function: Callable, p):
    return np.stack([np.imag(value) / step for value, step in _stepped(function, p)], axis=1)


def _evaluate_through(evaluate: Callable, function: Callable, p):
    return evaluate(function(p))


def _differentiate_through(differentiate: Callable, function: Callable, jacobian: Callable, p):
    slope = jacobian(p)
    return tuple(np.tensordot(slope.T, d, 1) for d in differentiate(function(p)))


_TERM = re.compile(r"^\s*([+-]?)\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?)\s*\*\s*)?([A-Za-z_]\w*)\s*$")


def _parse(block, label: str):
    """Constant part of a pattern and its terms (name, row, column, factor), column by column."""
    rows = [list(row) for row in block]
    if not rows or any(len(row) != len(rows[0]) for row in rows):
        raise InputError(f"pattern {label}: rows of different length or none; write a rectangular table")
    constant, terms = np.zeros((len(rows), len(rows[0]))), []
    for j in range(len(rows[0])):
        for i, row in enumerate(rows):
            entry = row[j]
            if isinstance(entry, str):
                match = _TERM.match(entry)
                if not match:
                    raise InputError(
                        f"pattern {label}[{i}, {j}] = {entry!r}; write a name, '-name' or '2.5*name'"
                    )
                sign, factor, name = match.groups()
                terms.append((name, i, j, float(factor or 1.0) * (-1.0 if sign == "-" else 1.0)))
            else:
                constant[i, j] = float(entry)
    if not np.isfinite(constant).all():
        raise InputError(f"pattern {label} contains NaN or infinite numbers; fixed entries must be finite")
    return constant, terms


def _check_names(names: list[str]) -> None:
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise InputError(f"parameter names {twice} are declared more than once; names must differ")
    if not names:
        raise InputError("a structured model needs at least one parameter")


def _check_shapes(A, B, C, D) -> None:
    n, nu, ny = A.shape[0], B.shape[1], C.shape[0]
    if A.shape != (n, n) or B.shape != (n, nu) or C.shape != (ny, n) or D.shape != (ny, nu):
        raise InputError(
            f"the matrices do not fit together: A {A.shape}, B {B.shape}, C {C.shape}, D {D.shape}"
        )


def _check_analytic(evaluate: Callable, differentiate: Callable, theta: np.ndarray) -> None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", np.exceptions.ComplexWarning)
            exact = differentiate(theta)
    except (TypeError, ValueError, np.exceptions.ComplexWarning) as error:
        raise InputError(
            f"the function does not accept complex parameters ({error}); avoid float() and comparisons on "
            "them, "
            "build arrays with np.array([...]), or pass jacobian="
        ) from error
    for k in range(theta.size):
        step = 1e-5 * max(abs(theta[k]), 1e-3)
        shift = step * np.eye(theta.size)[k]
        for d, plus, minus in zip(exact, evaluate(theta + shift), evaluate(theta - shift), strict=True):
            central = (plus - minus) / (2 * step)
            tolerance = 1e-4 * (np.abs(central).max() + np.abs(d[k]).max()) + 1e-9 * np.abs(plus).max() / step
            if np.abs(central - d[k]).max() > tolerance:
                raise InputError(
                    f"the complex-step derivative with respect to parameter {k} disagrees with central "
                    "differences: the "
                    "function is not analytic there (abs, max, real, conj ...); rewrite it or pass jacobian="
                )
