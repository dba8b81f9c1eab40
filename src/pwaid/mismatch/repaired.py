"""The repaired simulator: an object for python-control, and a file that runs without pwaid.

Both advance one sample at a time with the scheme that was fitted: the missing laws act inside the user's equations,
memory (play, rate limits, friction at rest) is kept in extra states. The file holds only the parts its laws need.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping

import control

from pwaid.mismatch import repaired_parts as parts
from pwaid.mismatch.engine import INSTANT
from pwaid.mismatch.hypotheses import Hypothesis
from pwaid.mismatch.lawnames import module_text
from pwaid.mismatch.lawsource import Law, law_functions
from pwaid.mismatch.model import Model
from pwaid.mismatch.plant import Plant
from pwaid.mismatch.realise import realise

__all__ = ["repaired_source", "repaired_system", "without_future"]


def repaired_system(hypothesis: Hypothesis, sample_time: float) -> control.NonlinearIOSystem:
    """The repaired simulator as a discrete-time control.nlsys with the same inputs and outputs.

    The states are the nominal ones followed by the effects' own; `params` hold the refitted values.
    """
    space: dict = {}
    exec(compile(repaired_source(hypothesis, sample_time, None), "<repaired simulator>", "exec"), space)
    plant = hypothesis.fit.model.settings.plant
    update, output = space["make_repaired"](plant.update, plant.output, plant.constants)
    return control.nlsys(update, output, inputs=list(plant.input_names), outputs=list(plant.output_names),
                         states=list(plant.state_names) + space["MEMORY"], params=dict(space["REFITTED"]),
                         dt=sample_time, name="repaired")


def repaired_source(hypothesis: Hypothesis, sample_time: float, simulator_source: str | None,
                    comments: Mapping[str, str] | None = None) -> str:
    """Text of repaired_simulator.py.

    Parameters
    ----------
    simulator_source : text of the user's simulator with its build(); None leaves it out.
    comments : what is said beside a value, by parameter name, or by number of the effect and its parameter's name
        (``"0.level"``): unit, interval.
    """
    model, comments = hypothesis.fit.model, comments or {}
    laws = _laws(hypothesis)
    text = [_header(hypothesis)] if simulator_source is not None else []
    text.append("import control\nimport numpy as np\n")
    if simulator_source is not None:
        text.append(parts.rule("the nominal simulator, unchanged") + without_future(simulator_source).rstrip()
                    + "\n\n\nnominal_build = build\n")
    text.append(parts.rule("what was fitted") + _values(hypothesis, laws, sample_time, comments))
    if laws:
        needed = module_text({law.located.effect.kernel: tuple(law.functions.values()) for law in laws})
        text.append(parts.rule("the missing physics") + "\n\n\n".join(
            [*([needed] if needed else []), "\n\n".join(_law_text(law) for law in laws)]))
    text.append(parts.rule("the repaired simulator") + _simulator(model, laws))
    if simulator_source is not None:
        text.append(_build_text(model.settings.plant))
        text.append(_simulate(model))
    return "\n\n\n".join(t.strip("\n") for t in text) + "\n"


def _build_text(plant: Plant) -> str:
    """build() of the repaired simulator, and what it needs."""
    if plant.arguments:
        return inspect.getsource(realise) + parts.filled(parts.ARGUMENTS_BUILD, {"ARGUMENTS": plant.arguments})
    if plant.linear:
        return inspect.getsource(realise) + parts.LINEAR_BUILD
    system = "nominal_build()"
    if plant.output is None:  # build() gives a right-hand side whose states are the outputs
        inputs, states = list(plant.input_names), list(plant.state_names)
        system = f"control.nlsys(nominal_build(), None, inputs={inputs}, outputs={states}, states={states})"
    return parts.filled(parts.BUILD, {"SYSTEM": system})


def _laws(hypothesis: Hypothesis) -> list[Law]:
    model, laws = hypothesis.fit.model, []
    for k, (e, values) in enumerate(zip(model.located, hypothesis.values(), strict=True)):
        laws.append(law_functions(e, model.II[model.order.index(k)], values, model.settings.plant, _memory_names(model),
                                  [law.name for law in laws]))
    if not any(law.located.effect.proximal for law in laws):
        for law in laws:
            law.functions.pop("mobility", None)
    return laws


def _memory_names(model: Model) -> list[str]:
    return [f"z{i}" for i in range(model.extra)]


def without_future(text: str) -> str:
    """A module's text without its __future__ imports, which only stand at the top of a file."""
    return "\n".join(line for line in text.splitlines() if not line.startswith("from __future__"))


