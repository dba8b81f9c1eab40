"""What the tool knows of the user's simulator: sizes, names, parameters, and the two functions to call."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import control
import numpy as np
from numba import njit

from pwaid.errors import InputError
from pwaid.mismatch.blackbox import BlackBox, looks_like_black_box
from pwaid.mismatch.compile_rhs import CompileFailure, compiled_pair
from pwaid.mismatch.engine import RHS_TYPE
from pwaid.mismatch.interconnected import equations_of_parts
from pwaid.mismatch.realise import realise

__all__ = ["Plant", "as_plant", "called_with_arrays", "checked", "linear_behind", "takes_arrays", "whole_or_real"]


@dataclass(frozen=True)
class Plant:
    """The nominal simulator as functions f(t, x, u, params) and g(t, x, u, params).

    `rhs` and `out` are their compiled forms, None when they do not compile; `parameters` maps every
    name to its nominal value in a fixed order; `constants` is what else params holds: texts, arrays, switches.
    `takes_arrays`: with x (nx, M), u (nu, M) and parameters (M,) they give (n, M), verified.
    Where the functions raise, derivatives and outputs are NaN, and `raised` keeps what they said. `dt` is 0 for
    continuous time.

    A black box has `black_box` instead of equations, `dt` = 1 (one call covers all samples), its start as
    states, `force_names` for its force hook, and `gains`, pairs (input, position of its gain parameter).
    `arguments` are the parameters that build() takes, see `pwaid.mismatch.built`; `entries` gives the matrix entries
    that follow from them, which the compiled forms read behind the parameters.
    """

    update: Callable
    output: Callable | None
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    parameters: Mapping[str, float] = field(default_factory=dict)
    constants: Mapping[str, object] = field(default_factory=dict)
    raised: set = field(default_factory=set, repr=False, compare=False)
    dt: float = 0.0
    rhs: object = None
    out: object = None
    source: str = ""
    linear: bool = False
    takes_arrays: bool = False
    notes: tuple[str, ...] = ()
    black_box: BlackBox | None = None
    force_names: tuple[str, ...] = ()
    force_units: tuple[str, ...] = ()
    gains: tuple[tuple[int, int], ...] = ()
    arguments: tuple[str, ...] = ()
    entries: Callable | None = field(default=None, repr=False)

    @property
    def start_sizes(self) -> np.ndarray:
        """(states,) least magnitude of the start states: that of a black box, zero where simulation tells."""
        return self.black_box.start_sizes if self.black_box is not None else np.zeros(len(self.state_names))

    @property
    def sizes(self) -> tuple[int, int, int]:
        return len(self.state_names), len(self.input_names), len(self.output_names)

    def vector(self) -> np.ndarray:
        """Nominal parameter values by position; one zero when there are none, for the compiled loop."""
        return np.array(list(self.parameters.values()), dtype=float) if self.parameters else np.zeros(1)

    def full(self, p) -> np.ndarray:
        """The parameters (n,), or of several simulations (k, n), with what the compiled forms read behind them."""
        if self.entries is None:
            return p
        return np.concatenate([p, np.apply_along_axis(self.entries, -1, p)], axis=-1)

    def derivative(self, x, u, p=None, t: float = 0.0) -> np.ndarray:
        """dx/dt at one point; of a discrete simulator its change over a step, per second."""
        return self._rate(np.asarray(x, dtype=float), self._update_at(x, u, self.vector() if p is None else p, t))

    def _rate(self, X, found) -> np.ndarray:
        """Derivatives from what the update function returned at states X: the next states where it is discrete."""
        return (found - X) / self.dt if self.dt and self.black_box is None else found

    def _update_at(self, x, u, p, t: float = 0.0) -> np.ndarray:
        x, u = np.asarray(x, dtype=float).copy(), np.asarray(u, dtype=float).copy()
        if self.rhs is not None:
            dx = np.empty(len(x))
            self.rhs(t, x, u, self.full(p), dx)
            return dx
        return self._called(self.update, t, x, u, p, len(x))

    def outputs(self, x, u, p=None, t: float = 0.0) -> np.ndarray:
        """y at one point."""
        x, u = np.asarray(x, dtype=float).copy(), np.asarray(u, dtype=float).copy()
        p = self.vector() if p is None else p
        if self.out is not None:
            y = np.empty(len(self.output_names))
            self.out(t, x, u, self.full(p), y)
            return y
        if self.output is None:
            return x
        return self._called(self.output, t, x, u, p, len(self.output_names))

    def _called(self, function, t, x, u, p, size: int) -> np.ndarray:
        try:
            return np.asarray(function(t, x, u, self.as_dict(p)), dtype=float).ravel()
        except Exception as error:  # the simulation ends here; what was said is reported
            self.raised.add(f"{type(error).__name__}: {error}")
            return np.full(size, np.nan)

    def derivatives(self, t, X, U, P) -> np.ndarray:
        """`derivative` (M, nx) at M points: t (M,), X (M, nx), U (M, nu), P (M, n_parameters)."""
        return self._rate(X, self._many(self.update, self._update_at, t, X, U, P, X.shape[1]))

    def many_outputs(self, t, X, U, P) -> np.ndarray:
        """y (M, ny) at M points."""
        return self._many(self.output, self.outputs, t, X, U, P, len(self.output_names)) if self.output else X.copy()

    def _many(self, function, single, t, X, U, P, size: int) -> np.ndarray:
        if self.takes_arrays:
            try:
                return called_with_arrays(function, t, X, U, self.as_dict(P.T), size)
            except Exception:  # some point is outside the function's domain: find out which
                pass
        return np.array([single(x, u, p, s) for s, x, u, p in zip(t, X, U, P, strict=True)]).reshape(len(X), size)

    def as_dict(self, p) -> dict[str, float]:
        """What the user's functions get as params."""
        return {**self.constants, **dict(zip(self.parameters, p, strict=False))}


