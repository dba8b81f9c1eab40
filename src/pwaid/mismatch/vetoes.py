"""Physics vetoes: a fitted effect that cannot be what its name says."""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.floor import white_level
from pwaid.mismatch.hypotheses import Hypothesis, floor_square, mean_square, share, without
from pwaid.mismatch.lawcurve import law_over
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.thresholds import Thresholds

__all__ = ["YIELDS", "at_bound", "outside", "veto"]

YIELDS = "the recording goes far beyond the stop: it yields like a spring"
_LOAD = "its force is as good as constant: a load"
_NOT_VISITED = "the limit lies outside the visited range"

# what recordings may leave open
_LOOSE = ("stiffness", "contact_frequency", "damping", "phase", "share", "shape", "ambient", "dither")

# A stop ends a motion. What gives way by this share of half the travel, this share of the time, is a spring.
# Unless no more than this share of the error is left: a stop of rubber yields, and no spring does what it does.
# Pressed for this share of the time and so deep, it ends no motion whatever it removes: a stop at the edge or in the
# middle of the travel is a spring. Between, pressed for up to RUBBER of the time, what it leaves decides (`decide`).
_YIELDING, _PRESSED, _REST, _LEANING, _RUBBER = 1 / 3, 0.1, 0.01, 0.8, 1 / 3

# A spring whose force varies by less than this share of its mean, at a position that nothing measures, is a load.
_SPRINGS, _CONSTANT = {"linear_stiffness": 1, "quadratic_stiffness": 2, "cubic_stiffness": 3}, 0.1

# A hysteretic spring that stays strained to one side and varies by less than this share of that is a load as well.
_STRAINED = 0.2

# Bouc and Wen's law of this shape, gamma over beta plus gamma, or more gives back what it takes: a spring that softens.
_ELASTIC = 0.9

# A mode damped more than this loses its energy in one swing: what it does a damper or a lag does as well.
_NO_RESONANCE = 0.5

# A ripple of which fewer periods were travelled has not been seen to repeat: it is a bend of some other curve, unless
# it alone explains everything.
_PERIODS = 1.5

# A bent spring beside another force of the same position: where their sum departs from a straight line by less than
# this share, they are the series of something else, unless they explain everything.
_STRAIGHT, _FORCES = 0.1, {"constant_load", "position_ripple", "quadratic_stiffness", "cubic_stiffness"}

# A limit that the motion would pass in a smaller share of the samples clips nothing.
_IDLE = 0.002

# A clipped reading passes its limit by noise, at most by this share of what it would pass it by unclipped.
_SOFT = 0.03


def at_bound(h: Hypothesis, sample_time: float, tolerance: float = 1e-6) -> list[str]:
    """Names of effect parameters that ended at a bound. One of several sizes that is zero is no such case."""
    low, high = h.fit.model.bounds(sample_time)
    found, k = [], h.fit.model.np
    for e in h.located:
        for q in e.effect.quantities:
            least = abs(h.fit.theta[k] - low[k]) < tolerance and not _is_size(e, q)
            if q.name not in _LOOSE and (least or abs(h.fit.theta[k] - high[k]) < tolerance):
                found.append(q.name)
            k += 1
    return found


def _is_size(located, q) -> bool:
    """Whether the effect, or its part of that name, vanishes with this quantity."""
    first = located.effect.quantities[0]
    return q.log and (q is first or q.name.startswith(("level", "coefficient", "excess", "load_factor")))


def outside(h: Hypothesis, reach: float) -> list[str]:
    """Names of nominal parameters that had to move by more than `reach` tolerances (on the logarithmic axis)."""
    settings, n = h.fit.model.settings, h.fit.model.np
    moved = np.abs(h.fit.theta[:n]) / np.log1p(settings.tolerance)
    return [name for name, m in zip(settings.free, moved, strict=True) if m > reach]


