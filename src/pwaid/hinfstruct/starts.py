"""Starting parameters from a black-box model of the right order: x_blackbox = S x_structured.

* `velocity_loop_start`: closed form for flexible arms with velocity loops, eq. (32); exact on noise-free models.
* `printed_start_system`: the linear equations (34) of Vizer et al. (2014), which fix 28 of the 36 unknowns only.
* `null_space_start`: any affine pattern. The known entries give equations linear in T = S^-1; in their null space the
  remaining bilinear equations are solved by Gauss-Newton from several random points (after Prot, Mercère & Ramos 2012).
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.optimize

from pwaid.errors import InputError, SolverError
from pwaid.hinfstruct.balance import balance
from pwaid.hinfstruct.statespace import Matrices, as_matrices
from pwaid.hinfstruct.structured import StructuredModel

__all__ = ["null_space_start", "printed_start_system", "velocity_loop_start"]


def velocity_loop_start(target, output) -> np.ndarray:
    """Free entries of (32) from a black-box model, in closed form.

    Holds for x = (v, dtheta, dv) with as many springs as joints, B = -A[:, joints] and C = [0 | C1]. With S the change
    of state, its blocks follow one after the other:

        S_dtheta = -A^-1 B,  X = -(C B)^-1 C A B,  V = A B + B X,  Y = C12^-1 C A^-1 V,  S_v = V Y^-1,  S_dv = A^-1 S_v,

    where C12 is the part of C1 that multiplies dv.

    Parameters
    ----------
    target : control.StateSpace or tuple
        Continuous, of order 3 m for m joints.
    output : array, shape (m, 2 m)
        C1.

    Returns
    -------
    array, shape (4 m²,): theta column by column.

    Raises
    ------
    InputError
        Another order or number of channels, or a singular step (the model does not have this structure).
    """
    m = as_matrices(target, "target")
    if m.order and m.stable:
        m = as_matrices(balance(m).system)  # any state will do; a balanced one loses the fewest digits
    output = np.asarray(output, dtype=float)
    nj = m.B.shape[1]
    if m.order != 3 * nj or output.shape != (nj, 2 * nj) or m.C.shape[0] != nj:
        raise InputError(
            f"target has order {m.order}, {nj} inputs, {m.C.shape[0]} outputs and C1 has shape {output.shape}; this start "
            f"needs order {3 * nj} and C1 of shape ({nj}, {2 * nj}); reduce the order first, or start from a neighbour"
        )
    try:
        S34 = -np.linalg.solve(m.A, m.B)
        X = -np.linalg.solve(m.C @ m.B, m.C @ m.A @ m.B)
        V = m.A @ m.B + m.B @ X
        Y = np.linalg.solve(output[:, nj:], m.C @ np.linalg.solve(m.A, V))
        S12 = V @ np.linalg.inv(Y)
        S = np.hstack([S12, S34, np.linalg.solve(m.A, S12)])
        A = np.linalg.solve(S, m.A @ S)
    except np.linalg.LinAlgError as error:
        raise InputError(f"the black-box model does not have the structure of a velocity-loop arm ({error})") from error
    return A[nj:, : 2 * nj].ravel(order="F")


def printed_start_system(target, output) -> tuple[np.ndarray, np.ndarray]:
    """The printed initialisation (34) as ``matrix @ vec(T) = right``, vec by columns: rank-deficient, for the record.

    (34a) first rows of T A equal the integrators, (34b) the springs are not driven, (34c) C_blackbox = C T.
    """
    m = as_matrices(target, "target")
    output = np.asarray(output, dtype=float)
    n, nj = m.order, m.B.shape[1]
    nv = n - output.shape[1]
    first = np.eye(n)[:nv]
    last = np.eye(n)[n - nv :]
    C = np.hstack([np.zeros((len(output), nv)), output])
    eye = np.eye(n)
    rows = [np.kron(m.A.T, first) - np.kron(eye, last), np.kron(m.B.T, first), np.kron(eye, C)]
    right = [np.zeros(nv * n), np.zeros(nv * nj), m.C.ravel(order="F")]
    return np.vstack(rows), np.concatenate(right)


def null_space_start(model: StructuredModel, target, *, restarts: int = 30, rng=None) -> np.ndarray:
    """theta of an affine structured model from a black-box model of the same order.

    Minimises the bilinear residual T A = A(theta) T, T B = B(theta), C = C(theta) T over the T that satisfy those of
    these equations that are free of theta, with theta eliminated by least squares.

    Raises
    ------
    InputError
        The model is not affine, or the orders differ.
    SolverError
        No random start gave an invertible T.
    """
    m = as_matrices(target, "target")
    if not model.affine:
        raise InputError("null_space_start needs an affine pattern model; give a nominal theta instead")
    constant = Matrices(*model.evaluate(np.zeros(model.size)))
    if constant.order != m.order:
        raise InputError(f"the target has order {m.order} and the structure {constant.order}; balance(target, order=) first")
    rng = np.random.default_rng(rng)
    slopes = model.differentiate(np.zeros(model.size))
    matrix, right = _linear_part(m, constant, slopes)
    particular = np.linalg.lstsq(matrix, right, rcond=None)[0]
    basis = scipy.linalg.null_space(matrix, rcond=1e-9)
    n = m.order

    def at(z):
        T = (particular + basis @ z).reshape(n, n, order="F")
        return T, *_best_theta(T, m, constant, slopes)

    best, best_cost = None, np.inf
    size = np.linalg.norm(particular) + 1.0
    for _ in range(restarts):
        z = size * rng.standard_normal(basis.shape[1]) / np.sqrt(max(basis.shape[1], 1))
        try:
            run = scipy.optimize.least_squares(lambda z: at(z)[2], z, method="trf", x_scale="jac", max_nfev=200)
        except (np.linalg.LinAlgError, ValueError):
            continue
        T, theta, residual = at(run.x)
        if np.isfinite(residual).all() and np.linalg.cond(T) < 1e12 and run.cost < best_cost:
            best, best_cost = theta, run.cost
        if best_cost < 1e-20:
            break
    if best is None:
        raise SolverError(f"no invertible similarity was found in {restarts} starts; raise restarts or give a start")
    return best


def _linear_part(m: Matrices, constant: Matrices, slopes) -> tuple[np.ndarray, np.ndarray]:
    """Equations of the similarity whose structured rows (A, B) or columns (C) carry no parameter."""
    n = m.order
    dA, dB, dC, _ = slopes
    known = [i for i in range(n) if not dA[:, i].any()]
    undriven = [i for i in range(n) if not dB[:, i].any()]
    rows, right = [], []
    for i in known:  # e_i T A_bb = A(i, :) T
        rows.append(np.kron(m.A.T, np.eye(n)[i : i + 1]) - np.kron(np.eye(n), constant.A[i : i + 1]))
        right.append(np.zeros(n))
    for i in undriven:  # e_i T B_bb = B(i, :)
        rows.append(np.kron(m.B.T, np.eye(n)[i : i + 1]))
        right.append(constant.B[i])
    if not dC.any():  # C_bb = C T
        rows.append(np.kron(np.eye(n), constant.C))
        right.append(m.C.ravel(order="F"))
    if not rows:
        return np.zeros((1, n * n)), np.zeros(1)
    return np.vstack(rows), np.concatenate(right)


def _best_theta(T, m: Matrices, constant: Matrices, slopes):
    """Least-squares theta for one T, and the residual of T A_bb = A(theta) T, T B_bb = B(theta), C_bb = C(theta) T."""
    unit = float(np.abs(m.poles).max())
    weights = (1 / unit, 1 / unit, 1.0)
    dA, dB, dC, _ = slopes
    moved = (dA @ T, dB, dC @ T)
    left = np.hstack([w * d.reshape(len(d), -1) for w, d in zip(weights, moved, strict=True)]).T
    gaps = (T @ m.A - constant.A @ T, T @ m.B - constant.B, m.C - constant.C @ T)
    right = np.concatenate([(w * g).ravel() for w, g in zip(weights, gaps, strict=True)])
    scale = np.maximum(np.linalg.norm(left, axis=0), 1e-300)
    theta = np.linalg.lstsq(left / scale, right, rcond=None)[0] / scale
    return theta, left @ theta - right
