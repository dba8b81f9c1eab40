"""The report: what report.json holds, and the object that `explain` returns."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from pwaid.mismatch.decide import Decision, white_bic
from pwaid.mismatch.experiment import Experiment, next_experiment, plan_experiment, rivals
from pwaid.mismatch.hypotheses import Hypothesis, share
from pwaid.mismatch.intervals import parameter_intervals
from pwaid.mismatch.isolability import Isolability, inside, isolability, leading
from pwaid.mismatch.locate import Location
from pwaid.mismatch.measures import fit_table
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.repaired import repaired_source, repaired_system
from pwaid.mismatch.repaired_blackbox import black_box_source, repaired_black_box
from pwaid.mismatch.summary import interval, summary_text
from pwaid.mismatch.thresholds import Thresholds
from pwaid.mismatch.units import combine

__all__ = ["SCHEMA", "Report", "build_report", "write_report"]

SCHEMA = "pwaid.mismatch/1"


@dataclass(frozen=True)
class Report:
    """The answer: `verdict`, `effects`, `fit`, `simulator`, `to_dict`, `to_html`, `plot`, `summary`."""

    content: dict
    problem: Problem = field(repr=False)
    null: Hypothesis = field(repr=False)
    decision: Decision = field(repr=False)
    singles: tuple[Hypothesis, ...] = field(repr=False)
    pairs: tuple[Hypothesis, ...] = field(repr=False)
    location: Location = field(repr=False)
    fallback: Hypothesis | None = field(default=None, repr=False)
    isolability: Isolability | None = field(default=None, repr=False)
    experiment: Experiment | None = field(default=None, repr=False)

    @property
    def verdict(self) -> str:
        return self.content["verdict"]

    @property
    def effects(self) -> list[dict]:
        return self.content["effects"]

    @property
    def fit(self) -> dict:
        return self.content["fit"]

    @property
    def best(self) -> Hypothesis:
        """The hypothesis behind the repaired simulator: the named one, the correction, or the null."""
        return self.fallback or self.decision.chosen or self.null

    @cached_property
    def simulator(self):
        """The repaired simulator: a discrete-time control.nlsys, or simulate(u) where that was given."""
        black_box = self.problem.plant.black_box is not None
        return (repaired_black_box if black_box else repaired_system)(self.best, self.problem.train.sample_time)

    def to_dict(self) -> dict:
        """The content of report.json."""
        return self.content

    @property
    def summary(self) -> str:
        """One screen of text for a busy engineer."""
        return summary_text(self.content)

    def to_html(self, path) -> Path:
        """Write a self-contained HTML page."""
        from pwaid.mismatch.html import html_page

        path = Path(path)
        path.write_text(html_page(self), encoding="utf-8")
        return path

    def plot(self):
        """A figure: recording against simulations, residuals, candidates."""
        from pwaid.mismatch.pictures import overview

        return overview(self)


def _number(x) -> float | None:
    x = float(x)
    return x if math.isfinite(x) else None


def _clean(item):
    if isinstance(item, dict):
        return {k: _clean(v) for k, v in item.items()}
    if isinstance(item, list | tuple):
        return [_clean(v) for v in item]
    if isinstance(item, float | np.floating):
        return _number(item)
    if isinstance(item, np.integer):
        return int(item)
    if isinstance(item, np.bool_):
        return bool(item)
    return item


def effect_entries(h: Hypothesis, shares: Sequence[float], low, high) -> list[dict]:
    """The `effects` list of report.json for one hypothesis; low, high: ends on the fitted axis."""
    entries, k = [], h.fit.model.np
    for e, part in zip(h.located, shares, strict=True):
        z = h.fit.theta[k:k + e.size]
        ends = np.array([e.physical(low[k:k + e.size]),
                         e.physical(high[k:k + e.size])]) if e.size else np.zeros((2, 0))
        values = e.physical(z)
        entries.append({
            "id": e.effect.id,
            "where": {"kind": e.place.kind, "signal": e.place.signal, "variables": list(e.place.variables),
                      "note": e.place.note},
            "law": e.effect.law,
            "parameters": {q.name: {"value": values[i], "low": ends[:, i].min(), "high": ends[:, i].max(),
                                    "unit": u}
                           for i, (q, u) in enumerate(zip(e.effect.quantities, e.units(), strict=True))},
            "share_explained": part,
        })
        k += e.size
    return entries


def parameter_entries(problem: Problem, h: Hypothesis, low, high) -> dict[str, dict]:
    """Nominal and refitted value of every free parameter, with its interval."""
    entries = {}
    for k, name in enumerate(problem.settings.free):
        nominal = problem.plant.parameters[name]
        ends = sorted((nominal * np.exp(low[k]), nominal * np.exp(high[k])))
        entries[name] = {"nominal": nominal, "refitted": nominal * np.exp(h.fit.theta[k]), "low": ends[0],
                         "high": ends[1]}
    return entries


def _shares(problem, h: Hypothesis, singles) -> list[float]:
    """What each law removes: of a pair the mean of what it removes alone and of what it adds to the other."""
    if len(h.located) < 2:
        return [h.share]
    known = {s.located[0].key: s.share for s in singles}
    alone = [min(max(known.get(e.key, 0.0), 0.0), h.share) for e in h.located]
    first = 0.5 * (alone[0] + h.share - alone[1])
    return [first, h.share - first]


def _candidates(problem, hypotheses, decision: Decision, output_names):
    """One row per fitted candidate; `wider`: it contains the answer and is not the answer."""
    rows = []
    ok = {id(h) for h in decision.passed}
    for h in hypotheses:
        rmse = np.sqrt(np.mean((problem.test.Y - h.test.Y) ** 2, axis=0))
        rows.append({"id": " + ".join(h.ids), "family": " + ".join(h.families), "where": h.label,
                     "heldout_rmse": dict(zip(output_names, map(float, rmse), strict=True)),
                     "share_explained": h.share, "screen_score": h.score, "parameters": h.fit.model.size,
                     "passed": id(h) in ok, "bic": white_bic(problem, h), "values": _values(h),
                     "wider": any(h is not m and inside(m, h) for m in decision.members)})
    return sorted(rows, key=lambda r: -r["share_explained"])


def _values(h: Hypothesis) -> dict[str, float]:
    """Fitted parameters by name, `id.name` where there are several effects, `id(channel).name` where of one id."""
    several, twice = len(h.located) > 1, len(set(h.ids)) < len(h.ids)

    def said(e) -> str:
        return f"{e.effect.id}({e.place.channel})." if twice else f"{e.effect.id}." if several else ""

    return {f"{said(e)}{q.name}": float(v)
            for e, part in zip(h.located, h.values(), strict=True)
            for q, v in zip(e.effect.quantities, part, strict=True)}


def _units(problem: Problem) -> dict:
    """Units of inputs and outputs as text."""
    s, plant = problem.structure, problem.plant
    return {"inputs": {n: combine({}, (dict(u), 1)) for n, u in zip(plant.input_names, s.input_units, strict=True)},
            "outputs": {n: combine({}, (dict(u), 1)) for n, u in zip(plant.output_names, s.output_units, strict=True)}}


def _alternatives(decision: Decision) -> list[list[int]]:
    """Which entries of `effects` belong to each member of the answer."""
    groups, k = [], 0
    for h in decision.members:
        groups.append(list(range(k, k + len(h.located))))
        k += len(h.located)
    return groups


def build_report(problem: Problem, null, singles, pairs, screened, decision: Decision, location: Location,
                 notes,
                 tried: int, seconds: float, fallback: Hypothesis | None = None, jobs: int = 1,
                 thresholds: Thresholds | None = None, closed_loop: dict | None = None, brief: bool = False) -> Report:
    """Gather everything into the content of report.json.

    brief : leave out the comparison of hypotheses and the plan of the next experiment.
    """
    names = problem.plant.output_names
    used = fallback if fallback is not None and fallback.share > 0 else None
    best = used or decision.chosen or null
    found = {id(h): parameter_intervals(problem, h.fit) for h in {id(h): h for h in (*decision.members, best)}.values()}
    effects = []
    for h in decision.members:
        effects += effect_entries(h, _shares(problem, h, singles), *found[id(h)][:2])
    low, high, correlation = found[id(best)]
    warnings = [*notes, *_collinear(best, correlation)]
    parameters = parameter_entries(problem, best, low, high)
    for k, name in enumerate(problem.settings.free):
        parameters[name]["without_effect"] = problem.plant.parameters[name] * np.exp(null.fit.theta[k])
    limits = thresholds or Thresholds()
    units, others = _units(problem), [*singles, *pairs]
    told = isolability(problem, [null] if brief else leading(null, decision.members, others), jobs)
    pair = None if brief else rivals(problem, null, decision, others, screened)
    plan = plan_experiment(problem, pair, list(units["inputs"].values()), told) if pair else None
    stages = {"nominal": problem.nominal_test.Y, "refitted": null.test.Y, "repaired": best.test.Y}
    content = {
        "schema": SCHEMA, "verdict": decision.verdict, "effects": effects,
        "alternatives": _alternatives(decision), "units": units,
        "answer": [h.label for h in decision.members],
        "candidates": _candidates(problem, others, decision, names),
        "location": _location(location, decision.chosen if decision.members else None, screened),
        "parameters": parameters,
        "fit": fit_table(problem.test, names, stages, problem.floor.level),
        "fit_train": fit_table(problem.train, names, {"nominal": problem.nominal.Y, "refitted": null.fit.Y,
                                                      "repaired": best.fit.Y}, problem.floor.level),
        "bic_null": white_bic(problem, null),
        "share_needed": limits.share if problem.floor.trusted else limits.share_tentative,
        "share_explained": best.share if decision.members else 0.0,
        "noise_floor": dict(zip(names, map(float, problem.floor.level), strict=True)),
        "noise_floor_source": problem.floor.source,
        "correction": _correction(location, fallback, used),
        "next_experiment": next_experiment(problem, decision, plan),
        "experiment": plan.table() if plan else None, "isolability": told.table(),
        "reasons": list(decision.reasons), "warnings": warnings,
        "screen": [{"id": s.located.effect.id, "where": s.located.label, "score": s.score,
                    "visible": s.visible}
                   for s in screened],
        "hypotheses_tried": tried, "seconds": seconds,
    }
    if closed_loop is not None:
        content["closed_loop"] = closed_loop
    return Report(_clean(content), problem, null, decision, tuple(singles), tuple(pairs), location, used, told, plan)


def _location(location: Location, best, screened) -> dict:
    """Channel and variables of the named effect; else of the located unknown input; else of the candidate most
    like the residual. Breakpoints, memory and ranking are the microscope's."""
    channel, variables, shape = location.channel, location.variables, location.shape
    if best is None and not variables and screened and screened[0].score > 0:
        channel, variables = screened[0].located.place.channel, screened[0].located.place.variables
    if best is not None and best.located:
        channel = best.located[0].place.channel
        variables = tuple(dict.fromkeys(v for e in best.located for v in e.place.variables))
    found = {"channel": channel, "variables": list(variables), "breakpoints": location.breakpoints,
             "memory": location.memory or bool(best and any(e.effect.memory for e in best.located)),
             "intervals_s": [list(i) for i in location.intervals_s],
             "bands_hz": [list(b) for b in location.bands_hz]}
    if shape is not None:
        found["unknown_input"] = {
            "channel": location.channel, "alike": list(location.alike), "variable": shape.variable,
            "ranking": shape.ranking, "threshold": shape.threshold, "heldout_gain": shape.gain,
            "smeared_over_s": location.unknown.rise,
            "breakpoints": [{"position": b.position, "low": b.low, "high": b.high, "jump": b.jump, "size": b.size}
                            for b in shape.bends]}
        pair = location.pair
        if pair is not None:
            found["unknown_input"]["pair"] = {
                "variables": list(pair.variables), "heldout_gain": pair.gain, "threshold": pair.threshold,
                "ranking": [{"variables": list(v), "gain": g} for v, g in pair.ranking.items()]}
    return found


