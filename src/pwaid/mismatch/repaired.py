"""The repaired simulator: an object for python-control, and a file that runs without pwaid.

Both advance one sample at a time with the scheme that was fitted: the effects act inside the user's
equations, memory (play, rate limits, friction at rest) is kept in extra states.
"""

from __future__ import annotations

import inspect
import textwrap

import control
import numpy as np

from pwaid.mismatch.effects import base as effect_base
from pwaid.mismatch.hypotheses import Hypothesis
from pwaid.mismatch.model import Model
from pwaid.mismatch.realise import realise

__all__ = ["header", "kernel_source", "law_rows", "repaired_source", "repaired_system", "without_future"]


def repaired_system(hypothesis: Hypothesis, sample_time: float) -> control.NonlinearIOSystem:
    """The repaired simulator as a discrete-time control.nlsys with the same inputs and outputs.

    The states are the nominal ones followed by the effects' own; `params` hold the refitted values.
    """
    space: dict = {}
    exec(compile(repaired_source(hypothesis, sample_time, None), "<repaired simulator>", "exec"), space)
    plant = hypothesis.fit.model.settings.plant
    names = list(plant.state_names) + [f"z{i}" for i in range(hypothesis.fit.model.extra)]
    update, output = space["make_repaired"](plant.update, plant.output, plant.constants)
    return control.nlsys(update, output, inputs=list(plant.input_names), outputs=list(plant.output_names),
                         states=names,
                         params={n: float(v) for n,
                                 v in zip(plant.parameters, hypothesis.fit.model.parameters(
                             hypothesis.fit.theta), strict=False)}, dt=sample_time, name="repaired")


def _literal(array) -> str:
    return repr(np.asarray(array).tolist())


def _law_name(located) -> str:
    return f"law_{located.effect.id}_{located.effect.kernel.__name__}"


def kernel_source(model: Model) -> str:
    """Text of the laws of a model and of the helpers they call."""
    helpers = [effect_base.push, effect_base.slide]
    parts = [inspect.getsource(f.py_func).split("\n", 1)[1] for f in helpers]
    done = set()
    for e in model.located:
        kernel = e.effect.kernel
        if kernel not in done:
            done.add(kernel)
            parts.append(textwrap.dedent(inspect.getsource(kernel)).replace(
                f"def {kernel.__name__}(", f"def {_law_name(e)}(", 1))
    return "\n\n".join(p.strip("\n") + "\n" for p in parts)


_SYSTEM = """numpy and control. `build()` gives a discrete-time control.nlsys with
the inputs and outputs of the nominal simulator; `simulate(t, u, x0)` runs it over a recording."""


def header(hypothesis: Hypothesis, rows, use: str = _SYSTEM) -> list[str]:
    """The opening text of repaired_simulator.py; `use` says what it needs and offers."""
    lines = ['"""The simulator with the missing physics put in, written by pwaid.', ""]
    lines += [f"    {e.effect.law}    ({e.label})" for e in hypothesis.located] or ["    no effect was named: "
                                                                                    "refitted parameters only"]
    lines += [""] + [f"    {text}" for text in rows]
    return [*lines, "", f"Runs without pwaid: needs {use}", '"""']


def law_rows(hypothesis: Hypothesis, where=lambda located: True) -> list[str]:
    """One line of text for every law: function, integers, parameters, dry friction?, start of memory, delay."""
    model = hypothesis.fit.model
    rows = []
    for k, (e, values) in enumerate(zip(model.located, model.parts(hypothesis.fit.theta), strict=True)):
        if where(e):
            q = np.concatenate([values, e.place.constants])
            rows.append(f"    ({_law_name(e)}, {model.II[k].tolist()}, np.array({_literal(q)}), "
                        f"{bool(e.effect.proximal)}, {e.effect.start!r}, "
                        f"{float(values[0]) if e.effect.delays else 0.0!r}),")
    return rows


