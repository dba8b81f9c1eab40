"""Balanced realisations (Moore 1981) with their transformation, coherent signs and order, and averages of
models.

Square-root method: with gramians Wc = L L' and Wo = R R', the singular values of R' L are the Hankel singular
values, and x = T x_balanced with T = L V S^(-1/2), T^-1 = S^(-1/2) U' R'.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import control
import numpy as np
import scipy.linalg
import scipy.optimize

from pwaid.errors import InputError
from pwaid.hinfstruct.statespace import Matrices, as_matrices, freeze, to_control

__all__ = ["Balanced", "align_models", "average_models", "balance"]


@dataclass(frozen=True)
class Balanced:
    """A balanced realisation.

    Attributes
    ----------
    system : control.StateSpace
    T, T_inverse : arrays, shapes (n, order) and (order, n)
        ``x = T x_balanced``; T_inverse T = I.
    hankel : array, shape (n,)
        All Hankel singular values, decreasing; those after ``order`` were truncated.
    """

    system: control.StateSpace
    T: np.ndarray
    T_inverse: np.ndarray
    hankel: np.ndarray

    def __post_init__(self):
        freeze(self)

    @property
    def truncation_bound(self) -> float:
        """Bound of the H-infinity error of the truncation: twice the sum of the truncated Hankel values."""
        return float(2 * self.hankel[self.system.nstates :].sum())


def balance(system, *, order: int | None = None) -> Balanced:
    """Balance a stable continuous or discrete system, and truncate it to ``order`` states if given.

    Raises
    ------
    InputError
        Unstable, not minimal (a Hankel singular value vanishes: name a smaller order), or a bad order.
    """
    m = as_matrices(system)
    if not m.order:
        raise InputError("the system has no states to balance")
    if not m.stable:
        raise InputError("balancing needs a stable system; its gramians do not exist otherwise")
    if m.dt:
        Wc = scipy.linalg.solve_discrete_lyapunov(m.A, m.B @ m.B.T)
        Wo = scipy.linalg.solve_discrete_lyapunov(m.A.T, m.C.T @ m.C)
    else:
        Wc = scipy.linalg.solve_continuous_lyapunov(m.A, -m.B @ m.B.T)
        Wo = scipy.linalg.solve_continuous_lyapunov(m.A.T, -m.C.T @ m.C)
    L, R = _root(Wc), _root(Wo)
    U, hankel, Vt = np.linalg.svd(R.T @ L)
    keep = m.order if order is None else order
    if not 1 <= keep <= m.order:
        raise InputError(f"order = {order}; expected 1 to {m.order}")
    if hankel[keep - 1] <= 1e-12 * hankel[0]:
        minimal = int(np.sum(hankel > 1e-12 * hankel[0]))
        raise InputError(
            f"the system is not minimal: Hankel singular value {keep} vanishes; pass order={minimal} or less"
        )
    root = np.sqrt(hankel[:keep])
    T = L @ Vt[:keep].T / root
    T_inverse = (U[:, :keep] / root).T @ R.T
    balanced = Matrices(T_inverse @ m.A @ T, T_inverse @ m.B, m.C @ T, m.D, m.dt)
    return Balanced(to_control(balanced), T, T_inverse, hankel)


def _root(W: np.ndarray) -> np.ndarray:
    """A factor L with L L' = W for a positive semidefinite W that rounding may have made slightly indefinite.
    """
    values, vectors = np.linalg.eigh(0.5 * (W + W.T))
    return vectors * np.sqrt(np.maximum(values, 0.0))


def align_models(systems: Sequence, *, reorder: bool = True) -> list[control.StateSpace]:
    """Give balanced models coherent states: signs, and order where Hankel values cross, follow the previous
    model.

    Each state is recognised by its rows of B and columns of C; the assignment to the states of the previous
    model maximises the sum of absolute correlations. The transfer functions do not change.

    Parameters
    ----------
    systems : sequence of systems of one order, along the operating points
    reorder : bool
        False aligns signs only.
    """
    models = [as_matrices(s, f"system {i}") for i, s in enumerate(systems)]
    if len({(m.order, *m.D.shape, m.dt) for m in models}) != 1:
        raise InputError(
            "the systems differ in order, inputs, outputs or sampling time; bring them to one order first"
        )
    aligned = models[:1]
    for m in models[1:]:
        aligned.append(_follow(aligned[-1], m, reorder))
    return [to_control(m) for m in aligned]


def average_models(systems: Sequence) -> control.StateSpace:
    """Mean of balanced models of one system (a Monte Carlo study), after aligning each with the first."""
    models = [as_matrices(s, f"system {i}") for i, s in enumerate(systems)]
    if not models:
        raise InputError("no systems to average")
    first = models[0]
    aligned = [first]
    for m in models[1:]:
        if m.A.shape != first.A.shape or m.D.shape != first.D.shape or m.dt != first.dt:
            raise InputError(
                "the systems differ in order, inputs, outputs or sampling time and cannot be averaged"
            )
        aligned.append(_follow(first, m, reorder=True))
    mean = [np.mean([m[k] for m in aligned], axis=0) for k in range(4)]
    return to_control(Matrices(*mean, first.dt))


def _follow(reference: Matrices, m: Matrices, reorder: bool) -> Matrices:
    """Permute and sign the states of m like those of the reference."""
    marks = [
        np.hstack([x.B / np.linalg.norm(reference.B), x.C.T / np.linalg.norm(reference.C)])
        for x in (reference, m)
    ]
    correlation = marks[0] @ marks[1].T
    if reorder:
        size = np.outer(np.linalg.norm(marks[0], axis=1), np.linalg.norm(marks[1], axis=1))
        _, perm = scipy.optimize.linear_sum_assignment(-np.abs(correlation) / np.maximum(size, 1e-300))
    else:
        perm = np.arange(m.order)
    sign = np.where(correlation[np.arange(m.order), perm] < 0, -1.0, 1.0)
    A = m.A[np.ix_(perm, perm)] * sign[:, None] * sign
    return Matrices(A, m.B[perm] * sign[:, None], m.C[:, perm] * sign, m.D, m.dt)
