"""Where two bodies are joined by a shaft, or one body may hide another."""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.effects.base import Place
from pwaid.mismatch.structure import Structure, two_terms

__all__ = ["shafts", "single_masses", "twists"]


def shafts(s: Structure) -> list[Place]:
    """Pairs of positions joined by a stiff spring: one depends on the other's difference only."""
    places = []
    vs = [v for v in s.velocities() if s.position_of(v) >= 0]
    for a in vs:
        for b in vs:
            if a == b:
                continue
            xa, xb = s.position_of(a), s.position_of(b)
            gear = _shaft_ratio(s, a, b, xa, xb)
            if gear is None or (a > b and _shaft_ratio(s, b, a, xb, xa) is not None):
                continue
            ii = s.force_ii(a)
            ii[5], ii[9], ii[6] = xa, xb, b
            twist = max(abs(_twist(s, xa, xb, gear)), 1e-12)
            names = [s.plant.state_names[xa], s.plant.state_names[xb]]
            constants = (gear, float(s.ratio[xb]), float(s.ratio[xa]),
                         *_damped(s, a, b, s.ratio[xa] / gear, -s.ratio[xb]))
            places.append(s.place("state", "-".join(names), names, ii, v=a, x=xa, scales={"position": twist},
                                  constants=constants))
    return places


def twists(s: Structure) -> list[Place]:
    """States that are the twist of a shaft between two speeds, and drive one of them."""
    places = []
    for z in range(len(s.kinds)):
        pair = _twisted_by(s, z)
        if pair is None or not any(abs(s.slope(v, z, *s.points(1)[0])) > 0 for v in pair[0]):
            continue
        (a, b), weights = pair
        ii = s.force_ii(a)
        ii[4], ii[5], ii[6] = a, z, b
        unit = {**s.state_units[a], "s": s.state_units[a].get("s", 0) + 1}
        places.append(s.place("state", s.plant.state_names[z], [s.plant.state_names[z]], ii, v=a,
                              scales={"position": s.reach(z)}, constants=(*weights, *_damped(s, a, b, *weights)),
                              units={"position": {symbol: n for symbol, n in unit.items() if n}}))
    return places


def single_masses(s: Structure) -> list[Place]:
    """A speed whose inertia may hide a load behind a shaft, measured on either side."""
    places = []
    if shafts(s):
        return places
    for v in s.velocities():
        x = s.position_of(v)
        if x < 0:
            continue
        ii = s.force_ii(v)
        # a shaft that turns on and on has gaps of the size it moves in a time constant, not of its whole travel
        near = {"position": min(s.reach(x), s.reach(v) * s.time_scale)}
        speed, position = s.plant.state_names[v], s.plant.state_names[x]
        places.append(s.place("state", speed, [position], ii, v=v, x=x, constants=(1.0,), scales=near,
                              note="motor side measured"))
        for k, state in enumerate(s.output_state):
            if state in (x, v):
                jj = list(ii)
                jj[7], jj[10], jj[11] = k, 1, int(state == v)
                places.append(s.place("state", speed, [position], jj, v=v, x=x, constants=(s.shown.gain[k],),
                                      scales=near, note="load side measured"))
    return places


def _damped(s: Structure, a: int, b: int, weight_a: float, weight_b: float) -> tuple[float, float]:
    """Accelerations of two speeds per twist speed, weight_a * v_a + weight_b * v_b, by damping in their shaft."""
    point = s.points(1)[0]
    return s.slope(a, b, *point) / weight_b, s.slope(b, a, *point) / weight_a


def _twisted_by(s: Structure, z: int) -> tuple[tuple[int, int], tuple[float, float]] | None:
    """The two speeds, and their weights, of which the rate of this state is the difference; None if it is none."""
    vs = s.velocities()
    if s.kinds[z] in ("velocity", "position") or len(vs) < 2:
        return None
    points = s.points(4 + len(vs))
    rates = np.array([s.plant.derivative(x, u)[z] for x, u in points])
    speeds = np.array([x[vs] for x, _ in points])
    found = two_terms(speeds, rates)
    if found is None or np.prod(found[1]) >= 0:
        return None
    (a, b), weights = found
    return (vs[a], vs[b]), (float(weights[0]), float(weights[1]))


def _shaft_ratio(s: Structure, a, b, xa, xb):
    ratios = []
    for x, u in s.points(6):
        ja = s.slope(a, xa, x, u), s.slope(a, xb, x, u)
        jb = s.slope(b, xa, x, u), s.slope(b, xb, x, u)
        if not (abs(ja[1]) > 0 and abs(jb[0]) > 0 and abs(jb[1]) > 0):
            return None
        ratios.append(-jb[1] / jb[0])
    ratios = np.array(ratios)
    if np.ptp(ratios) > 1e-3 * abs(ratios.mean()) or ratios.mean() <= 0:
        return None
    return float(ratios.mean())


def _twist(s: Structure, xa: int, xb: int, gear: float) -> float:
    return min(s.reach(xa) / abs(gear), s.reach(xb))