def repaired_source(hypothesis: Hypothesis, sample_time: float, simulator_source: str | None, rows=()) -> str:
    """Text of repaired_simulator.py.

    Parameters
    ----------
    simulator_source : text of the user's simulator with its build(); None leaves it out.
    rows : lines for the header: parameters with units and intervals.
    """
    model = hypothesis.fit.model
    s = model.settings
    lines = header(hypothesis, rows) if simulator_source is not None else []
    lines += ["from math import cos, exp, floor, sin, sqrt", "", "import control", "import numpy as np", ""]
    if simulator_source is not None:
        lines += ["# --- the nominal simulator, unchanged ---", without_future(simulator_source).rstrip(), "",
                  "nominal_build = build", ""]
    refitted = {n: float(v) for n,
                v in zip(s.plant.parameters, model.parameters(hypothesis.fit.theta), strict=False)}
    lines += ["", "# --- the missing physics ---", kernel_source(model), "",
              f"SAMPLE_TIME = {sample_time!r}", f"SUBSTEPS = {1 if s.plant.dt else model.substeps}",
              f"DISCRETE = {bool(s.plant.dt)}", f"EXTRA_STATES = {model.extra}",
              f"FITTED_PARAMETERS = {refitted!r}", f"SPEED_OF = {s.partner.tolist()}",
              f"SPEED_RATIO = {s.ratio.tolist()}",
              "MISSING_PHYSICS = [  # law, where it acts, parameters, dry friction?, start of its memory, delay (s)",
              *law_rows(hypothesis),
              "]", _LOOP]
    if simulator_source is not None:
        lines += ["", inspect.getsource(realise).rstrip(), _BUILD]
    return "\n".join(lines) + "\n"


def without_future(text: str) -> str:
    """A module's text without its __future__ imports, which only stand at the top of a file."""
    return "\n".join(line for line in text.splitlines() if not line.startswith("from __future__"))


_LOOP = '''

def make_repaired(nominal_update, nominal_output, constants=None):
    """Update and output functions of the repaired simulator around those of the nominal one.

    constants: what the nominal params hold besides numbers.
    """
    names = list(FITTED_PARAMETERS)

    def mapping(p):
        return {**(constants or {}), **dict(zip(names, p))}

    n = len(SPEED_OF)
    delay_steps = [int(np.ceil(e[5] / SAMPLE_TIME)) + 1 if e[5] > 0 else 0 for e in MISSING_PHYSICS]
    h = SAMPLE_TIME / SUBSTEPS

    def vector(params):
        return np.array([params.get(k, FITTED_PARAMETERS[k]) for k in names]) if names else np.zeros(1)

    def nominal(t, x, u, p):
        return np.asarray(nominal_update(t, x, u, mapping(p)), dtype=float).ravel()

    def every(phase, t, step, x, xs, u, p, dx):  # all laws in one phase
        for law, ii, q, *_ in MISSING_PHYSICS:
            law(phase, t, step, x, xs, u, p, dx, ii, q)

    def rates(t, h, x, u, p, columns):
        xs, us, ps, dx = x.copy(), u.copy(), p.copy(), np.zeros(x.size)
        every(1, t, h, x, xs, us, ps, dx)
        dx[:n] = nominal(t, xs[:n], us, ps)
        every(2, t, h, x, xs, us, ps, dx)
        for (law, ii, q, *_), column in columns:
            law(5, t, h, x, column, us, ps, dx, ii, q)
        return dx

    def mobility(t, x, u, p, ii):
        column = np.zeros(x.size)
        if ii[1] == 0:
            more = u.copy()
            more[ii[2]] += 1.0
            column[:n] = nominal(t, x[:n], more, p) - nominal(t, x[:n], u, p)
        else:
            column[ii[2]] = 1.0 / p[ii[3]] if ii[3] >= 0 else 1.0
        return column

    dry_laws = [e for e in MISSING_PHYSICS if e[3]]

    def event(a, b):
        """A reversal, a stop or a release of something with dry friction."""
        pairs = [(a[e[1][4]], b[e[1][4]]) for e in dry_laws]
        return any(v * w <= 0.0 and (v != 0.0 or w != 0.0) for v, w in pairs)

    def substep(t, x, u, p):
        """One substep, repeated in eight pieces when dry friction meets an event inside it."""
        if DISCRETE or not dry_laws:
            return advance(t, h, x.copy(), u, p, False)
        end = advance(t, h, x.copy(), u, p, all(x[e[1][4]] != 0.0 for e in dry_laws))
        if not event(x, end):
            return end
        for piece in range(8):
            sliding = all(x[e[1][4]] != 0.0 for e in dry_laws)
            end = advance(t + piece * h / 8, h / 8, x.copy(), u, p, sliding)
            if sliding and event(x, end):
                end = advance(t + piece * h / 8, h / 8, x.copy(), u, p, False)
            x = end
        return x

    def advance(t, h, x, u, p, sliding):
        columns = [(e, mobility(t, x, u, p, e[1])) for e in dry_laws]
        every(0, t, h, x, x.copy(), u, p, np.zeros(x.size))
        before = x.copy()
        resist = columns if sliding else []
        k1 = rates(t, h, x, u, p, resist)
        if DISCRETE:
            x = np.concatenate([k1[:n], x[n:] + SAMPLE_TIME * k1[n:]])
        else:
            k2 = rates(t + h / 2, h, x + h / 2 * k1, u, p, resist)
            k3 = rates(t + h / 2, h, x + h / 2 * k2, u, p, resist)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rates(t + h, h, x + h * k3, u, p, resist))
        if not sliding:
            free = x.copy()
            for (law, ii, q, *_), column in columns:
                law(4, t, h, x, before, u, p, column.copy(), ii, q)
            for i in range(n):
                if SPEED_OF[i] >= 0 and not DISCRETE:
                    j = SPEED_OF[i]
                    rest = before[j] == 0.0 and x[j] == 0.0
                    x[i] = before[i] if rest else x[i] + 0.5 * h * SPEED_RATIO[i] * (x[j] - free[j])
        return x

    def update(t, x, u, params):
        x, u, p = np.array(x, dtype=float), np.atleast_1d(np.array(u, dtype=float)), vector(params)
        for s in range(SUBSTEPS):
            x = substep(t + s * h, x, delayed(t + s * h, u), p)
        remember(t, u)
        return x

    def output(t, x, u, params):
        x, u, p = np.array(x, dtype=float), np.atleast_1d(np.array(u, dtype=float)), vector(params)
        xs, us = x.copy(), u.copy()
        every(1, t, 0.0, x, xs, us, p, np.zeros(x.size))
        if nominal_output is None:
            y = xs[:n].copy()
        else:
            y = np.asarray(nominal_output(t, xs[:n], us, mapping(p)), dtype=float).ravel().copy()
        every(3, t, SAMPLE_TIME, x, xs, us, p, y)
        return y

    history = {}

    def remember(t, u):
        if any(delay_steps):
            history[round(t / SAMPLE_TIME)] = u.copy()

    def delayed(t, u):
        """The command each delayed channel sees: the mean over the substep of the held past command."""
        u = u.copy()
        now = u.copy()
        for (law, ii, q, dry, start, delay), steps in zip(MISSING_PHYSICS, delay_steps):
            if steps:
                a = (t - delay) / SAMPLE_TIME
                b = a + 1.0 / SUBSTEPS
                ia, ib = int(np.floor(a + 1e-9)), int(np.floor(b - 1e-9))
                past = lambda i: history.get(i, history.get(0, now) if i < 0 else now)[ii[8]]
                w = 1.0 if ia == ib else (ib - a) / (b - a)
                u[ii[8]] = w * past(ia) + (1 - w) * past(ib)
        return u

    return update, output
'''

