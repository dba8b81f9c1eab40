"""A simulator that can only be called: ``simulate(u) -> y``, perhaps with a force, parameters or a start.

What is in front of it and behind it can be changed, what is inside cannot: see `blackbox_engine`.
"""

from __future__ import annotations

import copy
import hashlib
import inspect
import itertools
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pwaid.errors import InputError

__all__ = ["BlackBox", "looks_like_black_box"]

OPTIONS = ("force", "params", "x0")
KEPT = 64  # simulations remembered: effects behind the simulator ask for the same one again and again


def _arguments(simulate: Callable):
    """Names and defaults of the arguments, or None where Python cannot tell (some compiled functions)."""
    try:
        return list(inspect.signature(simulate).parameters.values())
    except (TypeError, ValueError):
        return None


def looks_like_black_box(simulate: Callable) -> bool:
    """Whether a callable is ``simulate(u, ...)`` rather than a right-hand side ``f(t, x, u, params)``.

    Raises
    ------
    InputError
        When it can be neither.
    """
    arguments = _arguments(simulate)
    if arguments is None:
        return True
    if not arguments:
        raise InputError("the simulator takes no argument; expected simulate(u) or a right-hand side "
                         "f(t, x, u, params)")
    variable = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    needed = [a.name for a in arguments[1:]
              if a.default is a.empty and a.kind not in variable and a.name not in OPTIONS]
    if len(needed) >= 2:
        return False
    if needed:
        raise InputError(f"the simulator needs {needed[0]!r} besides u; expected simulate(u) with the options "
                         f"{', '.join(OPTIONS)}, or a right-hand side f(t, x, u, params)")
    return True


