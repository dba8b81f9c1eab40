"""Plain state-space arithmetic on (A, B, C, D): checks, differences, frequency responses, held-input
simulation.

`Matrices` is the coin of the package: four read-only float arrays and the sampling time (0 for continuous
time). Public functions take `control.StateSpace`, a `Matrices`, or a tuple (A, B, C, D), and give
`control.StateSpace` back.
"""

from __future__ import annotations

from typing import NamedTuple

import control
import numba
import numpy as np

from pwaid.errors import InputError

__all__ = [
    "Matrices", "as_matrices", "difference", "frequency_response", "initial_state", "simulate_discrete", "to_control",
]


def freeze(instance) -> None:
    """Replace every array of a frozen dataclass by a read-only copy."""
    for name, value in vars(instance).items():
        if isinstance(value, np.ndarray):
            copy = np.array(value, order="C")
            copy.flags.writeable = False
            object.__setattr__(instance, name, copy)


class Matrices(NamedTuple):
    """State-space matrices A (n, n), B (n, nu), C (ny, n), D (ny, nu) and the sampling time in seconds (0:

    Continuous).
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dt: float = 0.0

    @property
    def order(self) -> int:
        return self.A.shape[0]

    @property
    def poles(self) -> np.ndarray:
        return np.linalg.eigvals(self.A) if self.order else np.zeros(0)

    @property
    def stable(self) -> bool:
        if not self.order:
            return True
        return bool(np.all(self.poles.real < 0) if self.dt == 0 else np.all(np.abs(self.poles) < 1))

    def at_zero(self) -> np.ndarray:
        """The static gain G(0) of a continuous system, G(1) of a discrete one."""
        if not self.order:
            return self.D
        left = -self.A if self.dt == 0 else np.eye(self.order) - self.A
        return self.D + self.C @ np.linalg.solve(left, self.B)


def as_matrices(system, name: str = "system", dt: float | None = None) -> Matrices:
    """Check a system and return its matrices.

    Parameters
    ----------
    system : control.StateSpace, Matrices, or tuple (A, B, C, D)
        A tuple carries no sampling time; it is taken as ``dt`` (continuous when None).
    name : str
        How error messages call it.
    dt : float, optional
        Sampling time of a plain tuple, seconds.

    Raises
    ------
    InputError
        Wrong type, wrong shapes, NaN or infinite entries.
    """
    if isinstance(system, control.StateSpace):
        parts, step = (system.A, system.B, system.C, system.D), system.dt
        if step is True:
            raise InputError(f"{name} is discrete with an unspecified sampling time; give it a dt in seconds")
        step = float(step or 0.0)
    elif isinstance(system, Matrices):
        return system
    elif isinstance(system, tuple | list) and len(system) == 4:
        parts, step = system, float(dt or 0.0)
    else:
        raise InputError(
            f"{name} is a {type(system).__name__}; expected control.StateSpace or a tuple (A, B, C, D)"
        )
    try:
        A, B, C, D = (np.atleast_2d(np.array(m, dtype=float)) for m in parts)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{name}: the matrices are not real numbers ({error}); pass four real 2-d arrays"
        ) from error
    n = A.shape[0] if A.size else 0
    if n == 0:
        A, B, C = np.zeros((0, 0)), np.zeros((0, D.shape[1])), np.zeros((D.shape[0], 0))
    if A.shape != (n, n) or B.shape != (n, D.shape[1]) or C.shape != (D.shape[0], n):
        raise InputError(
            f"{name}: shapes A {A.shape}, B {B.shape}, C {C.shape}, D {D.shape} do not fit together; "
            "expected (n, n), (n, inputs), (outputs, n), (outputs, inputs)"
        )
    for label, m in zip("ABCD", (A, B, C, D), strict=True):
        if not np.isfinite(m).all():
            raise InputError(
                f"{name}: {label} contains NaN or infinite values; check where the model came from"
            )
        m.flags.writeable = False
    return Matrices(A, B, C, D, step)


def to_control(m: Matrices, **names) -> control.StateSpace:
    """`control.StateSpace` with the same matrices.

    ``names`` are passed on (inputs, outputs, states, name).
    """
    return control.StateSpace(m.A, m.B, m.C, m.D, m.dt, remove_useless_states=False, **names)


def difference(G: Matrices, H: Matrices) -> Matrices:
    """The error system G - H."""
    if G.D.shape != H.D.shape:
        raise InputError(
            f"the systems have {G.D.shape[0]} outputs x {G.D.shape[1]} inputs and {H.D.shape[0]} x "
            f"{H.D.shape[1]}; "
            "they must agree to be compared"
        )
    if G.dt != H.dt:
        raise InputError(
            f"the systems have sampling times {G.dt} and {H.dt} s; convert one of them (d2c) first"
        )
    A = np.zeros((G.order + H.order,) * 2)
    A[: G.order, : G.order], A[G.order :, G.order :] = G.A, H.A
    return Matrices(A, np.vstack([G.B, H.B]), np.hstack([G.C, -H.C]), G.D - H.D, G.dt)


def resolvent_parts(m: Matrices, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """X = (jw - A)^-1 B, shape (k, n, nu), and Y = C (jw - A)^-1, shape (k, ny, n); M_B and M_C of (25)."""
    inverse = np.linalg.inv(1j * omega[:, None, None] * np.eye(m.order) - m.A)
    return inverse @ m.B, m.C @ inverse


def frequency_response(m: Matrices, omega) -> np.ndarray:
    """G(j omega), shape (k, ny, nu), for omega in rad/s.

    ``inf`` gives D. Discrete systems use z = exp(j omega dt).
    """
    omega = np.atleast_1d(np.asarray(omega, dtype=float))
    out = np.broadcast_to(m.D, (omega.size, *m.D.shape)).astype(complex)
    finite = np.isfinite(omega)
    if m.order and finite.any():
        point = 1j * omega[finite] if m.dt == 0 else np.exp(1j * omega[finite] * m.dt)
        out[finite] += m.C @ np.linalg.solve(
            point[:, None, None] * np.eye(m.order) - m.A, np.broadcast_to(m.B, (point.size, *m.B.shape))
        )
    return out


def initial_state(x0, order: int) -> np.ndarray:
    """The state at the start as a new vector, zero where none was given.

    Raises
    ------
    InputError
        Another number of entries, or one that is not finite.
    """
    start = np.zeros(order) if x0 is None else np.array(x0, dtype=float)
    if start.shape != (order,) or not np.isfinite(start).all():
        raise InputError(f"x0 has shape {start.shape}; expected {order} finite numbers, one a state")
    return start


def simulate_discrete(m: Matrices, inputs: np.ndarray, x0: np.ndarray | None = None) -> np.ndarray:
    """Outputs (N, ny) of x+ = A x + B u, y = C x + D u for inputs (N, nu)."""
    inputs = np.ascontiguousarray(inputs, dtype=float)
    if inputs.ndim != 2 or inputs.shape[1] != m.D.shape[1]:
        raise InputError(f"inputs have shape {inputs.shape}; expected (N, {m.D.shape[1]})")
    states = simulate_states(m.A, inputs @ m.B.T, initial_state(x0, m.order))
    return states @ m.C.T + inputs @ m.D.T


def simulate_states(A: np.ndarray, drive: np.ndarray, x0: np.ndarray) -> np.ndarray:
    """States (N, n) of x+ = A x + drive(k)."""
    return _run(np.array(A, order="C"), np.array(drive, order="C"), np.array(x0))


@numba.njit(cache=True)
def _run(A, drive, x0):
    n_samples, n = drive.shape
    x = x0.copy()
    states = np.empty((n_samples, n))
    for k in range(n_samples):
        for i in range(n):
            states[k, i] = x[i]
        for i in range(n):
            total = drive[k, i]
            for j in range(n):
                total += A[i, j] * states[k, j]
            x[i] = total
    return states