def called_with_arrays(function, t, X, U, params, size: int) -> np.ndarray:
    """(M, size) from one call with arrays in place of scalars; entries that are plain numbers hold for all points."""
    result = function(t, np.ascontiguousarray(X.T), np.ascontiguousarray(U.T), params)
    rows = [np.broadcast_to(np.asarray(row, dtype=float), (len(X),)) for row in result]
    if len(rows) != size:
        raise ValueError(f"{len(rows)} rows came, expected {size}")
    return np.array(rows).T


def takes_arrays(plant: Plant, scale: float, points: int = 40) -> bool:
    """Whether update and output, called with arrays, give what single calls give, at random points."""
    rng = np.random.default_rng(0)
    nx, nu, ny = plant.sizes
    t, size = rng.uniform(0, 10, points), scale * np.where(np.arange(points) % 4 == 3, 10.0, 1.0)
    X, U = size[:, None] * rng.normal(size=(points, nx)), rng.normal(size=(points, nu))
    P = plant.vector() * rng.uniform(0.9, 1.1, (points, len(plant.vector())))
    with np.errstate(all="ignore"):
        for function, single, n in ((plant.update, plant._update_at, nx), (plant.output, plant.outputs, ny)):
            if function is None:
                continue
            want = np.array([single(x, u, p, s) for s, x, u, p in zip(t, X, U, P, strict=True)]).reshape(points, n)
            good = np.all(np.isfinite(want), axis=1)
            try:
                got = called_with_arrays(function, t[good], X[good], U[good], plant.as_dict(P[good].T), n)
            except Exception:
                return False
            if good.sum() < 8 or not np.allclose(got, want[good], rtol=1e-9, atol=1e-12):
                return False
    return True


@njit(RHS_TYPE.signature, cache=True, nogil=True, error_model="numpy")
def _linear_rhs(t, x, u, p, dx):
    n, m = x.size, u.size
    for i in range(n):
        s = 0.0
        for j in range(n):
            s += p[i * n + j] * x[j]
        for j in range(m):
            s += p[n * n + i * m + j] * u[j]
        dx[i] = s


@njit(RHS_TYPE.signature, cache=True, nogil=True, error_model="numpy")
def _linear_out(t, x, u, p, y):
    n, m = x.size, u.size
    base = n * n + n * m
    for i in range(y.size):
        s = 0.0
        for j in range(n):
            s += p[base + i * n + j] * x[j]
        for j in range(m):
            s += p[base + y.size * n + i * m + j] * u[j]
        y[i] = s


def linear_behind(first: int) -> tuple[Callable, Callable]:
    """The compiled forms of a linear system whose matrix entries begin at position `first` of the parameters."""

    def rhs(t, x, u, p, dx):
        _linear_rhs(t, x, u, p[first:], dx)

    def out(t, x, u, p, y):
        _linear_out(t, x, u, p[first:], y)

    return tuple(njit(RHS_TYPE.signature, nogil=True, error_model="numpy")(f) for f in (rhs, out))


