"""Turn a user's Python right-hand side into compiled code without changing what it computes.

It is run on symbols first (`pwaid.mismatch.trace`), else translated from its source (`pwaid.mismatch.translate`). The
compiled function is compared with the original at random points before it is used; where neither reproduces it, the
caller falls back to the plain loop.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numba import njit

from pwaid.mismatch.engine import RHS_TYPE
from pwaid.mismatch.symbolic import TraceFailure
from pwaid.mismatch.trace import traced
from pwaid.mismatch.translate import RAISES, CompileFailure, compile_function

__all__ = ["CompileFailure", "compiled_pair"]


SPECIAL = (0.0, 1.0, 3.0, 100.0)  # magnitudes of states and inputs at the first points of a comparison


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
        raise CompileFailure(_first_line(error)) from error


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
        def checked(compiled, original=original, size=size):
            _verify(original, compiled, size, nx, nu, parameters, scale, constants or {})
            return compiled

        try:
            plain, some = traced(original, size, nx, nu, names, constants or {})
            found.append(checked(_from_trace(plain)))
        except (TraceFailure, CompileFailure) as failure:
            try:
                seen: dict = {}
                inner = compile_function(original, names, seen, constants)
                some = seen[RAISES]
                found.append(checked(_wrap(inner, size, RHS_TYPE, some)))
            except CompileFailure as other:
                raise CompileFailure(f"run on symbols: {failure}; its source: {other}") from other
        raises |= some
    return found[0], found[1], raises


def _from_trace(plain: Callable):
    try:
        return njit(RHS_TYPE.signature, error_model="numpy", nogil=True)(plain)
    except Exception as error:  # numba raises many kinds; each means: no compiled counterpart
        raise CompileFailure(_first_line(error)) from error


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def _whole_state(t, x, u, params):
    return x


def _verify(original, compiled, size, nx, nu, parameters, scale, constants, points: int = 24):
    rng = np.random.default_rng(0)
    values, compared = np.array(list(parameters.values()), dtype=float), 0
    for k in range(4 * points):
        t, x, u = rng.uniform(0, 10), scale * rng.normal(size=nx), rng.normal(size=nu)
        if k < len(SPECIAL):  # where branches and divisions may differ
            x, u = (SPECIAL[k] * np.sign(v) for v in (x, u))
        p = values * rng.uniform(0.9, 1.1, values.size)
        with np.errstate(all="ignore"):
            try:
                want = np.array(original(t, x.copy(), u.copy(), {**constants, **dict(zip(parameters, p, strict=True))}),
                                  dtype=float).ravel()
            except TraceFailure as failure:
                raise CompileFailure("it keeps what it was traced with") from failure
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
