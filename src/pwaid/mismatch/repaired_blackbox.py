"""The repaired simulator of a black box: a callable around the user's own, and its file."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable

import numpy as np

from pwaid.mismatch.hypotheses import Hypothesis
from pwaid.mismatch.lawnames import module_text
from pwaid.mismatch.model import Model
from pwaid.mismatch.repaired import without_future

__all__ = ["black_box_source", "repaired_black_box"]


def repaired_black_box(hypothesis: Hypothesis, sample_time: float) -> Callable:
    """``simulate(u, force=None, params=None, x0=None, lead=None) -> y`` with the missing physics around it."""
    space: dict = {}
    exec(compile(black_box_source(hypothesis, sample_time, None), "<repaired simulator>", "exec"), space)
    return space["make_repaired"](hypothesis.fit.model.settings.plant.black_box.simulate)


def _header(hypothesis: Hypothesis, rows) -> list[str]:
    lines = ['"""The simulator with the missing physics put in, written by pwaid.', ""]
    lines += [f"    {e.effect.law}    ({e.label})" for e in hypothesis.located] or ["    no law was added: "
                                                                                    "refitted parameters only"]
    return [*lines, "", *[f"    {text}" for text in rows], "",
            "Runs without pwaid: needs numpy. `simulate(u)` takes the inputs and gives the outputs of the nominal one.",
            '"""']


def _law_name(located) -> str:
    return f"law_{located.effect.id}_{located.effect.kernel.__name__}"


def _kernel_source(model: Model) -> str:
    """Text of the laws of a model and of what they take from their modules."""
    sources = {e.effect.kernel: textwrap.dedent(inspect.getsource(e.effect.kernel)) for e in model.located}
    laws = {_law_name(e): sources[e.effect.kernel].replace(
        f"def {e.effect.kernel.__name__}(", f"def {_law_name(e)}(", 1) for e in model.located}
    needed = module_text({kernel: (text,) for kernel, text in sources.items()})
    return "\n\n".join(p.strip("\n") + "\n" for p in (needed, *laws.values()) if p)


def _law_rows(hypothesis: Hypothesis, where=lambda located: True) -> list[str]:
    """One line of text for every law: function, integers, parameters, dry friction?, start of memory, delay."""
    model = hypothesis.fit.model
    rows = []
    parts = model.parts(hypothesis.fit.theta)
    for k, (e, values) in enumerate(zip(model.acting, [parts[i] for i in model.order], strict=True)):
        if where(e):
            q = np.concatenate([values, e.place.constants])
            rows.append(f"    ({_law_name(e)}, {model.II[k].tolist()}, np.array({q.tolist()!r}), "
                        f"{bool(e.effect.proximal)}, {e.effect.start!r}, "
                        f"{float(values[0]) if e.effect.delays else 0.0!r}),")
    return rows


def black_box_source(hypothesis: Hypothesis, sample_time: float, simulator_source: str | None, rows=()) -> str:
    """Text of repaired_simulator.py around the user's ``simulate``.

    Parameters
    ----------
    simulator_source : text of the user's simulator with its build(); None leaves it out.
    rows : lines for the header: parameters with units and intervals.
    """
    model = hypothesis.fit.model
    plant, box = model.settings.plant, model.settings.plant.black_box
    values = model.parameters(hypothesis.fit.theta)
    fitted = {n: float(v) for n, v in zip(plant.parameters, values, strict=False)}
    lines = []
    if simulator_source is not None:
        lines += _header(hypothesis, rows)
    lines += ["import numpy as np", ""]
    if simulator_source is not None:
        lines += ["# --- the nominal simulator, unchanged ---", without_future(simulator_source).rstrip(), "",
                  "nominal_build = build", ""]
    before, behind = (_law_rows(hypothesis, lambda e, side=side: (e.place.kind == "output") == side)
                      for side in (False, True))
    lines += ["", "# --- the missing physics ---", _kernel_source(model), "",
              f"SAMPLE_TIME = {sample_time!r}", f"EXTRA_STATES = {model.nx + model.extra}",
              f"FITTED_PARAMETERS = {fitted!r}",
              f"GAINS = {[list(g) for g in plant.gains]}  # input, position of its gain among the parameters",
              f"OPTIONS = {list(box.takes)}  # what the nominal simulate takes besides u",
              f"FORCES = {len(box.forces)}", f"START = {box.start.tolist()}",
              "# law, where it acts, parameters, dry friction?, start of its memory, delay (s)",
              "AT_THE_COMMAND = [", *before, "]", "AT_THE_SENSOR = [", *behind, "]", _LOOP]
    if simulator_source is not None:
        lines += [_BUILD]
    return "\n".join(lines) + "\n"