_BUILD = '''

def build():
    """The repaired simulator as a discrete-time control.nlsys."""
    system = nominal_build()
    if isinstance(system, control.TransferFunction):
        system = realise(system)
    if isinstance(system, control.StateSpace):
        A, B, C, D = (np.array(M) for M in (system.A, system.B, system.C, system.D))

        def matrices(p):
            return [np.array([[p[f"{k}[{i},{j}]"] for j in range(M.shape[1])] for i in range(M.shape[0])])
                    for k, M in zip("ABCD", (A, B, C, D))]

        def nominal_update(t, x, u, p):
            A, B, _, _ = matrices(p)
            return A @ x + B @ u

        def nominal_output(t, x, u, p):
            _, _, C, D = matrices(p)
            return C @ x + D @ u
    else:
        nominal_update, nominal_output = system.updfcn, system.outfcn
    constants = {k: v for k, v in (system.params or {}).items() if k not in FITTED_PARAMETERS}
    update, output = make_repaired(nominal_update, nominal_output, constants)
    states = list(system.state_labels) + [f"z{i}" for i in range(EXTRA_STATES)]
    return control.nlsys(update, output, inputs=list(system.input_labels), outputs=list(system.output_labels),
                         states=states, params=dict(FITTED_PARAMETERS), dt=SAMPLE_TIME, name="repaired")


def simulate(t, u, x0):
    """Outputs (N, ny) over a recording: u (N, nu) held between samples, x0 the nominal states' start."""
    system = build()
    u = np.asarray(u, dtype=float).reshape(len(t), -1)
    x = np.concatenate([np.asarray(x0, dtype=float), np.zeros(EXTRA_STATES)])
    for law, ii, q, dry, start, delay in MISSING_PHYSICS:
        if start == "input":
            x[ii[0]:] = u[0, ii[8]]
        elif start == "stored":
            x[ii[0]] = x[ii[4]]
    y = []
    for k in range(len(t)):
        y.append(system.outfcn(k * SAMPLE_TIME, x, u[k], dict(FITTED_PARAMETERS)))
        x = system.updfcn(k * SAMPLE_TIME, x, u[k], dict(FITTED_PARAMETERS))
    return np.array(y)
'''