def _header(hypothesis: Hypothesis) -> str:
    said = [f"    {e.label}: {e.effect.law}" for e in hypothesis.located] or [
        "    no law was added: refitted parameters only"]
    lines = ['"""The simulator with the missing physics put in, written by pwaid.', "", *said, "",
             "Runs without pwaid: needs numpy and control. `build()` gives a discrete-time control.nlsys with the",
             "inputs and outputs of the nominal simulator; `simulate(t, u, x0)` runs it over a recording.", '"""']
    return "\n".join(lines)


def _literal(value) -> str:
    return f"np.array({value.tolist()!r})" if hasattr(value, "tolist") and getattr(value, "ndim", 0) else repr(value)


def _dictionary(name: str, rows) -> str:
    """A dictionary literal, one commented value per line."""
    rows = list(rows)
    if not rows:
        return f"{name} = {{}}\n"
    body = "".join(f"    {key!r}: {_literal(value)},{f'  # {said}' if said else ''}\n" for key, value, said in rows)
    return f"{name} = {{\n{body}}}\n"


def _values(hypothesis: Hypothesis, laws, sample_time: float, comments) -> str:
    model = hypothesis.fit.model
    plant = model.settings.plant
    fitted = zip(plant.parameters, model.parameters(hypothesis.fit.theta), strict=False)
    text = _dictionary("REFITTED", ((n, float(v), comments.get(n, "kept")) for n, v in fitted))
    for k, law in enumerate(laws):
        if law.values:
            names = [q.name for q in law.located.effect.quantities]
            said = [comments.get(f"{k}.{n}", "") for n in names] + ["of the simulator"] * len(law.values)
            text += _dictionary(law.name.upper(), ((n, v, s) for (n, v), s in zip(law.values.items(), said,
                                                                                 strict=False)))
    text += f"SAMPLE_TIME = {sample_time!r}  # s\n"
    if not plant.dt:
        text += f"SUBSTEPS = {model.substeps}  # Runge-Kutta steps per sample\n"
    return text + f"MEMORY = {_memory_names(model)!r}  # states of the missing physics, after the nominal ones\n"


def _law_text(law: Law) -> str:
    said = f"# {law.located.label}: {law.located.effect.law}"
    if law.located.effect.delays:
        said += "\n# (the command is shifted where the simulator reads it, below)"
    return "\n\n\n".join([f"{said}\n{next(iter(law.functions.values()), '')}".rstrip(),
                         *[f.rstrip() for f in list(law.functions.values())[1:]]]) + "\n"


# ------------------------------------------------------------------ the simulator around the laws
def _calls(laws, role: str, arguments: str, indent: int) -> str:
    """The calls of all laws in one role, a line each."""
    return "".join(f"{' ' * indent}{law.call(role, arguments)}\n" for law in laws if role in law.functions)


def _memory_calls(laws, chained: bool) -> str:
    """The calls that update memories; `chained`, a law at an input follows what the one before it lets through."""
    if not chained:
        return _calls(laws, "memory", "t, h, state, inputs, params", 8)
    lines = "        passed = inputs.copy()\n"
    for law in laws:
        lines += _calls([law], "memory", "t, h, state, passed, params", 8)
        lines += _calls([law], "seen", "t, h, state, state.copy(), passed, dict(params)", 8)
    return lines


