"""Subspace identification from several experiments: PI-MOESP and PO-MOESP (Verhaegen & Verdult 2007, chapter
9).

From the LQ factorisation of [U_f; Z; Y_f], with instruments Z = past inputs (PI, consistent for any noise
that is uncorrelated with the input, of low power at small N) or past inputs and outputs (PO, for process
noise too):

    U_f = R11 Q1,   Z = R21 Q1 + R22 Q2,   Y_f = R31 Q1 + R32 Q2 + R33 Q3,

the column space of R32 is that of the extended observability matrix; A and C follow from its shift structure,
and B, D and the initial states from linear regression on all samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import control
import numba
import numpy as np

from pwaid.errors import InputError
from pwaid.hinfstruct.statespace import Matrices, freeze, to_control

__all__ = ["SubspaceModel", "pi_moesp", "po_moesp"]

Data = Sequence[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class SubspaceModel:
    """A discrete state-space model identified from data.

    Attributes
    ----------
    system : control.StateSpace
        Discrete, sampling time ``dt``.
    initial_states : array, shape (experiments, n)
    singular_values : array
        Of R32, decreasing: their fall after the order shows how well the data fix it.
    order : int
    block_rows : int
    method : str
    stable : bool
    """

    system: control.StateSpace
    initial_states: np.ndarray
    singular_values: np.ndarray
    order: int
    block_rows: int
    method: str
    stable: bool

    def __post_init__(self):
        freeze(self)

    @property
    def gap(self) -> float:
        """Ratio of the last kept to the first dropped singular value.

        Near 1 the data do not support the order.
        """
        return float(self.singular_values[self.order - 1] / self.singular_values[self.order])


def pi_moesp(
    data, order: int | None = None, *, dt: float, block_rows: int = 20, feedthrough: bool = True
) -> SubspaceModel:
    """PI-MOESP: past inputs as instruments.

    Parameters
    ----------
    data : tuple (inputs, outputs) or sequence of such tuples
        One per experiment: inputs (N, nu), outputs (N, ny), the same sampling time, N may differ.
    order : int, optional
        Number of states; None takes the largest ratio of neighbouring singular values (at least one state).
    dt : float
        Sampling time, seconds.
    block_rows : int
        Block rows of the future and of the past, more than the order. Few rows lose slow modes: 20 is the
        default because 10 gave errors above 100 % at one point of the flexible arm.
    feedthrough : bool
        False fixes D = 0.

    Raises
    ------
    InputError
        NaN, shapes, too few samples, an order the block rows cannot carry, or an input that does not excite
        enough.
    """
    return _moesp(data, order, dt, block_rows, feedthrough, past_outputs=False)


def po_moesp(
    data, order: int | None = None, *, dt: float, block_rows: int = 20, feedthrough: bool = True
) -> SubspaceModel:
    """PO-MOESP: past inputs and outputs as instruments; arguments as in `pi_moesp`."""
    return _moesp(data, order, dt, block_rows, feedthrough, past_outputs=True)


def _moesp(data, order, dt, s, feedthrough, past_outputs) -> SubspaceModel:
    experiments = _check(data, order, dt, s)
    nu, ny = experiments[0][0].shape[1], experiments[0][1].shape[1]
    blocks = [_hankel_blocks(u, y, s, past_outputs) for u, y in experiments]
    stacked = np.hstack(blocks)
    rows = stacked.shape[0]
    if stacked.shape[1] < rows:
        raise InputError(
            f"{stacked.shape[1]} usable columns for {rows} rows: too few samples for {s} block rows; "
            "record longer or lower block_rows"
        )
    R = np.linalg.qr(stacked.T, mode="r").T
    excitation = np.abs(np.diag(R))[: s * nu]
    if excitation.min() < 1e-10 * excitation.max():
        raise InputError(
            f"the input does not excite {s} block rows (its Hankel matrix is rank-deficient); "
            "use a richer input such as a PRBS, or lower block_rows"
        )
    split = rows - s * ny
    U, singular, _ = np.linalg.svd(R[split:, s * nu : split], full_matrices=False)
    if order is None:
        ratio = singular[:-1] / np.maximum(singular[1:], 1e-14 * singular[0])
        order = int(np.argmax(ratio[: (s - 1) * ny - 1])) + 1
    observability = U[:, :order] * np.sqrt(singular[:order])
    C = observability[:ny]
    A = np.linalg.lstsq(observability[:-ny], observability[ny:], rcond=None)[0]
    B, D, x0 = _regress(A, C, experiments, feedthrough)
    m = Matrices(A, B, C, D, float(dt))
    method = "PO-MOESP" if past_outputs else "PI-MOESP"
    return SubspaceModel(to_control(m), x0, singular, order, s, method, m.stable)


def _check(data, order, dt, s) -> list[tuple[np.ndarray, np.ndarray]]:
    if isinstance(data, tuple) and len(data) == 2 and not isinstance(data[0], tuple):
        data = [data]
    if not (np.isscalar(dt) and dt > 0):
        raise InputError(f"dt = {dt}; expected a positive sampling time in seconds")
    experiments = []
    for i, pair in enumerate(data):
        u, y = (np.asarray(x, dtype=float) for x in pair)
        u, y = u.reshape(len(u), -1), y.reshape(len(y), -1)
        if len(u) != len(y):
            raise InputError(
                f"experiment {i}: {len(u)} input samples and {len(y)} output samples; they must agree"
            )
        if not (np.isfinite(u).all() and np.isfinite(y).all()):
            raise InputError(
                f"experiment {i} contains NaN or infinite samples; cut or interpolate them first"
            )
        if len(u) < 2 * s + 1:
            raise InputError(f"experiment {i} has {len(u)} samples; {s} block rows need more than {2 * s}")
        experiments.append((u, y))
    if not experiments:
        raise InputError("no experiments were given; pass (inputs, outputs) or a list of such tuples")
    if len({(u.shape[1], y.shape[1]) for u, y in experiments}) != 1:
        raise InputError("the experiments differ in their number of inputs or outputs")
    ny = experiments[0][1].shape[1]
    if s < 2 or (order is not None and not 1 <= order < (s - 1) * ny):
        raise InputError(
            f"order = {order} with block_rows = {s}: expected 1 <= order < {(s - 1) * ny} and block_rows >= 2"
        )
    return experiments


def _hankel(signal: np.ndarray, first: int, rows: int, columns: int) -> np.ndarray:
    """Block Hankel matrix, shape (rows * channels, columns), starting at sample ``first``."""
    windows = np.lib.stride_tricks.sliding_window_view(
        signal[first : first + rows + columns - 1], rows, axis=0
    )
    return np.moveaxis(windows, -1, 1).reshape(columns, -1).T


def _hankel_blocks(u: np.ndarray, y: np.ndarray, s: int, past_outputs: bool) -> np.ndarray:
    columns = len(u) - 2 * s + 1
    parts = [_hankel(u, s, s, columns), _hankel(u, 0, s, columns)]
    if past_outputs:
        parts.append(_hankel(y, 0, s, columns))
    parts.append(_hankel(y, s, s, columns))
    return np.vstack(parts)


def _regress(A, C, experiments, feedthrough):
    """B, D and the initial states:

    Y(k) = C A^k x0 + sum_ij B_ij (response to e_i u_j) + D u(k) is linear in them.
    """
    n, ny, nu = A.shape[0], C.shape[0], experiments[0][0].shape[1]
    free = n * nu + (ny * nu if feedthrough else 0)
    total = sum(len(u) for u, _ in experiments)
    regressors = np.zeros((total, ny, free + n * len(experiments)))
    target = np.concatenate([y for _, y in experiments])
    start = 0
    for e, (u, _) in enumerate(experiments):
        rows = slice(start, start + len(u))
        states, free_motion = _unit_responses(np.array(A, order="C"), np.array(u, order="C"))
        regressors[rows, :, : n * nu] = np.einsum("yn,knc->kyc", C, states)
        if feedthrough:
            regressors[rows, :, n * nu : free] = np.einsum(
                "yz,kj->kyzj", np.eye(ny), u
            ).reshape(len(u), ny, -1)
        regressors[rows, :, free + e * n : free + (e + 1) * n] = C @ free_motion
        start += len(u)
    flat = regressors.reshape(total * ny, -1)
    if not np.isfinite(flat).all():
        raise InputError(
            "the identified model is so unstable that its responses overflow; change order or block_rows"
        )
    solution = np.linalg.lstsq(flat, target.ravel(), rcond=None)[0]
    B = solution[: n * nu].reshape(n, nu)
    D = solution[n * nu : free].reshape(ny, nu) if feedthrough else np.zeros((ny, nu))
    return B, D, solution[free:].reshape(-1, n)


@numba.njit(cache=True)
def _unit_responses(A, u):
    """States driven by e_i u_j, shape (N, n, n * nu), and the powers A^k, shape (N, n, n)."""
    n_samples, nu = u.shape
    n = A.shape[0]
    driven = np.zeros((n_samples, n, n * nu))
    free = np.zeros((n_samples, n, n))
    free[0] = np.eye(n)
    for k in range(1, n_samples):
        for i in range(n):
            for j in range(n):
                a = A[i, j]
                for c in range(n * nu):
                    driven[k, i, c] += a * driven[k - 1, j, c]
                for c in range(n):
                    free[k, i, c] += a * free[k - 1, j, c]
            for c in range(nu):
                driven[k, i, i * nu + c] += u[k - 1, c]
    return driven, free
