"""The fallback: the learned curve of one variable put into the simulator, labelled as unnamed.

It repairs the simulation where no entry of the catalogue does, and says nothing about physics.
"""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.effects.base import Effect, Place, Quantity
from pwaid.mismatch.fit import fit_model
from pwaid.mismatch.hypotheses import Hypothesis, hypothesis_of
from pwaid.mismatch.locate import Location
from pwaid.mismatch.model import Located, Model
from pwaid.mismatch.nullfit import Problem

__all__ = ["CORRECTION", "correct"]


def curve(phase, t, h, x, xs, u, p, dx, ii, q):
    """F = gain * c(z), c piecewise affine on a uniform grid: q = gain, low, high, n, c[0..n-1]; z a state or input."""
    if (ii[1] == 0 and phase == 1) or (ii[1] == 1 and phase == 2):
        z = u[ii[8]] if ii[10] == 1 else x[ii[4]]
        n = int(q[3])
        r = min(max((z - q[1]) / (q[2] - q[1]), 0.0), 1.0) * (n - 1)
        k = min(int(r), n - 2)
        force = q[0] * (q[4 + k] + (r - k) * (q[5 + k] - q[4 + k]))
        if ii[1] == 0:
            u[ii[2]] += force
        else:
            dx[ii[2]] += force


CORRECTION = Effect("pwa_correction", "unnamed", "F = gain * c(variable), c learned: a fallback without a name",
                    (Quantity("gain", "1", -3.0, 3.0, (1.0,), log=False),), curve, lambda structure: [])


def curve_place(kind: str, target: int, variable: int, of_input: bool, knots, values, signal: str = "",
                variables: tuple[str, ...] = ()) -> Place:
    """Where a curve enters and what it reads.

    Parameters
    ----------
    kind : "input" or "state"; target : the input, or the state whose derivative it enters, there `values` (n,) of its
        uniform `knots` (n,) are in the derivative's unit. variable : the state it reads, or the input (`of_input`).
    """
    ii = [0, int(kind == "state"), target, -1, -1, -1, -1, -1, -1, -1, 0, 0]
    if of_input:
        ii[8], ii[10] = variable, 1
    else:
        ii[4] = variable
    constants = (float(knots[0]), float(knots[-1]), float(len(knots)), *map(float, values))
    return Place(kind, signal, variables, tuple(ii), {}, {}, constants)


def _place(problem: Problem, location: Location) -> Place | None:
    """Where the curve of a location enters; None for a curve over time or a rate."""
    plant, shape = problem.plant, location.shape
    kind, _, signal = location.channel.partition(":")
    of_input = shape.variable in plant.input_names
    if not of_input and shape.variable not in plant.state_names:
        return None
    if kind == "state":
        target = plant.state_names.index(signal)
        factor = problem.structure.mobility.get(target, 1.0)
    else:
        kind, target, factor = "input", plant.input_names.index(signal), 1.0
    names = plant.input_names if of_input else plant.state_names
    return curve_place(kind, target, names.index(shape.variable), of_input, shape.curve.knots,
                       factor * shape.curve.values, signal, (shape.variable,))


def correct(problem: Problem, location: Location) -> Hypothesis | None:
    """The refitted simulator with the learned curve inside, scaled by simulation error; None without a curve."""
    if location.shape is None or location.shape.curve is None:
        return None
    place = _place(problem, location)
    if place is None:
        return None
    model = Model(problem.settings, (Located(CORRECTION, place),))
    theta = np.append(problem.null.theta, 1.0)
    fit = fit_model(model, problem.train, problem.sigma, theta, problem.null.X0, problem.ranges, 15, 3e-4)
    return hypothesis_of(problem, fit, 0.0)