def _simulator(model: Model, laws) -> str:
    plant, s = model.settings.plant, model.settings
    laws = [laws[k] for k in model.order]
    dry = [law for law in laws if law.located.effect.proximal]
    delayed = [law for law in laws if law.located.effect.delays]
    rates_shown = s.rates_shown if laws else ()
    seen = _calls(laws, "seen", "t, {h}, state, seen, inputs, params", 8)
    rates = _calls(laws, "rates", "t, h, state, inputs, params, rates", 8)
    moving, averaged = bool(rates and s.carried), bool(laws) and s.averaged
    fill = {
        "NX": len(plant.state_names),
        "FOUND": f"(found - state[:{len(plant.state_names)}]) / SAMPLE_TIME" if plant.dt else "found",
        "DISCRETELY": ", changes per second of the discrete simulator" * bool(plant.dt)
        + ", which begins `moved` before the laws" * averaged,
        "MOVED": ", moved=0.0" * averaged, "BEFORE": " - moved" * averaged,
        "SEEN": seen.replace("{h}", "h"),
        "SEEN_AT_SAMPLE": "        seen = state.copy()\n" + seen.replace("{h}", "0.0") if seen or rates_shown else "",
        "RATES": rates,
        "OWN": parts.OWN if moving else "", "CARRIED": parts.CARRIED if moving else "",
        "CARRIES": f"    carried = {s.carried}  # position, speed, and what it moves with a change of that in a step\n"
        if moving or (dry and s.carried) else "",
        "SENSORS": _calls(laws, "sensor", "t, SAMPLE_TIME, state, inputs, params, outputs", 8),
        "MEMORY_CALLS": _memory_calls(laws, model.chained),
    }
    text = parts.PLANT
    if dry:
        fill |= {"DRY": _dry(laws, list(plant.parameters)), "SPEED_OF": s.partner.tolist(),
                 "SPEED_RATIO": s.ratio.tolist(),
                 "COLUMN_CARRIED": parts.COLUMN_CARRIED if s.carried else "",
                 "MOBILITY": _calls(laws, "mobility", "t, 0.0, state, inputs, params, column", 8)}
        text += parts.FRICTION
    if plant.dt:
        text += parts.DISCRETE_STEP
        fill |= {"FRICTION_AT_REST": parts.DISCRETE_FRICTION if dry else "",
                 "AVERAGED": parts.AVERAGED if averaged else "",
                 "MEAN": ", with the mean of what the laws do at both of its ends" * averaged}
    else:
        text += parts.DRY_STEP if dry else parts.RUNGE_KUTTA_STEP
    if delayed:
        fill["DELAYS"] = ", ".join(f"({int(law.located.place.ii[8])}, {law.name.upper()}['delay'])" for law in delayed)
        text += parts.DELAY
    if rates_shown:
        fill |= {"RATES_SHOWN": list(rates_shown), "INSTANT": INSTANT,
                 "RATES_SEEN": _calls(laws, "rates", "t, h, state, inputs_seen, params_seen, rates", 8),
                 "FRICTION_IN_RATES": parts.FRICTION_IN_RATES if dry else ""}
        text += parts.ACCELERATIONS
    text += parts.UPDATE
    sensors_remember = any(re.search(r"state\[\d+\] \S?=", law.functions.get("sensor", "")) for law in laws)
    fill |= {"REMEMBER": parts.REMEMBER if delayed else "",
             "DELAYED_AT_SAMPLE": parts.DELAYED_AT_SAMPLE if delayed else "",
             "DELAYED_CALL": "delayed(now, held)" if delayed else "held",
             "GIVEN": parts.GIVEN if rates_shown else "", "SHOW_RATES": parts.SHOW_RATES if rates_shown else "",
             "SENSOR_MEMORY": parts.SENSOR_MEMORY if sensors_remember else "",
             "STEPS": "1" if plant.dt else "SUBSTEPS"}
    return parts.filled(text, fill)


def _dry(laws, parameters) -> str:
    """The list of dry frictions: level, where its speed is, and what a unit of force does."""
    rows = []
    for law in laws:
        if not law.located.effect.proximal:
            continue
        ii = law.located.place.ii
        inertia = parameters[ii[3]] if ii[1] == 1 and ii[3] >= 0 else None
        kind = ("input", "rate", "against input")[ii[1]]
        push = f"({kind!r}, {ii[2]}, {inertia!r})"
        rows.append(f"        ({law.name}_level, {law.name.upper()}, {ii[4]}, {push}),\n")
    return "".join(rows)


def _simulate(model: Model) -> str:
    starts = []
    for k, e in enumerate(model.acting):
        first, count = int(model.II[k, 0]), e.effect.extra_states
        if e.effect.start == "input":
            starts.append(f"    state[{first}:{first + count}] = u[0, {int(model.II[k, 8])}]\n")
        elif e.effect.start == "stored":
            starts.append(f"    state[{first}] = state[{int(model.II[k, 4])}]\n")
    return parts.filled(parts.SIMULATE, {"STARTS": "".join(starts), "INTERPOLATED": model.settings.first_order_hold})
