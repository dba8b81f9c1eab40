"""Starting parameters from a black-box model of the right order: x_blackbox = S x_structured.

* `velocity_loop_start`: closed form for flexible arms with velocity loops, eq. (32); exact on noise-free
  models.
* `printed_start_system`: the linear equations (34) of Vizer et al. (2014), which fix 28 of the 36 unknowns
  only.
* `null_space_start`: any affine pattern. Combinations of the similarity equations without theta are linear in
  S; in their null space the others are solved by Gauss-Newton from several random points (after Prot, Mercère
  & Ramos 2012).
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

    Holds for x = (v, dtheta, dv) with as many springs as joints, B = -A[:, joints] and C = [0 | C1]. With S
    the change of state, its blocks follow one after the other:

        S_dtheta = -A^-1 B,  X = -(C B)^-1 C A B,  V = A B + B X,  Y = C12^-1 C A^-1 V,  S_v = V Y^-1,  S_dv =
        A^-1 S_v,

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
            f"target has order {m.order}, {nj} inputs, {m.C.shape[0]} outputs and C1 has shape "
            f"{output.shape}; this start "
            f"needs order {3 * nj} and C1 of shape ({nj}, {2 * nj}); reduce the order first, or start from "
            "a neighbour"
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
        raise InputError(
            f"the black-box model does not have the structure of a velocity-loop arm ({error})"
        ) from error
    return A[nj:, : 2 * nj].ravel(order="F")


def printed_start_system(target, output) -> tuple[np.ndarray, np.ndarray]:
    """The printed initialisation (34) as ``matrix @ vec(T) = right``, vec by columns: rank-deficient, for the
    record.

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


def null_space_start(model: StructuredModel, target, *, restarts: int = 40, rng=None) -> np.ndarray:
    """theta of an affine structured model from a black-box model of the same order.

    Minimises the bilinear residual of A_bb S = S A(theta), B_bb = S B(theta), C_bb S = C(theta) over the S
    that satisfy those combinations of these equations that are free of theta, with theta eliminated by least
    squares. The dual equations (in S^-1) are used instead when they leave fewer unknowns.

    Raises
    ------
    InputError
        The model is not affine, or the orders differ.
    SolverError
        No random start gave an invertible S.
    """
    m = as_matrices(target, "target")
    if not model.affine:
        raise InputError("null_space_start needs an affine pattern model; give a nominal theta instead")
    constant = Matrices(*model.evaluate(np.zeros(model.size)))
    if constant.order != m.order:
        raise InputError(
            f"the target has order {m.order} and the structure {constant.order}; balance(target, order=) "
            "first"
        )
    rng = np.random.default_rng(rng)
    primal = (m, constant, model.differentiate(np.zeros(model.size))[:3])
    forms = [(form, *_linear_solutions(*form)) for form in (primal, _dual(*primal))]
    form, particular, basis = min(forms, key=lambda f: f[2].shape[1])
    n = m.order
    size = np.linalg.norm(particular) + 1.0

    def residual(z):
        return _best_theta((particular + basis @ z).reshape(n, n, order="F"), *form)[1]

    best, best_cost, repeats = None, np.inf, 0
    unknowns = basis.shape[1]
    for _ in range(restarts if unknowns else 1):
        z = size * 10 ** rng.uniform(-1, 1.5) * rng.standard_normal(unknowns) / np.sqrt(max(unknowns, 1))
        if unknowns:
            z = scipy.optimize.least_squares(
                residual, z, x_scale="jac", max_nfev=100, ftol=1e-12, xtol=1e-12
            ).x
        S = (particular + basis @ z).reshape(n, n, order="F")
        theta, gap = _best_theta(S, *form)
        cost = float(gap @ gap)
        if not np.isfinite(theta).all() or np.linalg.cond(S) > 1e10:
            continue
        if abs(cost - best_cost) <= 1e-3 * best_cost:
            repeats += 1
        elif cost < best_cost:
            repeats = 0
        if cost < best_cost:
            best, best_cost = theta, cost
        if best_cost < 1e-18 or repeats >= 2:  # exact, or reached three times
            break
    if best is None:
        raise SolverError(
            f"no invertible similarity was found in {restarts} starts; raise restarts or give a start"
        )
    return best


def _dual(m: Matrices, constant: Matrices, slopes):
    """The same equations for the transposed systems."""
    dA, dB, dC = slopes
    turn = [Matrices(x.A.T, x.C.T, x.B.T, x.D.T) for x in (m, constant)]
    return (*turn, (np.swapaxes(dA, 1, 2), np.swapaxes(dC, 1, 2), np.swapaxes(dB, 1, 2)))


def _linear_solutions(m: Matrices, constant: Matrices, slopes) -> tuple[np.ndarray, np.ndarray]:
    """All vec(S) = particular + basis z that satisfy the combinations of the equations in which theta
    cancels.

    Columns w with [dA_k dB_k] w = 0 for every k give A_bb S w_a + B_bb w_b = S (A_0 w_a + B_0 w_b); likewise
    for C.
    """
    n = m.order
    dA, dB, dC = slopes
    driven = np.concatenate([dA, dB], axis=2).reshape(-1, n + m.B.shape[1])
    rows, right = [], []
    for w in scipy.linalg.null_space(driven).T:
        a, b = w[:n], w[n:]
        rows.append(np.kron(a, m.A) - np.kron(constant.A @ a + constant.B @ b, np.eye(n)))
        right.append(-m.B @ b)
    for w in scipy.linalg.null_space(dC.reshape(-1, n)).T:
        rows.append(np.kron(w, m.C))
        right.append(constant.C @ w)
    if not rows:
        return np.zeros(n * n), np.eye(n * n)
    matrix, vector = np.vstack(rows), np.concatenate(right)
    weight = 1 / np.maximum(np.linalg.norm(matrix, axis=1), 1e-300)
    matrix, vector = matrix * weight[:, None], vector * weight
    return np.linalg.lstsq(matrix, vector, rcond=1e-10)[0], scipy.linalg.null_space(matrix, rcond=1e-10)


def _best_theta(S, m: Matrices, constant: Matrices, slopes):
    """Least-squares theta for one S, and the weighted residual of the three equations."""
    unit = float(np.abs(m.poles).max())
    weights = (1 / unit, 1 / unit, 1.0)
    dA, dB, dC = slopes
    left = np.hstack(
        [w * d.reshape(len(d), -1) for w, d in zip(weights, (S @ dA, S @ dB, dC), strict=True)]
    ).T
    gaps = (m.A @ S - S @ constant.A, m.B - S @ constant.B, m.C @ S - constant.C)
    right = np.concatenate([(w * g).ravel() for w, g in zip(weights, gaps, strict=True)])
    scale = np.maximum(np.linalg.norm(left, axis=0), 1e-300)
    theta = np.linalg.lstsq(left / scale, right, rcond=None)[0] / scale
    return theta, left @ theta - right
