"""Where a law may act between two bodies: on what turns or moves one against the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwaid.mismatch.effects.base import Place
from pwaid.mismatch.shafts import counted, coupled, twisted_by
from pwaid.mismatch.structure import SIDES, Structure, side_span, two_terms

__all__ = ["struts"]


@dataclass(frozen=True)
class _Joint:
    """Two coupled bodies a, b (their speeds): weights of two positions in their relative position, of their speeds in
    its rate, and what a unit of the relative force adds to the force on either; `side` is the body that counts as it
    is, not by a gear; `shown` the output that shows the relative position, where that is why it is looked at."""

    a: int
    b: int
    positions: tuple[int, int]
    weights: tuple[float, float]
    rates: tuple[float, float]
    forces: tuple[float, float]
    side: int
    shown: str = ""


def struts(s: Structure, sides: bool = False) -> list[Place]:
    """Every pair of bodies that a spring of the simulator couples, and every pair of motions that an output shows
    together, as heave and pitch of a car at one wheel; one per side of its rest for stops.

    The constants are weights: of two positions in the relative one, of two speeds in its rate, and of the relative
    force in the forces on both bodies.
    """
    places = []
    for joint in _joints(s):
        z = s.visited[:, joint.positions] @ np.array(joint.weights)
        rate = s.visited[:, [joint.a, joint.b]] @ np.array(joint.rates)
        reach, speed = (max(float(np.max(np.abs(v))), 1e-12) for v in (z, rate))
        mode, target, inertia = s.entry[joint.b]
        names = [s.plant.state_names[i] for i in dict.fromkeys(joint.positions)]
        low, high = float(z.min()), float(z.max())
        for side in (0, 1, -1) if sides else (0,):
            ii = s.force_ii(joint.a)
            ii[5], ii[9], ii[6], ii[7], ii[8], ii[10], ii[11] = *joint.positions, joint.b, mode, target, side, inertia
            places.append(s.place(
                "state", joint.shown or "-".join(names), names, ii, v=joint.a, x=joint.positions[0],
                scales={"position": reach, "speed": speed,
                        "force": s.force_scale.get(joint.a, 1.0) / abs(joint.forces[0])},
                units=_units(s, joint), levels={"position": side_span(side, low, high)},
                constants=(*joint.weights, *joint.rates, *joint.forces),
                note=SIDES[side] if sides else ""))
    return places


def _units(s: Structure, joint: _Joint) -> dict[str, dict]:
    """Units of the relative position, its rate and the relative force: those of the body that counts as it is. A force
    that neither body feels as it is has none, nor one per inertia of one body in those of another."""
    on_a, on_b = (abs(abs(w) - 1.0) < 1e-6 for w in joint.forces)
    known = _has_inertia(s, joint.a) and _has_inertia(s, joint.b)
    force = s.force_units.get(joint.a, {}) if on_a else s.force_units.get(joint.b, {}) if on_b and known else {}
    position = joint.positions[int(joint.side == joint.b)]
    return {"position": s.state_units[position], "speed": s.state_units[joint.side], "force": force}


def _has_inertia(s: Structure, v: int) -> bool:
    """Whether a force on a speed enters as one: through an input, or over an inertia that is a parameter."""
    mode, _, inertia = s.entry[v]
    return mode != 1 or inertia >= 0


def _joints(s: Structure) -> list[_Joint]:
    """The coupled pairs of bodies: two positions with a spring between them, or a state that is their twist; and what
    outputs show of two motions together."""
    found = [_joint(s, a, b, gear) for a, b, gear in coupled(s)]
    found += [j for j in (_by_twist(s, z) for z in range(len(s.kinds))) if j is not None]
    shown = [j for j in (_by_output(s, k) for k in range(len(s.plant.output_names))) if j is not None]
    return found + [j for j in shown if not any(_same(j, other) for other in found)]


def _same(one: _Joint, other: _Joint) -> bool:
    """Whether both are the same relative position, but for its scale."""
    if set(one.positions) != set(other.positions) or one.positions[0] == one.positions[1]:
        return False
    weights = other.weights if one.positions == other.positions else other.weights[::-1]
    return abs(one.weights[0] * weights[1] - one.weights[1] * weights[0]) < 1e-6 * abs(one.weights[1] * weights[0])


def _by_output(s: Structure, k: int) -> _Joint | None:
    """The two motions that an output shows as a fixed sum, a force on which acts on both in that proportion (virtual
    work); None where it shows another number of states, or where a body's inertia is not known."""
    if s.plant.black_box is not None or not len(s.partner):
        return None
    points = s.points(4 + len(s.partner))
    X, still = np.array([x for x, _ in points]), points[0][1]
    y = np.array([s.plant.outputs(x, still)[k] for x in X])
    found = two_terms(X[1:] - X[0], y[1:] - y[0])  # an output may have an offset
    if found is None or any(s.partner[i] < 0 for i in found[0]):
        return None
    shown, weights = [int(i) for i in found[0]], found[1]
    bodies = [int(s.partner[i]) for i in shown]
    if not all(v in s.entry and _has_inertia(s, v) for v in bodies):
        return None
    ratio = float(weights[1] / weights[0])
    rates = float(s.ratio[shown[0]]), ratio * float(s.ratio[shown[1]])
    return _Joint(*bodies, tuple(shown), (1.0, ratio), rates, rates, bodies[0], s.plant.output_names[k])


def _joint(s: Structure, a: int, b: int, gear: float) -> _Joint:
    xa, xb = s.position_of(a), s.position_of(b)
    x, u = s.points(1)[0]
    on_a, on_b = s.slope(a, xb, x, u) / s.mobility[a], s.slope(b, xa, x, u) / s.mobility[b]
    return _Joint(a, b, (xa, xb), (1.0 / gear, -1.0), (float(s.ratio[xa]) / gear, -float(s.ratio[xb])),
                  (1.0 / gear, -on_b / on_a), b)


def _by_twist(s: Structure, z: int) -> _Joint | None:
    """The joint of two bodies whose twist is the state z, where that drives both."""
    pair = twisted_by(s, z)
    if pair is None:
        return None
    (a, b), rates = pair
    x, u = s.points(1)[0]
    on_a, on_b = s.slope(a, z, x, u) / s.mobility[a], s.slope(b, z, x, u) / s.mobility[b]
    if on_a == 0.0 or on_b == 0.0:
        return None
    return _Joint(a, b, (z, z), (1.0, 0.0), rates, (rates[0], rates[0] * on_b / on_a), counted(a, b, rates))