def _correction(location: Location, fallback, used) -> dict | None:
    """The unnamed PWA correction of an unexplained mismatch."""
    if fallback is None:
        return None
    curve, gain = location.shape.curve, fallback.values()[0][0]
    return {"label": "learned correction without a name: it repairs the simulation and explains nothing",
            "channel": location.channel, "variable": location.shape.variable, "knots": curve.knots.tolist(),
            "values": (gain * curve.values).tolist(), "heldout_gain": fallback.share,
            "in_repaired_simulator": used is not None}


def _collinear(h: Hypothesis, correlation) -> list[str]:
    names = list(h.fit.model.settings.free) + [f"{e.effect.id}.{q.name}"
                                               for e in h.located for q in e.effect.quantities]
    notes = []
    for i in range(len(names)):
        for j in range(max(i + 1, h.fit.model.np), len(names)):
            if abs(correlation[i, j]) > 0.95:
                notes.append(f"{names[i]} and {names[j]} are collinear here: correlation {correlation[i, j]:.3f}")
    return notes


def write_report(report: Report, out: Path, simulator_source: str) -> None:
    """Write report.json, report.html, report.txt and repaired_simulator.py; all are made before any is written."""
    comments = {}
    for k, e in enumerate(report.effects[:len(report.best.located)]):
        for name, v in e["parameters"].items():
            said = f"90 %: {interval(v['value'], v['low'], v['high'])}"
            comments[f"{k}.{name}"] = f"{v['unit']}, {said}" if v["unit"] else said
    for name, v in report.content["parameters"].items():
        comments[name] = f"nominal {v['nominal']:.6g}, 90 %: {interval(v['refitted'], v['low'], v['high'])}"
    from pwaid.mismatch.html import html_page

    step = report.problem.train.sample_time
    if report.problem.plant.black_box is None:
        repaired = repaired_source(report.best, step, simulator_source, comments)
    else:
        rows = [f"{name}: {said}" for name, said in comments.items()]
        repaired = black_box_source(report.best, step, simulator_source, rows)
    files = {"report.json": json.dumps(report.content, indent=1, allow_nan=False),
             "report.html": html_page(report),
             "report.txt": report.summary,
             "repaired_simulator.py": repaired}
    out.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (out / name).write_text(text, encoding="utf-8")


__all__ += ["effect_entries", "parameter_entries", "share"]
