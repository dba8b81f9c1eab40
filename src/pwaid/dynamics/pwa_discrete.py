"""Sampled piecewise-affine systems: zero-order hold and Tustin, one map per cell, cells looked up at the
samples.

Zero-order hold is exact while a motion stays in one cell and the input is held; a crossing inside a
sampling interval is seen only at the next sample, with an error that the continuous simulation does not
have. Tustin keeps the state physical, so that guards keep their meaning: x⁺ = x + (T/2)(A x + A x⁺ + B u +
B u⁺) + T a; from u to y in one cell it is the bilinear transform of the transfer function.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from pwaid.dynamics.cell import Cell
from pwaid.dynamics.pwa_system import PWASystem
from pwaid.errors import InputError

__all__ = ["DiscretePWASystem", "discretise"]


@dataclass(frozen=True)
class DiscretePWASystem:
    """x[k+1] = A_i x[k] + a_i + B_i u[k] + E_i u[k+1] and y[k] = C_i x[k] + c_i + D_i u[k] in the cell i of
    (x[k], u[k]).

    Attributes
    ----------
    cells : tuple of Cell
        With the sampled A, a, B in place of the continuous ones.
    next_input : tuple of ndarray (n, m)
        E_i; zero for zero-order hold.
    dt : float
        Sampling time, seconds.
    method : str
    states, inputs, outputs : tuple of str
    """

    cells: tuple[Cell, ...]
    next_input: tuple[np.ndarray, ...]
    dt: float
    method: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def simulate(self, inputs, x0=None) -> tuple[np.ndarray, np.ndarray]:
        """States and outputs at the samples.

        Parameters
        ----------
        inputs : array_like (N, m)
        x0 : array_like (n,), optional

        Returns
        -------
        states, outputs : ndarray (N, n), (N, p)
        """
        n, m = self.cells[0].B.shape
        u = np.asarray(inputs, dtype=float)
        if u.ndim != 2 or u.shape[1] != m or not np.isfinite(u).all():
            raise InputError(f"inputs have shape {u.shape}; expected finite values of shape (N, {m})")
        x = np.zeros(n) if x0 is None else np.array(x0, dtype=float)
        states, outputs = np.empty((len(u), n)), np.empty((len(u), self.cells[0].C.shape[0]))
        for k in range(len(u)):
            inside = [i for i, cell in enumerate(self.cells) if (cell.margin(x, u[k]) >= 0).all()]
            if not inside:
                raise InputError(f"sample {k}: x = {x} lies in no cell; the cells do not cover the space "
                                 "there")
            cell = self.cells[inside[0]]
            states[k], outputs[k] = x, cell.output(x, u[k])
            following = u[min(k + 1, len(u) - 1)]
            x = cell.A @ x + cell.a + cell.B @ u[k] + self.next_input[inside[0]] @ following
        return states, outputs


def discretise(system: PWASystem, dt: float, method: str = "zoh") -> DiscretePWASystem:
    """Sample every cell's dynamics.

    Parameters
    ----------
    system : PWASystem
    dt : float
        Sampling time, seconds.
    method : {"zoh", "tustin"}

    Returns
    -------
    DiscretePWASystem
    """
    if not (np.isfinite(dt) and dt > 0):
        raise InputError(f"dt = {dt}; expected a positive sampling time in seconds")
    if method not in ("zoh", "tustin"):
        raise InputError(f"method={method!r}; expected 'zoh' or 'tustin'")
    cells, following = [], []
    for cell in system.cells:
        A, a, B, E = _zoh(cell, dt) if method == "zoh" else _tustin(cell, dt)
        cells.append(cell.replace(A=A, a=a, B=B))
        following.append(E)
    return DiscretePWASystem(tuple(cells), tuple(following), dt, method, system.states, system.inputs,
                             system.outputs)


def _zoh(cell: Cell, dt: float):
    n, m = cell.B.shape
    full = np.zeros((n + m + 1, n + m + 1))
    full[:n] = np.column_stack([cell.A, cell.B, cell.a])
    flow = expm(full * dt)
    return flow[:n, :n], flow[:n, -1], flow[:n, n : n + m], np.zeros((n, m))


def _tustin(cell: Cell, dt: float):
    n = cell.A.shape[0]
    left = np.eye(n) - 0.5 * dt * cell.A
    right = (np.eye(n) + 0.5 * dt * cell.A, dt * cell.a, 0.5 * dt * cell.B)
    A, a, B = (np.linalg.solve(left, part) for part in right)
    return A, a, B, B