def _from_state_space(system: control.StateSpace, source: str) -> Plant:
    parts = {"A": system.A, "B": system.B, "C": system.C, "D": system.D}
    parameters = {
        f"{k}[{i},{j}]": float(M[i, j]) for k,
        M in parts.items() for i in range(M.shape[0]) for j in range(M.shape[1])
    }

    def matrices(params):
        return {k: np.array([[params[f"{k}[{i},{j}]"] for j in range(M.shape[1])]
                             for i in range(M.shape[0])]).reshape(
            M.shape) for k, M in parts.items()}

    def update(t, x, u, params):
        m = matrices(params)
        return m["A"] @ x + m["B"] @ u

    def output(t, x, u, params):
        m = matrices(params)
        return m["C"] @ x + m["D"] @ u

    return Plant(update, output, tuple(system.state_labels), tuple(system.input_labels), tuple(system.output_labels),
                 parameters, dt=_time_step(system), rhs=_linear_rhs, out=_linear_out, source=source, linear=True)


def _time_step(system) -> float:
    if system.dt in (0, None):
        return 0.0
    if system.dt is True:
        raise InputError("the simulator is discrete with an unspecified step (dt=True); give dt in seconds")
    return float(system.dt)


def _from_nonlinear(system: control.NonlinearIOSystem, source: str) -> Plant:
    parameters, constants = {}, {}
    for name, value in (system.params or {}).items():
        number = isinstance(value, int | float | np.floating | np.integer) and not isinstance(value, bool)
        (parameters if number else constants)[name] = float(value) if number else value
    if system.updfcn is None:
        raise InputError("the simulator has no update function; give control.nlsys(update, output, ...)")
    joined = isinstance(system, control.InterconnectedSystem)
    update, output = equations_of_parts(system) if joined else (system.updfcn, system.outfcn)

    def plant(whole=()):
        kept = {n: v for n, v in (system.params or {}).items() if n in constants or n in whole}
        return Plant(update, output, tuple(system.state_labels), tuple(system.input_labels),
                     tuple(system.output_labels), {n: v for n, v in parameters.items() if n not in kept}, kept,
                     dt=_time_step(system), source=source,
                     notes=tuple(f"parameter {n} of the simulator is {type(v).__name__}: kept as it is"
                                 for n, v in kept.items()))

    return whole_or_real(lambda whole: checked(plant(whole)), system.params or {})


def whole_or_real(make: Callable, values: Mapping) -> Plant:
    """`make(())`; where that fails, `make(names)` with the whole numbers among the values that it takes: they may count
    something, and are no parameters then."""
    whole = tuple(n for n, v in values.items() if isinstance(v, int | np.integer) and not isinstance(v, bool))
    try:
        return make(())
    except InputError:
        for names in (*((n,) for n in whole), whole):
            with suppress(InputError):
                return make(names)
        raise


# States, and inputs, at which a simulator may be at home: one that divides by a flow is not where none flows.
LEVELS, PUSHED = (0.1, 1.0, 0.0, 10.0, 100.0, 300.0, 1e3, 1e5), (0.0, 1.0, 0.1, 100.0)


def checked(plant: Plant) -> Plant:
    """The plant compiled, after one evaluation at states and inputs of the first magnitudes that work."""
    failures = []
    for pushed, level in itertools.product(PUSHED, LEVELS):
        with np.errstate(all="ignore"):
            failures.append(_failure(plant, level, pushed))
        if not failures[-1]:
            plant = _compile(plant, max(1.0, level))
            plant.raised.clear()  # points of these checks say nothing of the recordings
            return plant
    raise InputError(failures[0])


def _failure(plant: Plant, level: float, pushed: float) -> str:
    """What is wrong with derivatives and outputs at states and inputs of these magnitudes, or an empty text.

    Raises
    ------
    InputError
        For a result of the wrong size, which no other state mends.
    """
    nx, nu, ny = plant.sizes
    x, u, said = np.full(nx, level), np.full(nu, pushed), set(plant.raised)
    at = f"at x = {x.tolist()}, u = {u.tolist()}"
    try:
        dx = np.asarray(plant.update(0.0, x.copy(), u.copy(), plant.as_dict(plant.vector())), dtype=float).ravel()
    except Exception as error:
        return (f"the simulator raised {type(error).__name__}: {error}; expected derivatives {at}; correct the "
                "simulator or its params")
    if dx.size != nx:
        raise InputError(f"the simulator returned {dx.size} derivatives for {nx} states; return one per state")
    y = plant.outputs(x, u)
    if plant.raised - said:
        return f"the output function raised {sorted(plant.raised - said)[0]}; expected outputs {at}"
    if y.size != ny:
        raise InputError(f"the simulator returned {y.size} outputs, expected {ny}; correct its output function")
    if not (np.all(np.isfinite(dx)) and np.all(np.isfinite(y))):
        return (f"the simulator returned derivatives {dx.tolist()} and outputs {y.tolist()} {at}; expected finite "
                "numbers")
    return ""