_LOOP = '''

def past(U, k, delay):
    """The held command of `delay` seconds ago, its mean over sample k."""
    a = k - delay / SAMPLE_TIME
    ia, ib = int(np.floor(a + 1e-9)), int(np.floor(a + 1.0 - 1e-9))
    va, vb = U[min(max(ia, 0), len(U) - 1)], U[min(max(ib, 0), len(U) - 1)]
    w = 1.0 if ia == ib else ib - a
    return w * va + (1.0 - w) * vb


def make_repaired(nominal_simulate):
    """The repaired simulate around the nominal one."""

    def simulate(u, force=None, params=None, x0=None, lead=None):
        """Outputs (N, ny) for inputs u (N, nu), at the sampling of the recordings.

        force, params, x0: as the nominal simulator takes them; the fitted parameters and its own start when None.
        lead: (n, nu) inputs in front of the recording that bring the simulator to its start.
        """
        u = np.asarray(u, dtype=float)
        u = u[:, None] if u.ndim == 1 else u
        nu, x = u.shape[1], np.zeros(EXTRA_STATES)
        values = {**FITTED_PARAMETERS, **(params or {})}
        P = np.repeat(np.array(list(values.values()))[None], len(u), axis=0)
        U = np.zeros((len(u), nu + FORCES))
        U[:, :nu] = u
        if force is not None:
            U[:, nu:] = np.reshape(force, (len(u), -1))
        for law, ii, q, dry, start, delay in AT_THE_COMMAND:
            if start == "input":
                x[ii[0]:] = U[0, ii[8]]
            V = U.copy()
            for k in range(len(U)):
                if delay:
                    V[k, ii[8]] = past(U[:, ii[8]], k, delay)
                command = V[k].copy()
                law(0, k * SAMPLE_TIME, SAMPLE_TIME, x, x.copy(), command, P[k], np.zeros(EXTRA_STATES), ii, q)
                law(1, k * SAMPLE_TIME, SAMPLE_TIME, x, x.copy(), V[k], P[k], np.zeros(EXTRA_STATES), ii, q)
            U = V
        for j, i in GAINS:
            U[:, j] *= P[:, i]
        n_lead = 0 if lead is None else len(lead)
        if n_lead:
            before = np.zeros((n_lead, U.shape[1]))
            before[:, :nu] = np.reshape(lead, (n_lead, nu))
            U = np.vstack([before, U])
        options = {}
        if "force" in OPTIONS:
            options["force"] = U[:, nu] if FORCES == 1 else U[:, nu:]
        if "params" in OPTIONS:
            options["params"] = values
        if "x0" in OPTIONS:
            options["x0"] = np.array(START if x0 is None else x0, dtype=float)
        y = np.asarray(nominal_simulate(U[:, :nu], **options), dtype=float)[n_lead:]
        y = (y[:, None] if y.ndim == 1 else y).copy()
        for law, ii, q, *_ in AT_THE_SENSOR:
            for k in range(len(y)):
                law(3, k * SAMPLE_TIME, SAMPLE_TIME, x, x.copy(), U[n_lead + k], P[k], y[k], ii, q)
        return y

    return simulate
'''

_BUILD = '''

def build():
    """The repaired simulator, a callable simulate(u)."""
    return make_repaired(nominal_build())


simulate = build()
'''