def veto(problem: Problem, h: Hypothesis) -> str:
    """Why this hypothesis cannot stand, or an empty text."""
    k = h.fit.model.np
    for e in h.located:
        z = h.fit.theta[k:k + e.size]
        k += e.size
        values = e.physical(z)
        if not np.all(np.isfinite(values)):
            return "its parameters are not finite"
        sizes = [(q, v) for q, v in zip(e.effect.quantities, z, strict=True) if _is_size(e, q)]
        if sizes and all(v <= np.log(q.low) + 0.05 for q, v in sizes):
            return f"{' and '.join(q.name for q, _ in sizes)} went to zero"
        reason = _VETOES[e.effect.id](problem, h, e, values) if e.effect.id in _VETOES else ""
        if reason:
            return reason
    if len(h.located) > 1 and not _at_floor(problem, h) and _straight(problem, h):
        return "where the recordings go, its forces add up to a straight line: a spring with a load"
    return ""


def _spring(problem: Problem, h: Hypothesis, e, values) -> str:
    return _LOAD if _holds(problem, h, e) else ""


def _hysteretic_spring(problem: Problem, h: Hypothesis, e, values) -> str:
    if values[3] > _ELASTIC:
        return "it has no hysteresis: a spring that softens"
    return _LOAD if _as_good_as_constant(_strains(h, e), _STRAINED) else ""


def _compliance(problem: Problem, h: Hypothesis, e, values) -> str:
    if values[0] > 0.999 * e.effect.quantities[0].high:
        return "its load is as good as all of the mass: a mass, not a mode"
    return "its motion dies out within one swing: a damper or a lag, not a mode" if values[2] > _NO_RESONANCE else ""


def _ripple(problem: Problem, h: Hypothesis, e, values) -> str:
    short = values[1] * np.ptp(_positions(h, e)) < 2.0 * np.pi * _PERIODS
    excused = len(h.located) == 1 and _at_floor(problem, h)
    return "its period is nearly as long as the travel: no ripple" if short and not excused else ""


def _sensor_saturation(problem: Problem, h: Hypothesis, e, values) -> str:
    if _beyond(problem, h, e, values[0]):
        return "the recording goes beyond the limit that is said to clip it"
    return "" if _clips(problem, h, e, values[0]) else _NOT_VISITED


def _end_stop(problem: Problem, h: Hypothesis, e, values) -> str:
    if not np.any(_depths(h, e, values[1]) > 0.0):
        return "the stop lies outside the travelled range"
    all_gone = _removes_all(problem, h)
    if _yields(h, e, values[1], _LEANING if all_gone else _RUBBER):
        return f"{YIELDS} and is hardly ever left"
    return YIELDS if not all_gone and _yields(h, e, values[1], _PRESSED) else ""


def _limit(problem: Problem, h: Hypothesis, e, values) -> str:
    """A saturation or a brim whose highest value, where it has one, is that of what was visited."""
    share_of_range = (values[0] - e.origins[0]) / e.spans[0]
    return _NOT_VISITED if share_of_range >= 0.9995 and e.effect.quantities[0].high <= 1.0 else ""


_VETOES = {**dict.fromkeys(_SPRINGS, _spring), "hysteretic_spring": _hysteretic_spring, "compliance": _compliance,
           "position_ripple": _ripple, "sensor_saturation": _sensor_saturation, "end_stop": _end_stop,
           "actuator_saturation": _limit, "overflow": _limit}


def _at_floor(problem: Problem, h: Hypothesis) -> bool:
    """Whether everything is explained: what it leaves needs no excuse, in training and held out."""
    return max(h.train_error, h.test_error) <= Thresholds.near * floor_square(problem)


def _straight(problem: Problem, h: Hypothesis) -> bool:
    """Whether all its laws are forces of one position at one place, a bent spring among them and no linear one, whose
    sum is as good as straight over the visited positions."""
    ids = {e.effect.id for e in h.located}
    if not ids <= _FORCES or not ids & _SPRINGS.keys() or len({e.place.signal for e in h.located}) > 1:
        return False
    bent = next(e for e in h.located if e.effect.id in _SPRINGS)
    x = np.quantile(_positions(h, bent), np.linspace(0.0, 1.0, 200))
    name = problem.plant.state_names[bent.place.ii[5]]
    curves = [law_over(problem, h, name, x, k) for k in range(len(h.located))]
    if any(c is None for c in curves):
        return False
    force = np.sum(curves, axis=0)
    line = np.polynomial.Polynomial.fit(x, force, 1)
    return bool(np.std(force - line(x)) < _STRAIGHT * np.std(force))


