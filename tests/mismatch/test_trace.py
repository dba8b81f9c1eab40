"""Right-hand sides as engineers write them: compiled by running them on symbols, the same numbers as the originals."""

from __future__ import annotations

import functools
import inspect
import math
from math import sin

import control
import numpy as np
import numpy.linalg as la
import pytest
from scipy.linalg import expm, solve

from pwaid.mismatch.built import with_arguments
from pwaid.mismatch.compile_rhs import CompileFailure, compiled_pair
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.model import Model, Settings
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.symbolic import Tape, TraceFailure
from pwaid.mismatch.trace import MOST_PATHS, traced
from pwaid.mismatch.traced_scopes import replaced

DEFAULTS = {"m": 2.0, "b": 0.3, "k": 5.0}
PLACE, FORCE = np.array([-1.0, 0.0, 0.5, 2.0]), np.array([-2.0, 0.0, 0.3, 4.0])


def merged(t, x, u, params):
    p = {**DEFAULTS, **params}
    return np.concatenate([x[1:], (u - p["b"] * x[1:] - p["k"] * x[:1]) / p["m"]])


def from_a_generator(t, x, u, params):
    m, b, k = (params.get(n, DEFAULTS[n]) for n in ("m", "b", "k"))
    A = np.array([[0.0, 1.0], [-k / m, -b / m]])
    return A @ np.asarray(x) + np.array([[0.0], [1 / m]]) @ np.atleast_1d(u)


def filled_in(t, x, u, params):
    p = dict(DEFAULTS)
    p.update(params)
    dx = np.zeros(2, dtype=float)
    dx[0] = x[1]
    dx[1] = (float(u[0]) - p["b"] * x[1] * abs(x[1]) - p["k"] * x[0] ** 3) / p["m"]
    return dx


def with_conditions(t, x, u, params):
    force = params["k"] * max(x[0] - 0.2, 0.0) if x[0] > 0 else params["k"] * np.clip(x[0], -0.5, 0.0)
    if x[1] > 0.1 and u[0] < 0:
        force += params["b"] * math.sqrt(x[1])
    elif not (-0.3 <= x[1] <= 0.1):
        force -= params["b"]
    return [x[1], (u[0] - force) / params["m"]]


def with_where(t, x, u, params):
    dry = np.where(np.abs(x) > 0.4, np.sign(x), x / 0.4) * (x[1] > -1.0)
    return np.array([x[1], u[0] - params["b"] * dry[1] - np.interp(x[0], PLACE, FORCE) + np.hypot(x[0], 1.0)])


def mass_matrix(q):
    return np.array([[3.0 + np.cos(q[1]), 0.2], [0.2, 1.0 + np.sin(q[0]) ** 2]])


def solved(t, x, u, params):
    acceleration = la.solve(mass_matrix(x), np.array([u[0] - params["b"] * x[0], -params["k"] * sin(x[1])]))
    return acceleration + np.linalg.inv(mass_matrix(x))[0] * np.linalg.det(mass_matrix(x))


def summed_exactly(t, x, u, params):
    loss = math.fsum([params["k"] * x[0], -x[1], *x])
    return [math.fsum((u[0], -loss)), math.prod([x[0], 2.0, params["b"]]) + math.dist([x[0], x[1]], (0.0, 1.0))]


def indexed(t, x, u, params):
    return np.sum(x) * x[[1, 0]] - params["b"] * np.linalg.norm(x) + t


def loop(t, x, u, params):
    y = 0.0
    for _ in range(5):
        y = y + params["b"] * np.tanh(x[0] + y)
    return np.array([y, x.dot(x)])


class Machine:
    """A simulator with methods."""

    gain = 1.5

    def __init__(self, **values):
        self.values = {**DEFAULTS, **values}

    def spring(self, q, p):
        return p["k"] * sin(q)

    def update(self, t, x, u, params):
        p = {**self.values, **(params or {})}
        return [x[1], (self.gain * u[0] - self.spring(x[0], p)) / p["m"]]

    @classmethod
    def rhs(cls, t, x, u, params):
        return np.array([x[1], cls.gain * u[0] - params["k"] * x[0]])

    def __call__(self, t, x, u, params):
        return self.update(t, x, u, params)


def scaled(t, x, u, params, factor):
    return factor * np.array(merged(t, x, u, params))


