"""Whether what an effect leaves shows that it is not the one, or not the only one."""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.hypotheses import Hypothesis
from pwaid.mismatch.leftover import Leftover, leftover
from pwaid.mismatch.noise import fit_noise
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.pieces import holds_in_pieces
from pwaid.mismatch.predictability import predictability
from pwaid.mismatch.thresholds import Thresholds
from pwaid.mismatch.vetoes import at_bound, outside

__all__ = ["floor_or_trifle", "inadequate", "likelihood_gain", "nothing_found", "over_floor", "predicted_rest",
           "still_explained", "stretched"]


def inadequate(problem: Problem, h: Hypothesis, t: Thresholds) -> str:
    """Why what an effect leaves shows that it is not the one, or an empty text.

    The gain must be seen by likelihoods that count a slow wave once, and maps on top must not find a tenth as much. At
    the floor nothing else speaks against an effect. Above it the rest may be a disturbance; then neither maps nor the
    inputs explain it, and no parameter had to leave its tolerance or its bounds to stand in for other physics. Where
    noise is a hundredth of what is left, every simulator leaves something that maps explain: there this says that more
    is missing, not that the name is wrong, unless the maps find more than a single law itself (two laws must explain
    more of the error there, see `decide`).
    """
    gain = likelihood_gain(problem, h)
    if gain < t.evidence:
        return f"the held-out log-likelihood rose by {gain:.0f} only, once residuals are made white"
    left = over_floor(problem, h.test.Y, t)
    maps = leftover(problem, h.fit, h.test)
    found = _found(maps, gain) if maps else 0.0
    allowed = t.found if np.any(left < t.quiet) else t.found_quiet if len(h.located) == 1 else np.inf
    if found > allowed and maps.evidence > t.evidence:
        return f"maps of states and inputs on top of it raise the held-out log-likelihood by {maps.evidence:.0f}, " \
               f"itself by {gain:.0f}"
    if np.all(left < t.near):
        return ""
    reason = stretched(problem, h, t)
    if reason:
        return reason
    reason = still_explained(problem, h, t, maps, abs(found) <= t.unfound)
    return "" if reason and holds_in_pieces(problem, h, t.near, t.share) else reason


def _found(maps: Leftover, gain: float) -> float:
    """What maps add to the held-out log-likelihood, as a share of what the effect and they add; negative where they
    fit the training recordings only."""
    return maps.evidence / (gain + max(maps.evidence, 0.0))


def nothing_found(problem: Problem, h: Hypothesis, t: Thresholds) -> bool:
    """Whether maps on top of an effect find nothing, held out or in blocks of training time left out."""
    maps = leftover(problem, h.fit, h.test)
    return maps is not None and maps.validated < t.validated and _found(maps, likelihood_gain(problem, h)) < t.unfound


def stretched(problem: Problem, h: Hypothesis, t: Thresholds) -> str:
    """What speaks against an effect that is not at the floor, from its parameters and its errors."""
    left = over_floor(problem, h.test.Y, t)
    if np.all(left < t.left):
        return ""
    bound = at_bound(h, problem.train.sample_time)
    if bound:
        return f"{bound[0]} went to its bound and the error is not at the floor"
    left_tolerance = outside(h, t.reach)
    if left_tolerance:
        return f"{left_tolerance[0]} had to leave its tolerance and the error is not at the floor"
    floor = floor_or_trifle(problem, t) ** 2
    trained, null_trained = (np.mean((problem.train.Y - Y) ** 2, axis=0) / floor for Y in (h.fit.Y, problem.null.Y))
    null = over_floor(problem, problem.null_test.Y, t)
    times = left / np.maximum(trained, 1.0)
    outgrown = (times > t.outgrown) & (left > t.residue * null)
    if not np.all(trained < t.left):  # errors pile up, and held-out recordings may go farther
        outgrown &= times > t.outgrowing * np.maximum(t.outgrown, null / np.maximum(null_trained, 1.0))
    if np.any(outgrown) and not holds_in_pieces(problem, h, t.left, t.share):
        return f"on held-out recordings it leaves {np.max(times):.0f} times as much as in training"
    return ""


def still_explained(problem: Problem, h: Hypothesis, t: Thresholds, maps: Leftover | None,
                    acquitted: bool = False) -> str:
    """Whether the inputs predict, or maps of states, inputs and outputs explain, a material part of what is left.

    The null's answer does not depend on how quiet the noise is: what can be explained there is missing. `acquitted`
    says that likelihoods see nothing in what the maps remove.
    """
    left = over_floor(problem, h.test.Y, t)
    null = over_floor(problem, problem.null_test.Y, t)
    loud = left < (t.quiet if h.located else np.inf)
    rest = predicted_rest(problem, h, left, t)
    if np.any(loud & (rest * left > np.maximum(t.trace * null, t.left))):
        return f"the inputs still predict {100 * float(np.max(rest)):.0f} % of what it leaves"
    if maps is None or maps.validated < t.validated:
        return ""
    floor = floor_or_trifle(problem, t) ** 2
    before, removed = maps.before / floor, (maps.before - maps.after) / floor
    found = loud & (removed > t.mapped * np.maximum(before - 1.0, t.near - 1.0)) & (removed > t.residue * null)
    if found.any() and not acquitted:
        part = 100 * float(np.max((removed / before)[found]))
        return f"maps of states and inputs still explain {part:.0f} % of what it leaves"
    judged = loud | (len(h.located) > 1)  # two laws together claim to be all there is
    little = (t.trace if acquitted else t.residue) * null
    if maps.validated > t.certain and np.any(judged & (left > np.maximum(t.near, little))):
        return f"maps of states and inputs explain {100 * maps.validated:.0f} % of what it leaves in training"
    return ""


def floor_or_trifle(problem: Problem, t: Thresholds) -> np.ndarray:
    """The floor of each output, or a trifle of the output."""
    return np.maximum(problem.floor.level, t.trifle * np.std(problem.train.Y, axis=0))


def over_floor(problem: Problem, Y, t: Thresholds) -> np.ndarray:
    """Held-out mean square of each output relative to the floor's, or to a trifle of the output."""
    return np.mean((problem.test.Y - Y) ** 2, axis=0) / floor_or_trifle(problem, t) ** 2


def predicted_rest(problem: Problem, h: Hypothesis, left, t: Thresholds) -> np.ndarray:
    """Share of each output's rest that follows from the inputs; 0 where it is small or the error at the floor."""
    rest = predictability(problem.train, h.fit, problem.test, h.test, problem.structure.time_scale)
    return np.where((left >= t.left) & (rest > t.left_predicted), rest, 0.0)


def likelihood_gain(problem: Problem, h: Hypothesis, over: Hypothesis | None = None) -> float:
    """Held-out log-likelihood of h over another one (the null), both under the noise model of what h leaves in
    training."""
    noise = fit_noise(problem.train.Y - h.fit.Y, problem.train.segments)
    other = problem.null_test.Y if over is None else over.test.Y
    before = noise.innovations(problem.test.Y - other, problem.test.segments)
    after = noise.innovations(problem.test.Y - h.test.Y, problem.test.segments)
    return 0.5 * float(np.sum(before**2) - np.sum(after**2))
