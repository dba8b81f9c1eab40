"""Where a parameter is the conductance of a linear outlet, and what head drives it."""

from __future__ import annotations

import itertools

import numpy as np

from pwaid.mismatch.effects.base import Place
from pwaid.mismatch.structure import Structure

__all__ = ["outlets"]

STEP = 1e-4  # relative change of a parameter


def outlets(s: Structure) -> list[Place]:
    """A place for every parameter k that acts as the flow k*h or k*(h - h2) out of a store, wherever that flow goes.

    The derivative of every rate by such a parameter is proportional to the head, whatever the inputs are.
    """
    stores = [i for i, k in enumerate(s.kinds) if k in ("fluid", "store")]
    if not stores or s.plant.black_box is not None or s.plant.dt:
        return []
    points, p = s.points(12), s.plant.vector()
    X = np.array([x for x, _ in points])
    heads = [(i, -1) for i in stores] + list(itertools.combinations(stores, 2))
    places = []
    for n, name in enumerate(s.plant.parameters):
        if name not in s.free or p[n] == 0.0:
            continue
        more, less = p.copy(), p.copy()
        more[n] *= 1 + STEP
        less[n] *= 1 - STEP
        change = np.array([s.plant.derivative(x, u, more) - s.plant.derivative(x, u, less) for x, u in points])
        size = np.max(np.abs(change), axis=0)
        for i, j in heads:
            head = X[:, i] - (X[:, j] if j >= 0 else 0.0)
            gain = head @ change / (head @ head)
            if np.allclose(change, np.outer(head, gain), rtol=1e-5, atol=1e-7 * float(size.max())) and gain[i] < 0.0:
                places.append(_place(s, i, j, n, name))
    return places


def _place(s: Structure, i: int, j: int, n: int, name: str) -> Place:
    names = s.plant.state_names
    of = [names[i]] + ([names[j]] if j >= 0 else [])
    return Place("state", names[i], tuple(of), (0, 0, i, n, i, -1, j, -1, -1, -1, 0, 0),
                 {"position": s.reach(i), "time": s.time_scale}, {"position": s.state_units[i], "time": {"s": 1}},
                 note=f"through {name}")
