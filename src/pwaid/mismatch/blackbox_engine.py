"""Effects around a black box: input laws, the user's call, output laws.

    u -> [laws at the command, in a row] -> gain -> simulate(·) -> [laws at the sensor, in a row] -> y

The kernels are those of the catalogue: phases 0 and 1 at every sample before the call, phase 3 after it. Laws
that read a state cannot act here, because a black box shows none.
"""

from __future__ import annotations

import numpy as np
from numba import float64 as f8
from numba import int64 as i8
from numba import njit, types

from pwaid.mismatch.engine import EFFECT_TYPE, _input_at

__all__ = ["simulate_black_box"]

_V, _M = f8[::1], f8[:, ::1]


@njit(types.void(EFFECT_TYPE, _M, _V, f8, _V, _M, i8[::1], _V, _M), cache=True, nogil=True, error_model="numpy")
def _before(effect, U, delay, Ts, x, P, ii, q, V):
    """One law at the command over one recording: V from U; parameters it changes are changed in P."""
    n, nu = U.shape
    u, xs, dx = np.empty(nu), np.empty(x.size), np.zeros(x.size)
    for k in range(n):
        t = k * Ts
        _input_at(U, 0, n, k, 0, 1, delay, u, Ts, 0.0)
        xs[:] = x
        effect(0, t, Ts, x, xs, u, P[k], dx, ii, q)
        V[k] = u
        effect(1, t, Ts, x, xs, V[k], P[k], dx, ii, q)


@njit(types.void(EFFECT_TYPE, _M, _M, f8, _V, _M, i8[::1], _V), cache=True, nogil=True, error_model="numpy")
def _behind(effect, Y, U, Ts, x, P, ii, q):
    """One law at the sensors over one recording, in place."""
    xs = x.copy()
    for k in range(len(Y)):
        effect(3, k * Ts, Ts, x, xs, U[k], P[k], Y[k], ii, q)


def simulate_black_box(model, p, Q, delay, X0, data, limit: float):
    """Outputs (N, ny) and states (N, nx + extra) over every recording of a data set.

    Parameters
    ----------
    model : its plant is a black box. p : (n_parameters,). Q : (3, width) parameters of the laws.
    delay : (n_inputs,) seconds. X0 : (n_segments, nx) starts relative to the nominal one; the first segment of
    each recording counts.
    """
    plant = model.settings.plant
    box, nu = plant.black_box, len(plant.input_names)
    Y, X = np.empty_like(data.Y), np.zeros((len(data.Y), model.nx + model.extra))
    for r, (a, b) in enumerate(data.recordings):
        lead = data.before[r] if data.before else data.U[:0]
        U = np.zeros((len(lead) + b - a, nu + len(plant.force_names)))
        U[:, :nu] = np.vstack([lead, data.U[a:b]])
        moved = X0[np.flatnonzero(data.segments[:, 0] == a)[0]] if model.nx else np.zeros(0)
        X[a:b, :model.nx] = moved
        Y[a:b] = _one(model, box, U, p, Q, delay, moved, data.sample_time, len(lead), limit)
    return Y, X


def _one(model, box, U, p, Q, delay, moved, Ts, lead, limit):
    P, x = np.repeat(p[None], len(U), axis=0), np.zeros(model.nx + model.extra)
    ports = np.zeros(U.shape[1])
    for k, e in enumerate(model.acting):
        if e.place.kind == "output":
            continue
        ports[:len(delay)] = delay if e.effect.delays else 0.0
        _memory(e, model.II[k], U, x)
        V = np.empty_like(U)
        _before(model.kernels[k], U, ports, Ts, x, P, model.II[k], Q[k], V)
        U = V
    params = {n: v for n, v in zip(model.settings.plant.parameters, p, strict=False) if n in box.parameters}
    for j, i in model.settings.plant.gains:
        U[:, j] *= P[:, i]
    y = box.run(U, params, moved)
    if y is None or not np.all(np.abs(y) <= limit):
        return np.full((len(U) - lead, len(box.outputs)), limit)
    y = y.copy()
    for k, e in enumerate(model.acting):
        if e.place.kind == "output":
            _behind(model.kernels[k], y, U, Ts, x, P, model.II[k], Q[k])
    return y[lead:]


def _memory(located, ii, U, x):
    """The start of a law's memory."""
    if located.effect.start == "input":
        x[ii[0]:ii[0] + located.effect.extra_states] = U[0, ii[8]]