WRITTEN = {f.__name__: f for f in (merged, from_a_generator, filled_in, with_conditions, with_where, solved, indexed,
                                   summed_exactly, loop)} | {
    "a lambda": lambda t, x, u, params: [x[1], u[0] / params["m"]], "a method": Machine().update,
    "a class method": Machine.rhs, "an object": Machine(m=3.0), "a partial": functools.partial(scaled, factor=2.0)}


@pytest.mark.parametrize("how", WRITTEN)
def test_what_is_traced_computes_what_the_original_computes(how):
    function, rng = WRITTEN[how], np.random.default_rng(1)
    plain, raises = traced(function, 2, 2, 1, {n: i for i, n in enumerate(DEFAULTS)}, {})
    rhs, *_ = compiled_pair(function, None, (2, 1, 2), DEFAULTS)
    assert not raises
    for _ in range(200):
        t, x, u, p = rng.uniform(0, 9), rng.normal(size=2), rng.normal(size=1), rng.uniform(0.5, 2.0, 3)
        want = np.asarray(function(t, x, u, dict(zip(DEFAULTS, p, strict=True))), dtype=float).ravel()
        for computed in (plain, rhs):
            got = np.empty(2)
            computed(t, x, u, p, got)
            np.testing.assert_allclose(got, want, rtol=1e-11, atol=1e-13)


def test_the_modules_are_as_they_were_afterwards():
    before = dict(globals())
    with replaced(with_conditions):
        assert globals()["math"] is not math or globals()["np"] is not before["np"]
    assert globals().keys() == before.keys() and all(globals()[k] is v for k, v in before.items())

    def broken(t, x, u, params):
        return np.zeros(3) + int(x[0])

    with pytest.raises(TraceFailure):
        traced(broken, 2, 2, 1, {}, {})
    assert globals().keys() == before.keys() and all(globals()[k] is v for k, v in before.items())


def test_closures_and_imports_inside_build():
    def build():
        import numpy as n

        gain = 4.0

        def inner(t, x, u, params):
            return n.array([gain * n.exp(-x[0]), u[0] * params["b"]])

        return inner

    function = build()
    plain, _ = traced(function, 2, 2, 1, {"b": 0}, {})
    got, x, u = np.empty(2), np.array([0.3, 1.0]), np.array([2.0])
    plain(0.0, x, u, np.array([0.5]), got)
    np.testing.assert_allclose(got, function(0.0, x, u, {"b": 0.5}), rtol=1e-14)
    assert function.__closure__[1].cell_contents is np


def test_where_the_original_raises_there_is_nan():
    def guarded(t, x, u, params):
        if x[0] < 0:
            raise ValueError("the level is negative")
        return [np.sqrt(x[0])]

    rhs, _, raises = compiled_pair(guarded, None, (1, 1, 1), {"a": 1.0})
    got = np.empty(1)
    rhs(0.0, np.array([-1.0]), np.zeros(1), np.ones(1), got)
    assert raises and np.isnan(got[0])
    rhs(0.0, np.array([4.0]), np.zeros(1), np.ones(1), got)
    assert got[0] == 2.0


def test_an_error_that_is_no_raise_statement_is_no_branch():
    def strange(t, x, u, params):
        return ["a" + x[0]]

    with pytest.raises(TraceFailure, match="TypeError"):
        traced(strange, 1, 1, 1, {}, {})


def test_memory_between_calls_is_not_compiled():
    calls = []

    def counting(t, x, u, params):
        calls.append(1)
        return [x[0] + len(calls)]

    with pytest.raises(CompileFailure):
        compiled_pair(counting, None, (1, 1, 1), {"a": 1.0})


def test_too_many_ways_through_are_refused():
    def many(t, x, u, params):
        return [sum(1.0 if v > k else 2.0 for k, v in enumerate(x))]

    n = int(np.log2(MOST_PATHS)) + 1
    with pytest.raises(TraceFailure, match="ways through"):
        traced(many, 1, n, 1, {}, {})


def test_one_operation_is_written_once_and_zeros_are_left_out():
    tape = Tape()
    a, b = tape.symbol("input", "x[0]"), tape.symbol("input", "x[1]")
    assert (a * b + 0.0).node == (a * b).node and (1.0 * a).node == a.node and 0.0 * a == 0.0