def _compile(plant: Plant, scale: float) -> Plant:
    try:
        rhs, out, raises = compiled_pair(plant.update, plant.output, plant.sizes, plant.parameters, scale,
                                         plant.constants)
    except CompileFailure as failure:
        arrays = takes_arrays(plant, scale)
        how = ("the simulator is not compiled (" + str(failure) + "): it runs in Python, "
               + ("many simulations in one call" if arrays else "one call per state: arrays in place of scalars would "
                  "be faster"))
        return replace(plant, takes_arrays=arrays, notes=(*plant.notes, how))
    notes = ("the simulator can raise an error: a simulation that meets it counts as diverged there",) if raises else ()
    return replace(plant, rhs=rhs, out=out, notes=(*plant.notes, *notes))


def _still(t, x, u, params):
    """States of a black box are only its start: nothing is known of how they move."""
    return np.zeros_like(x)


def _from_black_box(simulate, input_names, output_names, parameters, source: str) -> Plant:
    box = BlackBox(simulate, input_names, output_names, parameters)
    values = dict(box.parameters)
    gains: tuple[tuple[int, int], ...] = ()
    if not values:
        values = {f"gain_{n}": 1.0 for n in box.inputs}
        gains = tuple((j, j) for j in range(len(box.inputs)))
    ny = len(box.outputs)

    def silent(t, x, u, params):
        return np.zeros(ny)

    places = "its inputs, its force and its outputs" if box.forces else "its inputs and outputs"
    hook = "" if box.forces else "a hook simulate(u, force=d) would let in forces, "
    notes = [f"the simulator is a black box: effects are tried at {places}. Effects that depend on a state (friction, "
             f"stiffness, outflow) cannot be told apart: {hook}the right-hand side would let in all"]
    if gains:
        notes.append("the simulator takes no params: the gain of every input is refitted in their place")
    return Plant(_still, silent, tuple(f"x0_{i}" for i in range(box.start.size)), box.inputs, box.outputs, values,
                 raised=box.raised, dt=1.0, source=source, notes=tuple(notes), black_box=box,
                 force_names=tuple(box.forces), force_units=tuple(box.forces.values()), gains=gains)


def as_plant(simulator, input_names=None, output_names=None, parameters: Mapping[str, float] | None = None,
             source: str = "") -> Plant:
    """Accept any simulator the tool can inject effects into.

    Parameters
    ----------
    simulator : control.NonlinearIOSystem, control.StateSpace, control.TransferFunction, a right-hand side
        ``f(t, x, u, params)`` whose states are its outputs, or a callable ``simulate(u) -> y`` (see
        `pwaid.mismatch.blackbox.BlackBox` for its options).
    input_names, output_names : names used for a bare right-hand side or a callable.
    parameters : defaults used for these.

    Raises
    ------
    InputError
        When the object is none of these, or does not evaluate.
    """
    if isinstance(simulator, Plant):
        return simulator
    if isinstance(simulator, control.TransferFunction):
        try:
            simulator = realise(simulator)
        except (ValueError, NotImplementedError) as error:
            raise InputError(f"the transfer function has no state space ({error}); expected numerators of no higher "
                             "degree than their denominators") from error
    if isinstance(simulator, control.StateSpace):
        return _from_state_space(simulator, source)
    if isinstance(simulator, control.NonlinearIOSystem):
        return _from_nonlinear(simulator, source)
    if isinstance(simulator, control.InputOutputSystem):
        raise InputError(f"the simulator is a {type(simulator).__name__}; expected control.nlsys, control.ss or a "
                         "transfer function: fit a model to frequency data first")
    if callable(simulator) and looks_like_black_box(simulator):
        return _from_black_box(simulator, tuple(input_names or ()), tuple(output_names or ()), parameters, source)
    if callable(simulator) and len(inspect.signature(simulator).parameters) >= 4:
        names = tuple(output_names or ())
        return checked(Plant(simulator, None, names, tuple(input_names or ()), names, dict(parameters or {}),
                              source=source))
    raise InputError(f"the simulator is a {type(simulator).__name__}; expected control.nlsys, control.ss, a transfer "
                     "function, a right-hand side f(t, x, u, params), or a callable simulate(u)")