def _holds(problem: Problem, h: Hypothesis, located) -> bool:
    """Whether the position is not measured, and was put so far from the spring's rest that its force hardly varies."""
    k = located.place.ii[5]
    if k in problem.structure.output_state:
        return False
    force = np.concatenate([h.fit.X[:, k], h.test.X[:, k]]) ** _SPRINGS[located.effect.id]
    return _as_good_as_constant(force, _CONSTANT)


def _as_good_as_constant(force, share: float) -> bool:
    return bool(np.std(force) < share * abs(np.mean(force)))


def _strains(h: Hypothesis, located) -> np.ndarray:
    """The simulated strain z of a hysteretic spring, training and held out."""
    model = h.fit.model
    k = model.II[model.acting.index(located), 0]
    return np.concatenate([h.fit.X[:, k], h.test.X[:, k]])


def _past(x, edge: float, side: int) -> np.ndarray:
    """How far x lies beyond an edge: above it for side 1, below for −1, outside ±edge for 0."""
    return {0: np.abs(x) - abs(edge), 1: x - edge, -1: edge - x}[side]


def _positions(h: Hypothesis, located) -> np.ndarray:
    """The simulated positions, training and held out, that a stop ends: of a body, or of one against another."""
    X, first, second = np.concatenate([h.fit.X, h.test.X]), located.place.ii[5], located.place.ii[9]
    if not located.effect.between:
        return X[:, first]
    return located.place.constants[0] * X[:, first] + located.place.constants[1] * X[:, second]


def _depths(h: Hypothesis, located, position: float) -> np.ndarray:
    """How far each of them is beyond the stop."""
    return _past(_positions(h, located), position, located.place.ii[10])


def _yields(h: Hypothesis, located, position: float, often: float) -> bool:
    """Whether the simulated position is beyond the stop for more than a share of the time, `often`, and passes it by a
    large part of half the travel."""
    depth = _depths(h, located, position)
    return bool(np.mean(depth > 0) > often and depth.max() > _YIELDING * np.ptp(_positions(h, located)) / 2)


def _removes_all(problem: Problem, h: Hypothesis) -> bool:
    """Whether no more than a hundredth of the null's error above the floor is left, in training and held out: a stop of
    rubber may be soft, a spring is not imitated so well."""
    trained = share(problem, h.train_error, mean_square(problem, problem.null, problem.train))
    return min(h.share, trained) > 1.0 - _REST


def _clips(problem: Problem, h: Hypothesis, located, limit: float) -> bool:
    """Whether the simulated output would pass the limit in more than _IDLE of the training or of the held-out samples.

    The recorded one tells nothing: a reading whose noise is clipped as well ends exactly at its limit.
    """
    k, side = located.place.ii[7], located.place.ii[10]
    return any(np.mean(_past(without(fit, located, data).Y[:, k], limit, side) > 0.0) > _IDLE
               for data, fit in ((problem.train, h.fit), (problem.test, h.test)))


def _beyond(problem: Problem, h: Hypothesis, located, limit: float) -> bool:
    """Whether the output passes the limit by more than its noise in over 1 % of some recording's samples.

    Where the simulated output passes it as well, another law moved the reading after it was clipped.
    """
    k, side = located.place.ii[7], located.place.ii[10]
    edges = ((1, abs(limit)), (-1, -abs(limit))) if side == 0 else ((side, limit),)
    for data, fit in ((problem.train, h.fit), (problem.test, h.test)):
        y, simulated = data.Y[:, k], fit.Y[:, k]
        over = [_past(y, edge, way) - np.maximum(_past(simulated, edge, way), 0.0) for way, edge in edges]
        if _often(data, y, over):
            unclipped = without(fit, located, data).Y[:, k]
            soft = [o - _SOFT * np.maximum(_past(unclipped, edge, way), 0.0)
                    for o, (way, edge) in zip(over, edges, strict=True)]
            if _often(data, y, soft):
                return True
    return False


def _often(data, y, over) -> bool:
    """Whether `over`, an array (N,) per edge, exceeds the noise of y (N,) in over 1 % of some recording."""
    most = np.max(over, axis=0)
    return any(np.mean(most[a:b] > 5.0 * white_level(y[a:b], 4) + 0.01 * np.std(y[a:b])) > 0.01
               for a, b in data.recordings)
