"""A fitted law as a curve over one variable, for pictures."""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.hypotheses import Hypothesis
from pwaid.mismatch.nullfit import Problem

__all__ = ["law_over"]


def law_over(problem: Problem, hypothesis: Hypothesis, variable: str, z: np.ndarray, index: int = 0
             ) -> np.ndarray | None:
    """What one of the effects adds, as a force or a change of its input, with `variable` at z and all else zero.

    None for laws with memory, for sensors, for laws between two bodies, and for variables that are neither state nor
    input.
    """
    plant, located = problem.plant, hypothesis.located[index]
    names = (*plant.state_names, *plant.input_names)
    if located.effect.extra_states or located.effect.delays or located.place.kind not in ("state", "input"):
        return None
    if variable not in names or located.effect.between:
        return None
    nx, nu, _ = plant.sizes
    ii, values = np.array(located.place.ii), hypothesis.values()[index]
    q, p = np.concatenate([values, located.place.constants]), hypothesis.fit.model.parameters(hypothesis.fit.theta)
    at, out = names.index(variable), np.empty(len(z))
    kernel, mobility = located.effect.compiled(), problem.structure.mobility.get(int(ii[2]), 1.0)
    for k, value in enumerate(z):
        x, u, dx = np.zeros(nx), np.zeros(nu), np.zeros(nx)
        (x if at < nx else u)[at if at < nx else at - nx] = value
        before, slid = u.copy(), np.zeros(nx)
        kernel(1, 0.0, 0.0, x, x, u, p, dx, ii, q)
        kernel(2, 0.0, 0.0, x, x, u, p, dx, ii, q)
        if located.effect.proximal:
            column = np.zeros(nx)
            column[ii[4]] = np.sign(x[ii[4]])  # friction then comes out as a force
            kernel(5, 0.0, 0.0, x, column, u, p, slid, ii, q)
        out[k] = (-1.0 if ii[1] == 2 else 1.0) * np.sum(u - before) + np.sum(dx) / mobility + np.sum(slid)
    return out if np.all(np.isfinite(out)) else None