def test_parameters_of_a_linear_system_are_the_arguments_of_build():
    def build(m=2.0, b=0.4, k=8.0):
        return control.ss([[0, 1], [-k / m, -b / m]], [[0], [1 / m]], [[1, 0]], 0, inputs=["F"], outputs=["x"])

    plant = as_plant(build())
    assert "A[1,0]" in plant.parameters and with_arguments(plant, build, ["A[1,0]"]) is plant
    built = with_arguments(plant, build, ["m"])
    assert dict(built.parameters) == {"m": 2.0, "b": 0.4, "k": 8.0} and built.rhs is not None
    p, x, u = np.array([3.0, 0.5, 7.0]), np.array([0.3, -0.2]), np.array([1.2])
    system = build(*p)
    np.testing.assert_allclose(built.derivative(x, u, p), system.A @ x + system.B @ u, rtol=1e-14)
    np.testing.assert_allclose(built.outputs(x, u, p), system.C @ x, rtol=1e-14)


def test_what_build_cannot_be_traced_through_is_built_again():
    def build(k=2.0, T=0.5):
        return control.tf([k], [T, 1.0], inputs=["u"], outputs=["y"])

    built = with_arguments(as_plant(build()), build, None)
    assert dict(built.parameters) == {"k": 2.0, "T": 0.5} and built.rhs is not None
    x = np.array([0.7])
    assert built.outputs(x, np.zeros(1), np.array([4.0, 0.5]))[0] == pytest.approx(
        2 * built.outputs(x, np.zeros(1), np.array([2.0, 0.5]))[0])


def test_interconnected_systems_take_the_arguments_of_build():
    def build(J=0.3, b=0.1, gain=2.0):
        motor = control.nlsys(lambda t, x, u, p: [(u[0] - b * x[0]) / J], lambda t, x, u, p: [x[0]], inputs=["M"],
                              outputs=["w"], states=["w"], name="motor")
        loop = control.nlsys(None, lambda t, x, u, p: [gain * (u[0] - u[1])], inputs=["r", "w"], outputs=["M"],
                             name="loop")
        return control.interconnect([motor, loop], inputs=["r"], outputs=["w"])

    built = with_arguments(as_plant(build()), build, ["J", "b"])
    assert dict(built.parameters) == {"J": 0.3, "b": 0.1, "gain": 2.0} and built.rhs is not None
    p, x, u = np.array([0.5, 0.2, 3.0]), np.array([0.7]), np.array([1.1])
    np.testing.assert_allclose(built.derivative(x, u, p), (3.0 * (1.1 - 0.7) - 0.2 * 0.7) / 0.5, rtol=1e-12)
    np.testing.assert_allclose(built.derivative(x, u), (2.0 * (1.1 - 0.7) - 0.1 * 0.7) / 0.3, rtol=1e-12)


def test_a_function_that_calls_itself_is_left_alone():
    def power(v, n):
        return 1.0 if n == 0 else v * power(v, n - 1)

    def recursive(t, x, u, params):
        return [float(str(power(x[0], 3)))]

    with pytest.raises(CompileFailure, match="calls itself"):
        compiled_pair(recursive, None, (1, 1, 1), {"a": 1.0})


def test_polynomials_of_a_transfer_function_come_through():
    """A right-hand side may make its matrices of control.tf, and keep them by the parameters they were made of."""
    kept = {}

    def update(t, x, u, params):
        key = params["zeta"], params["k"]
        if key not in kept:
            roll = control.tf([key[1]], [1.0, 2.0 * key[0] * 0.6, 0.36])
            num, den = (np.ravel(c[0][0]) for c in (roll.num, roll.den))
            kept[key] = np.array([[0.0, 1.0], [-den[2], -den[1]]]), np.array([0.0, num[-1]])
        A, b = kept[key]
        return A @ x + b * u[0]

    plant = as_plant(control.nlsys(update, None, inputs=["u"], outputs=["phi", "rate"], states=["phi", "rate"],
                                   params={"zeta": 0.05, "k": 0.06}))
    assert plant.rhs is not None
    x, u = np.array([0.2, -0.1]), np.array([0.5])
    expected = [-0.1, 0.08 * 0.5 + 0.12 * 0.1 - 0.36 * 0.2]
    np.testing.assert_allclose(plant.derivative(x, u, np.array([0.1, 0.08])), expected, rtol=1e-12)


def wrapped(t, x, u, params):
    """An angle brought into one turn by loops that wait for it."""
    angle = x[0]
    while angle > math.pi:
        angle -= 2 * math.pi
    while angle < -math.pi:
        angle += 2 * math.pi
    return np.array([x[1], u[0] - params["k"] * angle])


