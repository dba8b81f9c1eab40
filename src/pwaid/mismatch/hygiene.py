"""Plain-word warnings before any statistics: units, signs, flat tops, clocks, feedback, coverage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.timing import timing_notes
from pwaid.mismatch.units import combine

__all__ = ["hygiene", "leads_input", "with_feedback"]

LEADS = 0.3  # correlation of the residual with later inputs that betrays a controller


def hygiene(problem: Problem, closed_loop: bool = False, known: bool = False) -> list[str]:
    """Warnings about the recordings and the simulator, in the order an engineer would check them.

    Parameters
    ----------
    closed_loop : stated by the user. known : with its controller.
    """
    data, plant = problem.train, problem.plant
    notes = [*problem.notes, *plant.notes]
    for k, name in enumerate(plant.output_names):
        y = data.Y[:, k]
        notes += _distinct(name, y)
        notes += _flat(name, y)
        notes += _sign(name, y, problem.nominal.Y[:, k], combine({}, (dict(problem.structure.output_units[k]), 1)))
        notes += [f"{name} is constant in {r}: nothing of it is tested there"
                  for r, (a, b) in zip(problem.test.names, problem.test.recordings, strict=True)
                  if np.ptp(problem.test.Y[a:b, k]) == 0]
    notes += _swapped(problem)
    notes += timing_notes(problem)
    for j, name in enumerate(plant.input_names):
        if np.ptp(data.U[:, j]) == 0:
            notes.append(f"input {name} is constant: effects of this channel cannot be seen")
    notes += _feedback(problem, closed_loop, known)
    notes += _coverage(problem)
    return notes


def _distinct(name, y):
    values = np.unique(y)
    if len(values) < 0.1 * len(y):
        step = np.median(np.diff(values)) if len(values) > 1 else 0.0
        return [f"{name} takes only {len(values)} distinct values in {len(y)} samples "
                f"(step about {step:.3g}): quantised"]
    return []


def _flat(name, y):
    notes = []
    for level, word in ((y.max(), "top"), (y.min(), "bottom")):
        share = np.mean(np.abs(y - level) <= 1e-9 * max(np.ptp(y), 1e-300))
        if share > 0.01 and share * len(y) > 5:
            notes.append(f"{name} stays at exactly {level:.6g} for {100 * share:.1f} % of the samples: a flat {word}")
    return notes


FACTORS = {  # how many times too large or small an output looks when its unit is mistaken
    1000.0: "a thousand, as between m and mm", 180 / np.pi: "180/pi, as between degrees and radians",
    30 / np.pi: "30/pi, as between rpm and rad/s", 2 * np.pi: "2 pi, as between revolutions and radians",
    9.80665: "9.81, as between kgf and N", 3.6: "3.6, as between km/h and m/s", 60.0: "60, as between min and s",
    1e6: "a million, as between m and um", 100.0: "a hundred, as between m and cm or a share and percent",
}


def _sign(name, y, simulated, unit):
    """A mirrored output, or one whose size is off by a factor that units explain."""
    a, b = y - y.mean(), simulated - simulated.mean()
    power = np.sqrt((a @ a) * (b @ b))
    if not power > 0:
        return []
    alike = a @ b / power
    if alike < -0.6:
        return [f"{name} and its simulation are mirrored: check the sign of a channel"]
    ratio = float(np.sqrt((a @ a) / (b @ b)))
    if alike < 0.6 or 0.4 < ratio < 2.5:
        return []
    known = next((words for f, words in FACTORS.items() if 0.9 < max(ratio, 1 / ratio) / f < 1.1), None)
    if known is not None:
        return [f"{name} is {ratio:.3g} times its simulation in size, about {known}: check the unit"
                f"{f' ({unit})' if unit else ''}"]
    if ratio > 8 or ratio < 0.125:
        return [f"{name} is {ratio:.3g} times its simulation in size: check the units"]
    return []


def _swapped(problem):
    Y, S = problem.train.Y, problem.nominal.Y
    if Y.shape[1] < 2:
        return []
    Yc, Sc = Y - Y.mean(0), S - S.mean(0)
    C = (Yc.T @ Sc) / np.maximum(np.outer(np.linalg.norm(Yc, axis=0), np.linalg.norm(Sc, axis=0)), 1e-300)
    notes = []
    for i in range(len(C)):
        for j in range(i + 1, len(C)):
            if min(C[i, j], C[j, i]) > 0.95 and max(C[i, i], C[j, j]) < 0.5:
                names = problem.plant.output_names
                notes.append(f"outputs {names[i]} and {names[j]} look swapped")
    return notes


def with_feedback(problem: Problem, stated: bool) -> Problem:
    """The problem marked as recorded in closed loop, where that was stated or shows: its intervals are widened."""
    feedback = stated or leads_input(problem.train, problem.null.residual(problem.train)) > LEADS
    return replace(problem, settings=replace(problem.settings, feedback=feedback))


def leads_input(data: Dataset, residual) -> float:
    """Largest correlation of a residual's changes with later changes of an input: the controller at work.

    Parameters
    ----------
    residual : (N, ny) recorded minus simulated outputs.
    """
    worst = 0.0
    for r in residual.T:
        for j in range(data.U.shape[1]):
            du = np.diff(data.U[:, j], prepend=data.U[0, j])
            du = du - du.mean()
            for a, b in data.recordings:
                n = b - a
                white = np.diff(r[a:b], prepend=r[a])
                power = np.linalg.norm(white) * np.linalg.norm(du[a:b])
                if power > 0:
                    lags = range(1, min(20, n // 10))
                    worst = max([worst] + [abs(white[:-k] @ du[a:b][k:]) / power for k in lags])
    return float(worst)


def _feedback(problem, closed_loop, known):
    widened = "; intervals are widened by what feedback may have bent"
    if known:
        return ["closed loop with a known controller: fitted on the recorded plant input, and simulated from reference "
                f"to input and output for comparison{widened}"]
    if closed_loop:
        return [f"closed loop as stated, controller unknown: the simulation runs on the recorded plant input{widened}"]
    worst = leads_input(problem.train, problem.null.residual(problem.train))
    if worst > LEADS:
        return [f"the residual leads the input (correlation {worst:.2f}): the recordings look like closed loop"
                f"{widened}"]
    return []


def _coverage(problem):
    s = problem.structure
    notes = []
    for v in s.velocities():
        if s.low[v] >= 0 or s.high[v] <= 0:
            notes.append(f"{s.plant.state_names[v]} never changes sign: reversals, dry friction's asymmetry and "
                         "backlash were not tested")
    for j, name in enumerate(s.plant.input_names):
        u = problem.train.U[:, j]
        if u.size and (u.min() >= 0 or u.max() <= 0):
            notes.append(f"input {name} has one sign only: its asymmetry and dead zone were hardly tested")
    return notes
