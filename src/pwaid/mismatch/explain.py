"""Explain the mismatch: the pipeline from recordings and a simulator to a verdict and a report.

    hygiene -> floor -> null refit -> locate -> screen -> fit -> pairs -> decide -> report
"""

from __future__ import annotations

import math
import time as clock
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from pwaid.errors import InputError
from pwaid.folders import ready_folder
from pwaid.mismatch.access import (
    SlowSimulationWarning,
    check_names,
    check_recordings,
    expected_time,
    failed_trials,
    prepare_black_box,
)
from pwaid.mismatch.case import Case, load_case
from pwaid.mismatch.closed_loop import closed_loop_report, make_loop
from pwaid.mismatch.correction import correct
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.decide import decide
from pwaid.mismatch.effects.registry import CATALOGUE, effect_by_id
from pwaid.mismatch.evidence import Evidence, gather
from pwaid.mismatch.hygiene import hygiene, with_feedback
from pwaid.mismatch.locate import locate
from pwaid.mismatch.plant import as_plant
from pwaid.mismatch.prepare import prepare
from pwaid.mismatch.report import Report, build_report, write_report
from pwaid.mismatch.thresholds import Thresholds
from pwaid.recording import Recording

__all__ = ["collect", "collect_case", "conclude", "explain", "explain_case"]

# The matrices here are small: threads of the BLAS would double the CPU time, and take the cores from `jobs`.
_one_blas_thread = threadpool_limits.wrap(limits=1, user_api="blas")


def _split(train: Sequence[Recording]) -> tuple[list[Recording], list[Recording], int]:
    """Hold out the last recording, or the last third of the only one; and how many samples ran before it."""
    if len(train) > 1:
        return list(train[:-1]), [train[-1]], 0
    only = train[0]
    cut = 2 * len(only.time) // 3
    return [only[:cut]], [only[cut:].replace(name=f"{only.name}[{cut}:]")], cut


def _told_apart(*sets: Sequence[Recording]) -> list[list[Recording]]:
    """The recordings under different names: a second "log" becomes "log (2)"."""
    seen: dict[str, int] = {}
    found = []
    for recordings in sets:
        found.append([])
        for r in recordings:
            seen[r.name] = seen.get(r.name, 0) + 1
            found[-1].append(r if seen[r.name] == 1 else r.replace(name=f"{r.name} ({seen[r.name]})"))
    return found


def explain(simulator, train, test=None, free_parameters: Sequence[str] | None = None, *,
            units: Mapping | None = None,
            tolerances: Mapping[str, float] | None = None, noise_floor: Mapping[str, float] | None = None,
            repeats=(), hold: str = "zero", closed_loop: bool = False, controller=None,
            references: Mapping[str, np.ndarray] | None = None, effects=None,
            without: Sequence[str] = (),
            jobs: int = 1, minutes: float | None = None, progress: Callable | None = None,
            thresholds: Thresholds | None = None, source: str = "") -> Report:
    """Say why a simulator and recordings differ.

    Parameters
    ----------
    simulator : control.NonlinearIOSystem, control.StateSpace or transfer function, continuous or
        discrete, a right-hand side ``f(t, x, u, params)`` whose states are its outputs, or a callable
        ``simulate(u) -> y`` (`pwaid.mismatch.blackbox.BlackBox` lists its options).
    train, test : Recording or sequence of Recording; without test, the last recording (or the last
        third of a single one) is held out.
    free_parameters : names of nominal parameters that may be wrong; when None all that are not 0, of matrix entries
        those other than 0 and ±1, and only those of B and D when more than 12 are left.
    units : unit per channel name, where the recordings carry none.
    tolerances : relative tolerance per free parameter; 0.3 by default.
    noise_floor : level per output, in its unit. repeats : groups of recording names under one input.
    hold : ``"zero"`` or ``"first"``, what inputs do between samples. thresholds : the numbers a verdict depends on.
    source : text of the simulator, for the repaired one.
    closed_loop : whether the recordings come from a closed loop. controller : the control system that closed it,
        from (references, measured outputs) to the plant inputs; `references` its signals (N, n) by recording name.
    effects : the catalogue to try; the built-in one plus registered effects by default.
    without : effect ids left out of the catalogue.
    jobs : threads. progress : callable ``progress(fraction, text)``.
    minutes : time after which no further law is tried, and the verdict rests on those that were; no limit by default.

    Returns
    -------
    Report
        With verdict, effects, fit, simulator, to_dict, to_html, plot.

    Raises
    ------
    InputError
        For unusable input, saying what came, what was expected, what to do.
    """
    started = clock.perf_counter()
    evidence = collect(simulator, train, test, free_parameters, units=units, tolerances=tolerances,
                       noise_floor=noise_floor, repeats=repeats, hold=hold, closed_loop=closed_loop,
                       controller=controller, references=references, effects=effects, without=without, jobs=jobs,
                       minutes=minutes, progress=progress, source=source)
    return conclude(evidence, thresholds, started, progress, jobs)