def clipped_in_place(t, x, u, params):
    force = np.array([u[0] * 1.0])
    np.clip(force, -10.0, 10.0, out=force)
    return np.array([x[1], params["k"] * force[0]])


def written_over(t, x, u, params):
    u *= params["k"]
    return np.array([x[1], u[0]])


def scaled_in_place(t, x, u, params):
    v = np.array([x[1], 1.0])
    np.multiply(v, params["k"], v)
    return np.array([v[0], u[0] * v[1]])


def with_handler(t, x, u, params):
    position, v = x.tolist()
    try:
        sign = v / abs(v)
    except ZeroDivisionError:
        sign = 0.0
    return np.array([v, u[0] + 1.0 - sign * params["k"]])


def guarded(t, x, u, params):
    with np.errstate(all="ignore"):
        return np.array([x[1], u[0] - params["k"] * x[0]])


def on_a_table(t, x, u, params):
    return np.array([x[1], params["k"] * np.interp(x[0], [-1.0, 0.0, 1.0, 1.0], [2.0, 0.0, 1.0, 3.0]) + x[0] // 0.1])


def selected(t, x, u, params):
    force = np.select([x[0] < 0.0, x[0] > 1.0], [u[0], 2.0 * u[0]], params["k"])
    return np.array([x[1], force])


class Keeping:
    """Keeps what belongs to the parameters it was called with last."""

    def __init__(self):
        self.last, self.gain, self.seen = None, 0.0, []

    def __call__(self, t, x, u, params):
        if self.last != params["k"]:
            self.last, self.gain = params["k"], 1.0 / params["k"]
        self.seen.append(x[0])
        return np.array([x[1], u[0] * self.gain])


@pytest.mark.parametrize("rhs, compiles", [
    (wrapped, True), (clipped_in_place, True), (written_over, True), (scaled_in_place, None), (with_handler, False),
    (guarded, True), (on_a_table, True), (selected, True), (Keeping(), True)])
def test_special_points_are_those_of_the_original(rhs, compiles):
    """Limits, rest, table ends and whole turns, which random points do not meet."""
    plant = as_plant(control.nlsys(rhs, lambda t, x, u, params: x[:1], inputs=["u"], outputs=["y"], states=["a", "b"],
                                   params={"k": 3.0}))
    assert compiles is None or (plant.rhs is not None) == compiles
    for x, u in (([0.0, 0.0], [0.0]), ([4.0, 1.0], [100.0]), ([-9.0, -3.0], [-20.0]), ([1.0, 0.0], [5.0]),
                 ([14.5, 0.0], [0.0])):
        want = np.asarray(rhs(0.0, np.array(x), np.array(u), {"k": 3.0}))
        np.testing.assert_allclose(plant.derivative(x, u), want, rtol=1e-12)


def test_a_loop_that_never_ends_is_a_divergence():
    plant = as_plant(control.nlsys(wrapped, lambda t, x, u, params: x[:1], inputs=["u"], outputs=["y"],
                                   states=["a", "b"], params={"k": 3.0}))
    assert np.all(np.isnan(plant.derivative([1e20, 0.0], [0.0])))


def test_what_a_run_on_symbols_left_behind_is_gone():
    rhs = Keeping()
    as_plant(control.nlsys(rhs, lambda t, x, u, params: x[:1], inputs=["u"], outputs=["y"], states=["a", "b"],
                           params={"k": 3.0}))
    assert isinstance(rhs.gain, float) and all(isinstance(v, float) for v in rhs.seen)


def _interconnected(L1=2.4e-3, R1=0.62):
    coil = control.ss([[-R1 / L1]], [[1 / L1, -1 / L1]], [[1.0]], [[0.0, 0.0]], inputs=["v_inv", "v_cap"],
                      outputs=["i_inv"], name="coil")
    capacitor = control.ss([[-500.0]], [[3e4]], [[1.0]], 0, inputs=["i_inv"], outputs=["v_cap"], name="capacitor")
    return control.interconnect([coil, capacitor], inputs=["v_inv"], outputs=["v_cap"])


def _discretised(kg=11.0, kw=0.9):
    A, B = np.array([[-1 / 900.0, 0.0], [1 / 4500.0, -kw / 4500.0]]), np.array([[kg / 900.0], [0.0]])
    M = expm(np.block([[A, B], [np.zeros((1, 3))]]) * 60.0)
    return control.ss(M[:2, :2], M[:2, 2:], [[0.0, 1.0]], 0, 60.0, inputs=["gate"], outputs=["level"])


def _sampled(C1=350.0, R1=0.008):
    return control.sample_system(control.ss([[-1 / (R1 * C1)]], [[1 / C1]], [[1.0]], [[R1]], inputs=["i"],
                                            outputs=["v"]), 0.2)


def _named_later(J=2.4e-4, b=6e-5):
    system = control.StateSpace([[-b / J]], [[1 / J]], [[1.0]], [[0.0]])
    system.set_inputs(["torque"])
    system.set_outputs(["speed"])
    return system


@pytest.mark.parametrize("build", [_interconnected, _discretised, _sampled, _named_later])
def test_a_linear_build_that_symbols_do_not_get_through_follows_its_arguments(build):
    system = build()
    plant = with_arguments(as_plant(system), build, list(inspect.signature(build).parameters))
    assert plant.rhs is not None and plant.linear and set(plant.parameters) == set(inspect.signature(build).parameters)
    assert plant.entries is not None  # an exponential, say, is taken once for every set of values, not in every step
    rng = np.random.default_rng(0)
    for factor in (1.0, 1.3):
        values = {n: factor * v for n, v in plant.parameters.items()}
        other, p = build(**values), np.array(list(values.values()))
        x, u = rng.normal(size=other.nstates), rng.normal(size=other.ninputs)
        moved = other.A @ x + other.B @ u
        moved = (moved - x) / plant.dt if plant.dt else moved
        np.testing.assert_allclose(plant.derivative(x, u, p), moved, rtol=1e-10)
        np.testing.assert_allclose(plant.outputs(x, u, p), other.C @ x + other.D @ u, rtol=1e-12)
    settings = Settings(plant, np.full(other.nstates, -1), np.zeros(other.nstates), tuple(plant.parameters),
                        np.full(len(p), 0.3))
    data = Dataset(("r",), rng.normal(size=(50, 1)), np.zeros((50, 1)), np.array([[0, 50, 0, 50]]), plant.dt or 1e-4)
    model, start = Model(settings), np.zeros((1, other.nstates))
    Y = model.simulate(np.log([1.3, 1.3]), start, data)[0]
    np.testing.assert_allclose(Y, model.simulate_many([(np.log([1.3, 1.3]), start)], data)[0])
    if plant.dt:
        x = np.zeros(other.nstates)
        for k in range(50):
            np.testing.assert_allclose(Y[k], other.C @ x + other.D @ data.U[k], rtol=1e-9, atol=1e-12)
            x = other.A @ x + other.B @ data.U[k]


def test_a_simulator_that_samples_its_own_matrices_compiles():
    def update(t, x, u, params):
        whole = np.zeros((3, 3))
        whole[:2, :2] = [[-params["a"], params["a"]], [40.0 * params["a"], -params["b"]]]
        whole[1, 2] = 1.0
        step = expm(whole * 0.5)
        return step[:2, :2] @ x + step[:2, 2] * u[0]

    names = {"a": 0, "b": 1}
    compiled, raises = traced(update, 2, 2, 1, names, {})
    assert not raises
    for p in ([0.3, 4.0], [1e-9, 1e-9], [-2.0, 30.0]):
        x, u, found = np.array([0.7, -1.2]), np.array([0.4]), np.empty(2)
        compiled(0.0, x, u, np.array(p), found)
        np.testing.assert_allclose(found, update(0.0, x, u, dict(zip(names, p, strict=True))), rtol=1e-11)
    compiled(0.0, x, u, np.array([np.nan, 1.0]), found)
    assert np.all(np.isnan(found))


def test_what_scipy_solves_with_options_stays_with_scipy_and_symbols_are_eliminated():
    def update(t, x, u, params):
        fixed = solve(2.0 * np.eye(2), np.array([4.0, 6.0]), assume_a="pos")
        mass = np.array([[params["m"], 0.5], [0.5, 2.0]])
        return solve(mass, np.array([u[0] - x[0], fixed[1] * x[1]]))

    compiled, _ = traced(update, 2, 2, 1, {"m": 0}, {})
    x, u, found = np.array([0.3, -0.8]), np.array([1.5]), np.empty(2)
    compiled(0.0, x, u, np.array([3.0]), found)
    np.testing.assert_allclose(found, update(0.0, x, u, {"m": 3.0}), rtol=1e-12)
