"""What to record next: the input under which the two leading hypotheses predict the most different outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.decide import Decision
from pwaid.mismatch.effects.registry import CATALOGUE
from pwaid.mismatch.fit import fit_model
from pwaid.mismatch.hypotheses import Hypothesis, hypothesis_of
from pwaid.mismatch.inputs import Proposal, proposals
from pwaid.mismatch.isolability import ALIKE, Isolability, nested, window
from pwaid.mismatch.model import Model
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.refit import Refitter, noise_of, times_noise
from pwaid.mismatch.screen import Screened
from pwaid.mismatch.summary import number

__all__ = ["Experiment", "next_experiment", "plan_experiment", "rivals"]

FINALISTS = 3
SAFE = 1.5  # a predicted output may leave the recorded range by this factor of it
SLOW_SAMPLES = 300
ITERATIONS = 6


@dataclass(frozen=True)
class Experiment:
    """The chosen input and what the two hypotheses predict under it.

    `predicted` and `present`: RMS difference of the predictions over the noise floor, the second hypothesis
    refitted to the first, under the input and in the present recordings. `time` (N,), `first` and `second` (N, ny):
    both predictions, the second refitted.
    """

    proposal: Proposal
    pair: tuple[Hypothesis, Hypothesis]
    predicted: float
    present: float
    ranking: tuple[tuple[str, float], ...]
    time: np.ndarray = field(repr=False)
    first: np.ndarray = field(repr=False)
    second: np.ndarray = field(repr=False)

    def table(self) -> dict:
        """What report.json holds."""
        p = self.proposal
        return {"input": p.words, "kind": p.kind, "signal": p.signal, "amplitude": p.amplitude, "period_s": p.period,
                "duration_s": p.duration, "between": [h.label for h in self.pair],
                "predicted_difference": self.predicted, "present_difference": self.present,
                "others": [{"input": words, "predicted_difference": d} for words, d in self.ranking]}


def rivals(problem: Problem, null: Hypothesis, decision: Decision, others: Sequence[Hypothesis],
           screened: Sequence[Screened] = ()) -> tuple[Hypothesis, Hypothesis] | None:
    """The two hypotheses that the next experiment should separate.

    The first two members of a set; the named one and its best rival of another law, fitted briefly from the screen
    where only laws that contain the named one were fitted; else null and best candidate.
    """
    if len(decision.members) > 1:
        return decision.members[0], decision.members[1]
    ranked = sorted((h for h in others if np.all(np.isfinite(h.fit.Y))), key=lambda h: h.train_error + h.test_error)
    if decision.members:
        best = decision.members[0]
        rival = next((h for h in ranked if not nested(h, best)), None)
        return best, rival or _screened_rival(problem, null, best, screened) or null
    return (ranked[0], null) if ranked else None


def _screened_rival(problem: Problem, null: Hypothesis, best: Hypothesis, screened) -> Hypothesis | None:
    """The best screened law that neither contains nor completes the named one, in the place of its last law."""
    if problem.plant.rhs is None:
        return None
    kept = best.located[:-1]
    for s in screened:
        e = s.located
        taken = {(b.effect.id, b.place.channel) for b in best.located}
        wider = any(b.effect.id in e.effect.contains or e.effect.id in b.effect.contains for b in best.located)
        if s.score > 0 and not wider and (e.effect.id, e.place.channel) not in taken and s.starts:
            model = Model(problem.settings, (*kept, e))
            held = best.fit.theta[null.fit.model.np:null.fit.model.np + sum(b.size for b in kept)]
            theta = np.concatenate([null.fit.theta[:null.fit.model.np], held, s.starts[0]])
            fit = fit_model(model, problem.train, problem.sigma, theta, null.fit.X0, problem.ranges, ITERATIONS, 1e-2)
            rival = hypothesis_of(problem, fit, s.score)
            return rival if rival.train_error < null.train_error else None  # a fit gone astray tells nothing
    return None


def _combined(data: Dataset, U: np.ndarray, ny: int) -> Dataset:
    """The data followed by a new recording with input U."""
    n, m = len(data.U), len(U)
    row = np.array([[n, n + m, n, n + m]], dtype=np.int64)
    return replace(data, names=(*data.names, "proposed"), U=np.ascontiguousarray(np.vstack([data.U, U])),
                   Y=np.ascontiguousarray(np.vstack([data.Y, np.zeros((m, ny))])),
                   segments=np.vstack([data.segments, row]))


def _alone(data: Dataset, U: np.ndarray, ny: int) -> Dataset:
    m = len(U)
    return replace(data, names=("proposed",), U=U, Y=np.zeros((m, ny)),
                   segments=np.array([[0, m, 0, m]], dtype=np.int64))


def _start(pair) -> np.ndarray:
    """The start state both predictions share: where the first recording began."""
    return pair[0].fit.X0[:1, :pair[0].fit.model.nx].copy()


def _inside(problem: Problem, Y) -> bool:
    low, high = problem.train.Y.min(axis=0), problem.train.Y.max(axis=0)
    reach = (SAFE - 1) * (high - low)
    return bool(np.all(np.isfinite(Y)) and np.all(low - reach <= Y) and np.all(high + reach >= Y))


def plan_experiment(problem: Problem, pair: tuple[Hypothesis, Hypothesis], units: Sequence[str],
                    known: Isolability | None = None) -> Experiment | None:
    """Simulate both hypotheses under every candidate input and keep the one that separates them best.

    Inputs that drive a prediction out of 1.5 times the recorded range of an output are left out. The best few are
    compared after refitting the second hypothesis to the present recordings and the new one together, as it would
    be once the new one is there. None when no input is left.
    """
    noise, train, ny = noise_of(problem), problem.train, problem.train.Y.shape[1]
    slow = problem.plant.rhs is None
    tried = []
    for p in proposals(train, problem.plant.input_names, units, *([SLOW_SAMPLES] if slow else [])):
        data = _alone(train, p.U, ny)
        Y = [h.fit.model.simulate(h.fit.theta, _start(pair), data)[0] for h in pair]
        if all(_inside(problem, y) for y in Y):
            tried.append((times_noise(*Y, noise), p, Y))
    if not tried:
        return None
    tried.sort(key=lambda item: -item[0])
    if slow:
        raw, best, Y = tried[0]
        return Experiment(best, pair, raw, times_noise(pair[0].fit.Y, pair[1].fit.Y, noise),
                          tuple((p.words, d) for d, p, _ in tried[1:4]), _clock(best, train), *Y)
    finals = []
    short, rows = window(problem, pair)
    starts = np.vstack([pair[1].fit.X0[:len(short.segments)], pair[1].fit.model.opened(_start(pair))])
    for _, p, (first, _) in tried[:FINALISTS]:
        second = Refitter(pair[1], _combined(short, p.U, ny), starts, noise, problem.ranges, known=1)
        predicted = second.refit(np.vstack([pair[0].fit.Y[rows], first]))[len(rows):]
        finals.append((times_noise(first, predicted, noise), p, first, predicted))
    finals.sort(key=lambda item: -item[0])
    best, present = finals[0], _present(problem, pair, noise, known)
    return Experiment(best[1], pair, best[0], present, tuple((p.words, d) for d, p, *_ in finals[1:]),
                      _clock(best[1], train), best[2], best[3])


def _clock(p: Proposal, data: Dataset) -> np.ndarray:
    return np.arange(len(p.U)) * data.sample_time


def _present(problem, pair, noise, known: Isolability | None) -> float:
    """The difference in the present recordings, the second hypothesis refitted to the first."""
    if known is not None and all(any(h is k for k in known.hypotheses) for h in pair):
        i, j = (next(n for n, k in enumerate(known.hypotheses) if k is h) for h in pair)
        return float(np.sqrt(max(known.matrix[i, j] ** 2 - 1.0, 0.0)))
    short, rows = window(problem, pair)
    first, second = pair[0].fit.Y[rows], pair[1]
    refitted = Refitter(second, short, second.fit.X0[:len(short.segments)], noise, problem.ranges).refit(first)
    return times_noise(first, refitted, noise)


def _reason(decision: Decision) -> str:
    """What the catalogue says separates the effects in question."""
    by_id = {e.id: e for e in CATALOGUE}
    if decision.verdict == "one_of":
        a, b = decision.members[0].located[0].effect, decision.members[1].located[0].effect
        text = a.separated_by if b.id in a.confused_with or not b.separated_by else b.separated_by
        return f"To separate {a.id} from {b.id}: {text}."
    if decision.verdict == "named":
        effect = decision.chosen.located[0].effect
        names = [r for r in effect.confused_with if r in by_id][:2]
        excluded = f" (excludes {', '.join(names)})" if names else ""
        return f"To be surer of {effect.id}{excluded}: {effect.separated_by}."
    if decision.verdict == "unexplained":
        return ("Repeat one recording unchanged: a mismatch that does not repeat is a disturbance, one that does is "
                "physics outside the catalogue. Then the same input at half and at double amplitude.")
    return "Record at other amplitudes and speeds than these: an effect never excited cannot be seen."


def _times(x: float) -> str:
    return "over 1000" if x > 1000 else f"{x:.0f}" if x >= 10 else f"{x:.1f}"


def _proposal(plan: Experiment) -> str:
    """The planned input in words."""
    a, b = (h.label for h in plan.pair)
    if plan.predicted < ALIKE:
        return (f"No input within the recorded range separates {a} from {b} (the best, {plan.proposal.words}: "
                f"{_times(plan.predicted)} times the noise); go beyond the range or lower the noise.")
    return (f"Best of the inputs simulated, within the recorded range: {plan.proposal.words}, "
            f"{number(plan.proposal.duration)} s long: the predictions of {a} and {b} would differ by "
            f"{_times(plan.predicted)} times the noise; in the present recordings {_times(plan.present)} times.")


def next_experiment(problem: Problem, decision: Decision, plan: Experiment | None) -> str:
    """The experiment that would settle what these recordings leave open, in words."""
    repeat = "" if problem.floor.trusted else " Record one input twice: repeats fix the noise floor."
    return f"{_reason(decision)}{'' if plan is None else ' ' + _proposal(plan)}{repeat}"