@_one_blas_thread
def collect(simulator, train, test=None, free_parameters=None, *, units=None, tolerances=None, noise_floor=None,
            repeats=(), hold="zero", closed_loop=False, controller=None, references=None, effects=None, without=(),
            jobs=1, minutes=None, progress=None, source="") -> Evidence:
    """Check what came, refit the nominal simulator, fit every hypothesis worth it; parameters as for `explain`."""
    say = progress or (lambda fraction, text: None)
    if minutes is not None and not minutes > 0:
        raise InputError(f"minutes is {minutes}; expected a positive number, or None for no limit")
    deadline = math.inf if minutes is None else clock.monotonic() + 60.0 * minutes
    if hold not in ("zero", "first"):
        raise InputError(f"hold is {hold!r}; expected 'zero' or 'first'")
    train = [train] if isinstance(train, Recording) else list(train)
    test = [] if test is None else ([test] if isinstance(test, Recording) else list(test))
    if not train:
        raise InputError("no training recording came; expected at least one")
    train, test = _told_apart(train, test)
    ran, only = 0, train[0].name
    if not test:
        train, test, ran = _split(train)
    if ran and references and only in references:
        references = {**references, test[0].name: references[only][ran:]}
    for name in without:
        effect_by_id(name)
    plant, notes = as_plant(simulator, train[0].input_names, train[0].output_names, source=source), []
    check_recordings(plant, train, test)
    check_names(plant, tolerances, noise_floor)
    loop = None
    if controller is not None:
        loop = make_loop(controller, plant, references or {}, train[0].sample_time, test)
    units = {**train[0].units, **(units or {})}
    data, held = Dataset.from_recordings(train), Dataset.from_recordings(test).after(ran)
    if plant.black_box is not None:
        plant, data, held, more = prepare_black_box(plant, data, held)
        notes += more
    wait = expected_time(plant, data)
    if wait:
        warnings.warn(wait, SlowSimulationWarning, stacklevel=2)
        notes.append(wait)
    say(0.02, "refitting the nominal simulator")
    groups, dropped = _repeats(repeats, (*train, *test))

    def posed(start=None):
        problem = prepare(plant, data, held, [units.get(n, "") for n in train[0].input_names],
                          [units.get(n, "") for n in train[0].output_names], free_parameters, tolerances,
                          noise_floor, groups, hold == "first", start)
        problem = replace(problem, deadline=deadline)
        said = hygiene(problem, closed_loop, loop is not None)
        return with_feedback(problem, closed_loop or loop is not None), [*notes, *dropped, *said]

    catalogue = [e for e in (CATALOGUE if effects is None else effects) if e.id not in without]
    evidence = gather(*posed(), catalogue, jobs, say)
    if evidence.lower is not None and not evidence.problem.late:
        say(0.02, "refitting the nominal simulator from where a law led its parameters")
        evidence = gather(*posed(evidence.lower), catalogue, jobs, say, settled=True)
    return replace(evidence, loop=loop)


