"""Where two bodies are joined by a shaft, or one body may hide another."""

from __future__ import annotations

import itertools

import numpy as np

from pwaid.mismatch.effects.base import Place
from pwaid.mismatch.structure import Structure, two_terms

__all__ = ["coupled", "shafts", "single_masses", "twisted_by", "twists"]


def shafts(s: Structure) -> list[Place]:
    """Pairs of positions joined by a spring."""
    places = []
    for a, b, gear in coupled(s):
        xa, xb = s.position_of(a), s.position_of(b)
        ii = s.force_ii(a)
        ii[5], ii[9], ii[6] = xa, xb, b
        twist = max(abs(_twist(s, xa, xb, gear)), 1e-12)
        names = [s.plant.state_names[xa], s.plant.state_names[xb]]
        constants = (gear, float(s.ratio[xb]), float(s.ratio[xa]),
                     *_damped(s, a, b, s.ratio[xa] / gear, -s.ratio[xb]))
        places.append(s.place("state", "-".join(names), names, ii, v=a, x=xa, scales={"position": twist},
                              constants=constants, units={"position": s.state_units[xb]}))
    return places


def coupled(s: Structure) -> list[tuple[int, int, float]]:
    """Pairs of speeds a, b whose positions a spring joins, and its gear: the force follows x_a / gear - x_b, which has
    the unit of x_b."""
    vs = [v for v in s.velocities() if s.position_of(v) >= 0]
    found = ((a, b, _gear(s, a, b)) for a, b in itertools.combinations(vs, 2))
    return [(a, b, gear) for a, b, gear in found if gear is not None]


def twists(s: Structure) -> list[Place]:
    """States that are the twist of a shaft between two speeds, and drive one of them."""
    places = []
    for z in range(len(s.kinds)):
        pair = twisted_by(s, z)
        if pair is None or not any(abs(s.slope(v, z, *s.points(1)[0])) > 0 for v in pair[0]):
            continue
        (a, b), weights = pair
        ii = s.force_ii(a)
        ii[4], ii[5], ii[6] = a, z, b
        places.append(s.place("state", s.plant.state_names[z], [s.plant.state_names[z]], ii, v=a,
                              scales={"position": s.reach(z)}, constants=(*weights, *_damped(s, a, b, *weights)),
                              units={"position": _travel(s, counted(a, b, weights))}))
    return places


def counted(a: int, b: int, weights) -> int:
    """The one of two speeds that counts as it is, not by a gear, in what turns or moves one against the other; a where
    both do. What acts there has its units."""
    off_a, off_b = (abs(abs(w) - 1.0) for w in weights)
    return a if off_a <= off_b else b


def single_masses(s: Structure) -> list[Place]:
    """A speed whose inertia may hide a load behind a shaft, measured on either side."""
    places = []
    if shafts(s):
        return places
    for v in s.velocities():
        ii, x = s.force_ii(v), s.position_of(v)
        # a shaft that turns on and on has gaps of the size it moves in a time constant, not of its whole travel
        near = s.reach(v) * s.time_scale
        speed, position = s.plant.state_names[v], s.plant.state_names[x if x >= 0 else v]
        more = {"scales": {"position": min(s.reach(x), near) if x >= 0 else near},
                "units": {} if x >= 0 else {"position": _travel(s, v)}}
        places.append(s.place("state", speed, [position], ii, v=v, x=x, constants=(1.0,), note="motor side measured",
                              **more))
        for k, state in enumerate(s.output_state):
            if state in {x, v} - {-1}:
                jj = list(ii)
                jj[7], jj[10], jj[11] = k, 1, int(state == v)
                places.append(s.place("state", speed, [position], jj, v=v, x=x, constants=(s.shown.gain[k],),
                                      note="load side measured", **more))
    return places


def _travel(s: Structure, v: int) -> dict:
    """Unit of what a speed moves through."""
    unit = {**s.state_units[v], "s": s.state_units[v].get("s", 0) + 1}
    return {symbol: n for symbol, n in unit.items() if n}


def _damped(s: Structure, a: int, b: int, weight_a: float, weight_b: float) -> tuple[float, float]:
    """Accelerations of two speeds per twist speed, weight_a * v_a + weight_b * v_b, by damping in their shaft."""
    point = s.points(1)[0]
    return s.slope(a, b, *point) / weight_b, s.slope(b, a, *point) / weight_a


def twisted_by(s: Structure, z: int) -> tuple[tuple[int, int], tuple[float, float]] | None:
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


def _gear(s: Structure, a: int, b: int) -> float | None:
    """The gear between two bodies; None where no spring joins them.

    Alone on their spring, both show it. With a spring to the ground as well, one of them does, or, in one unit and
    without a gear, the forces that they exert on each other are equal.
    """
    xa, xb = s.position_of(a), s.position_of(b)
    slopes = np.array([[[s.slope(v, z, x, u) for z in (xa, xb)] for v in (a, b)] for x, u in s.points(6)])
    if np.any(slopes[:, [0, 1], [1, 0]] == 0.0):
        return None
    own_a, own_b = _steady(-slopes[:, 0, 1] / slopes[:, 0, 0]), _steady(-slopes[:, 1, 1] / slopes[:, 1, 0])
    known = [g for g in (own_a, own_b) if g is not None]
    if len(known) == 2 and abs(own_a - own_b) < 1e-3 * own_a:
        return own_b
    if s.state_units[xa] == s.state_units[xb] and own_a is not None and own_b is not None and own_a <= 1.001 \
            and own_b >= 0.999:
        return 1.0  # any other gear would need a ground that pulls away
    return known[-1] if known else None


def _steady(ratios) -> float | None:
    """The mean of ratios that are positive and the same everywhere; None where they are not."""
    if not np.all(np.isfinite(ratios)) or np.ptp(ratios) > 1e-3 * abs(ratios.mean()) or ratios.mean() <= 0:
        return None
    return float(ratios.mean())


def _twist(s: Structure, xa: int, xb: int, gear: float) -> float:
    return min(s.reach(xa) / abs(gear), s.reach(xb))