class BlackBox:
    """The user's callable with its contract checked and its last simulations remembered.

    Parameters
    ----------
    simulate : ``simulate(u, *, force=None, params=None, x0=None) -> y`` with u (N, n_inputs) at the sampling of
        the recordings and y (N, n_outputs) or, for one output, (N,). All but u are optional. `force`, an
        additional input, comes as (N,), or as (N, n) when ``simulate.forces`` maps n > 1 names to units.
        `params` is a mapping of name to number; its default, or ``simulate.params``, holds the nominal ones.
        `x0` is the start state; its default, or ``simulate.x0``, is the nominal one.
    inputs, outputs : channel names.
    parameters : nominal parameters, in place of those the callable carries.

    Raises
    ------
    InputError
        When the callable takes parameters or a start and gives no nominal ones.
    """

    def __init__(self, simulate: Callable, inputs: Sequence[str], outputs: Sequence[str],
                 parameters: Mapping[str, float] | None = None):
        self.simulate, self.inputs, self.outputs = simulate, tuple(inputs), tuple(outputs)
        arguments = {a.name: a for a in _arguments(simulate) or ()}
        self.takes = tuple(n for n in OPTIONS if n in arguments)
        self.forces = self._forces() if "force" in self.takes else {}
        self.parameters = self._nominal(arguments, parameters) if "params" in self.takes else {}
        self.start = self._start(arguments) if "x0" in self.takes else np.zeros(0)
        self.pulses: tuple[tuple[int, int, int], ...] = ()
        self.base = self.sizes = np.zeros(0)
        self.raised: set[str] = set()
        self._kept: OrderedDict[bytes, np.ndarray | None] = OrderedDict()
        self._lock = threading.Lock()

    def _forces(self) -> dict[str, str]:
        given = getattr(self.simulate, "forces", {"force": ""})
        return dict(given) if isinstance(given, Mapping) else {str(n): "" for n in given}

    def _nominal(self, arguments, given) -> dict[str, float]:
        default = arguments["params"].default
        found = given or getattr(self.simulate, "params", None) or (default if isinstance(default, Mapping) else None)
        if not found:
            raise InputError("the simulator takes params and gives no nominal ones; write simulate(u, params={...}) or "
                             "set simulate.params = {...}")
        try:
            return {str(n): float(v) for n, v in found.items()}
        except (TypeError, ValueError) as error:
            raise InputError(f"the simulator's params are {found!r}; expected one number per name") from error

    def _start(self, arguments) -> np.ndarray:
        default = arguments["x0"].default
        found = getattr(self.simulate, "x0", None)
        found = default if found is None and default is not inspect.Parameter.empty else found
        if found is None:
            raise InputError("the simulator takes x0 and gives no nominal one; write simulate(u, x0=(0.0, ...)) or "
                             "set simulate.x0")
        return np.atleast_1d(np.asarray(found, dtype=float)).ravel()

    def with_history(self, samples: int, base, sizes) -> BlackBox:
        """The same callable, started through inputs in front of every recording.

        The start of a callable without x0 cannot be set, but inputs can lead there: `base` (n_inputs,) held for
        `samples` samples, plus a free pulse over the last eighth of them, the eighth, the quarter and the half
        before, at each input. `sizes` (n_inputs,) are the pulses' magnitudes.
        """
        other = copy.copy(self)
        other._kept, other._lock = OrderedDict(), threading.Lock()
        edges = [0, samples // 2, 3 * samples // 4, 7 * samples // 8, samples]
        other.pulses = tuple((j, a, b) for j in range(len(self.inputs)) for a, b in itertools.pairwise(edges) if b > a)
        other.base = np.asarray(base, dtype=float)
        other.sizes = np.array([max(float(sizes[j]), 1e-9) for j, _, _ in other.pulses])
        return other

    @property
    def n_starts(self) -> int:
        """Free numbers that set the start of a recording."""
        return len(self.pulses) or self.start.size

    @property
    def start_sizes(self) -> np.ndarray:
        """Magnitude of each of them: for x0 its nominal value, or 1 where that is zero."""
        return self.sizes if self.pulses else np.where(self.start == 0.0, 1.0, np.abs(self.start))

    def _history(self, width: int, moved) -> np.ndarray:
        """Inputs (samples, width) in front of a recording."""
        H = np.zeros((self.pulses[-1][2] if self.pulses else 0, width))
        H[:, :self.base.size] = self.base
        for (j, a, b), size in zip(self.pulses, moved, strict=True) if self.pulses else ():
            H[a:b, j] += size
        return H

    def run(self, U, params: Mapping[str, float], moved) -> np.ndarray | None:
        """y (N, n_outputs) for inputs and forces U (N, n_inputs + n_forces) and a start `moved` from the nominal
        one; None where the callable raises. A result that is not finite is returned as it is."""
        asked = (np.ascontiguousarray(U).tobytes(), repr(sorted(params.items())).encode(), np.asarray(moved).tobytes())
        key = hashlib.blake2b(b"".join(asked), digest_size=16).digest()
        with self._lock:  # one call at a time: nobody knows what the callable keeps
            if key not in self._kept:
                H = self._history(U.shape[1], moved)
                try:
                    self._kept[key] = self.call(np.vstack([H, U]), params, moved)[len(H):]
                except InputError:
                    raise
                except Exception as error:  # a trial that fails counts as diverged; which ones is reported
                    self.raised.add(f"{type(error).__name__}: {error}")
                    self._kept[key] = None
                if len(self._kept) > KEPT:
                    self._kept.popitem(last=False)
            return self._kept[key]

    def call(self, U, params: Mapping[str, float], moved) -> np.ndarray:
        """One call, its result brought to (N, n_outputs).

        Raises
        ------
        InputError
            When the result has another shape; whatever the callable raises comes through.
        """
        nu, options = len(self.inputs), {}
        if self.forces:
            options["force"] = U[:, nu].copy() if len(self.forces) == 1 else U[:, nu:].copy()
        if self.parameters:
            options["params"] = {n: float(params[n]) for n in self.parameters}
        if self.start.size:
            options["x0"] = self.start + np.asarray(moved, dtype=float)
        result = self.simulate(U[:, :nu].copy(), **options)
        try:
            y = np.array(result, dtype=float)  # it may be an array that the callable fills again
        except (TypeError, ValueError) as error:
            raise InputError(f"the simulator returned {type(result).__name__}; expected numbers y (N, "
                             f"{len(self.outputs)})") from error
        y = y[:, None] if y.ndim == 1 else y
        if y.shape != (len(U), len(self.outputs)):
            raise InputError(f"the simulator returned shape {np.shape(result)} for u of shape {U[:, :nu].shape}; "
                             f"expected y of shape ({len(U)}, {len(self.outputs)}): one row a sample, one column an "
                             "output")
        return y