@_one_blas_thread
def conclude(evidence: Evidence, thresholds: Thresholds | None = None, started: float | None = None,
             progress: Callable | None = None, jobs: int = 1, brief: bool = False) -> Report:
    """Decide, locate and report on hypotheses that are already fitted.

    `started` is the clock at the beginning; brief leaves out the comparison of hypotheses and the next experiment.
    """
    say = progress or (lambda fraction, text: None)
    problem = evidence.problem
    say(0.85, "deciding")
    decision = decide(problem, evidence.null, evidence.singles, evidence.pairs, thresholds)
    say(0.9, "locating")
    named = decision.members[0].located[0].place.channel if decision.members else ""
    location = locate(problem, named, look=decision.verdict not in ("agreement", "parameters_only"))
    fallback = correct(problem, location) if decision.verdict == "unexplained" else None
    notes, closed = [*evidence.notes, *failed_trials(problem.plant)], None
    if evidence.loop is not None:
        best = (fallback if fallback is not None and fallback.share > 0 else None) or decision.chosen or evidence.null
        closed, more = closed_loop_report(evidence.loop, problem.plant, problem.test, {
            "nominal": problem.nominal_test, "refitted": evidence.null.test, "repaired": best.test})
        notes += more
    seconds = 0.0 if started is None else clock.perf_counter() - started
    report = build_report(problem, evidence.null, evidence.singles, evidence.pairs, evidence.screened, decision,
                          location, notes, evidence.tried, seconds, fallback, jobs, thresholds, closed, brief)
    say(1.0, "done")
    return report


def _repeats(groups, recordings) -> tuple[list, list[str]]:
    """The recordings of every group of true repeats, and a note where a group was none."""
    named = {r.name: r for r in recordings}
    for name in (n for group in groups for n in group):
        if name not in named:
            raise InputError(f"repeats names {name!r}, which is no recording; expected names among {', '.join(named)}")
    found = [[named[n] for n in group] for group in groups]
    kept = [g for g in found if len(g) > 1 and _same_input(g)]
    dropped = ["repeated recordings with different inputs (a closed loop?) say nothing about the floor: not used"]
    return [Dataset.from_recordings(g) for g in kept], dropped if len(kept) < len(found) else []


def _same_input(group) -> bool:
    """Whether recordings called repeats saw the same input, to 1 % of its variation."""
    n = min(len(r.time) for r in group)
    first = group[0].inputs[:n]
    spread = np.std(first, axis=0) + 1e-12
    return all(np.all(np.sqrt(np.mean((r.inputs[:n] - first) ** 2, axis=0)) < 0.01 * spread) for r in group[1:])


def explain_case(case_dir, out=None, jobs: int = 1, progress: Callable | None = None,
                 without: Sequence[str] = (), minutes: float | None = None) -> Report:
    """Explain a case folder and write report.json, report.html, report.txt and repaired_simulator.py.

    Parameters
    ----------
    case_dir : folder with case.toml. out : folder for the results, ``CASE_DIR/explained`` by default.
    without : effect ids left out of the catalogue. jobs, minutes : as for `explain`.

    Raises
    ------
    InputError
        For an unusable case; nothing is written then.
    """
    started = clock.perf_counter()
    case = load_case(case_dir)
    with ready_folder(Path(case_dir) / "explained" if out is None else out) as folder:
        report = conclude(collect_case(case, jobs, progress, without, minutes), None, started, progress, jobs)
        write_report(report, folder, case.simulator_source)
    return report


def collect_case(case: Case, jobs: int = 1, progress: Callable | None = None, without: Sequence[str] = (),
                 minutes: float | None = None) -> Evidence:
    """The evidence of a loaded case folder."""
    return collect(case.plant, case.train, case.test or None, case.free, tolerances=case.tolerances,
                   noise_floor=case.noise_floor, repeats=case.repeats,
                   hold="first" if case.first_order_hold else "zero", closed_loop=case.closed_loop,
                   controller=case.controller, references=case.references, without=without, jobs=jobs,
                   minutes=minutes, progress=progress, source=case.simulator_source)
