"""The unknown input: what would have to push on the refitted simulator for it to follow the recording.

Along the refitted nominal trajectory the plant is linearised, and a random walk d is added to one state
derivative or one input:

    δx[k+1] = A[k] δx[k] + B[k] d[k],   d[k+1] = d[k] + w[k],   y[k] - y_nominal[k] = C[k] δx[k] + D[k] d[k] + e[k]

A Kalman filter with one scalar update per output gives the marginal likelihood, which picks the intensity of
w on a logarithmic grid; the backward pass of Bryson and Frazier gives d with its posterior variance. Nothing
is differentiated, and no covariance is inverted. Jumps of d come out smeared over `Unknown.rise` seconds.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.linalg import expm

from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.plant import Plant

__all__ = ["Linearised", "Unknown", "linearise", "smooth", "unknown_inputs"]

SAMPLES = 3000
GRID = np.geomspace(1e-2, 30.0, 8)  # typical change of d over one time scale, in units of the channel's scale


@dataclass(frozen=True)
class Linearised:
    """The plant along its nominal trajectory at N instants `h` seconds apart, its rates of change linearised.

    `states` (N, nx), `inputs` (N, nu), `residual` (N, ny), `F` (N, nx, nx), `G` (N, nx, nu), `C` (N, ny, nx),
    `D` (N, ny, nu), `segments` (n, 2), `time` (N,) within the recording, `noise` (ny,) standard deviation.
    """

    states: np.ndarray
    inputs: np.ndarray
    residual: np.ndarray
    F: np.ndarray
    G: np.ndarray
    C: np.ndarray
    D: np.ndarray
    segments: np.ndarray
    time: np.ndarray
    noise: np.ndarray
    h: float
    discrete: bool = False

    def transition(self, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A (N, nx, nx) and B (N, nx) over one interval, for a d that enters along `column` (N, nx)."""
        nx = self.F.shape[1]
        if self.discrete:
            return np.eye(nx) + self.h * self.F, self.h * column
        M = np.zeros((len(self.F), nx + 1, nx + 1))
        M[:, :nx, :nx], M[:, :nx, nx] = self.F * self.h, column * self.h
        same = bool(np.all(M[0] == M))
        E = np.broadcast_to(expm(M[0]), M.shape) if same else expm(M)
        return np.ascontiguousarray(E[:, :nx, :nx]), np.ascontiguousarray(E[:, :nx, nx])


@dataclass(frozen=True)
class Unknown:
    """The unknown input at one place.

    `value`, `deviation` (N,): d and its posterior standard deviation; `states` (N, nx): the smoothed states;
    `log_likelihood`: marginal, at the best intensity; `rise`: seconds over which a jump is smeared; `same`:
    channels that enter the same way up to a factor, which no recording can tell apart.
    """

    channel: str
    value: np.ndarray
    deviation: np.ndarray
    states: np.ndarray
    log_likelihood: float
    rise: float
    same: tuple[str, ...] = ()


@njit(cache=True, nogil=True, error_model="numpy")
def _times(M, v, out, turned):
    """M v, or Mᵀ v, into out; loops, because BLAS calls cost more than these sizes do."""
    for i in range(v.size):
        total = 0.0
        for j in range(v.size):
            total += (M[j, i] if turned else M[i, j]) * v[j]
        out[i] = total


@njit(cache=True, nogil=True, error_model="numpy")
def _sandwich(M, S, work, turned):
    """S becomes M S Mᵀ, or Mᵀ S M."""
    n = S.shape[0]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += (M[k, i] if turned else M[i, k]) * S[k, j]
            work[i, j] = total
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += work[i, k] * (M[k, j] if turned else M[j, k])
            S[i, j] = total


@njit(cache=True, nogil=True, error_model="numpy")
def _step_matrix(A, B, k, T):
    """[δx; d] over one interval."""
    n = A.shape[1]
    for i in range(n):
        for j in range(n):
            T[i, j] = A[k, i, j]
        T[i, n], T[n, i] = B[k, i], 0.0
    T[n, n] = 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _row(C, D, k, o, c):
    """Row of output o at k over [δx; d]."""
    for i in range(C.shape[2]):
        c[i] = C[k, o, i]
    c[c.size - 1] = D[k, o]


@njit(cache=True, nogil=True, error_model="numpy")
def _backward(A, B, C, D, first, last, xs, Ps, Ks, es, ss, d, var, states):
    """Bryson and Frazier's adjoint pass over one segment: smoothed states, d, and the variance of d."""
    m, z = C.shape[1], xs.shape[1]
    n = z - 1
    lam, new, c = np.zeros(z), np.empty(z), np.empty(z)
    Lam, S, T, work = np.zeros((z, z)), np.empty((z, z)), np.zeros((z, z)), np.empty((z, z))
    for k in range(last - 1, first - 1, -1):
        if k < last - 1:
            _step_matrix(A, B, k, T)
            _times(T, lam, new, True)
            for i in range(z):
                lam[i] = new[i]
            _sandwich(T, Lam, work, True)
        for o in range(m - 1, -1, -1):
            _row(C, D, k, o, c)
            along = es[k, o] / ss[k, o]
            for i in range(z):
                along += Ks[k, o, i] * lam[i]
            for i in range(z):
                for j in range(z):
                    S[i, j] = (1.0 if i == j else 0.0) - Ks[k, o, i] * c[j]
            _sandwich(S, Lam, work, True)
            for i in range(z):
                lam[i] -= c[i] * along
                for j in range(z):
                    Lam[i, j] += c[i] * c[j] / ss[k, o]
        _times(Ps[k], lam, new, False)
        for i in range(n):
            states[k, i] = xs[k, i] - new[i]
        d[k] = xs[k, n] - new[n]
        _times(Lam, Ps[k, n], new, False)
        var[k] = Ps[k, n, n]
        for i in range(z):
            var[k] -= Ps[k, n, i] * new[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _filter_and_smooth(A, B, C, D, Y, R, q, P0, segments, want, d, var, states):
    """Marginal log-likelihood; fills d, var and states when `want`.

    A (N, n, n), B (N, n), C (N, m, n), D (N, m), Y (N, m), R (m,) variances, q variance of one step of d,
    P0 (n + 1,) start variances of [δx; d].
    """
    N, m, n = C.shape
    z = n + 1
    xs, Ps = np.empty((N, z)), np.empty((N, z, z))
    Ks, es, ss = np.empty((N, m, z)), np.empty((N, m)), np.empty((N, m))
    x, P, c, K, new = np.zeros(z), np.zeros((z, z)), np.empty(z), np.empty(z), np.empty(z)
    T, work, total = np.zeros((z, z)), np.empty((z, z)), 0.0
    for g in range(segments.shape[0]):
        first, last = segments[g, 0], segments[g, 1]
        for i in range(z):
            x[i] = 0.0
            for j in range(z):
                P[i, j] = P0[i] if i == j else 0.0
        for k in range(first, last):
            for i in range(z):
                xs[k, i] = x[i]
                for j in range(z):
                    Ps[k, i, j] = P[i, j]
            for o in range(m):
                _row(C, D, k, o, c)
                _times(P, c, K, False)
                s, e = R[o], Y[k, o]
                for i in range(z):
                    s += c[i] * K[i]
                    e -= c[i] * x[i]
                total -= 0.5 * (np.log(6.283185307179586 * s) + e * e / s)
                es[k, o], ss[k, o] = e, s
                for i in range(z):
                    K[i] /= s
                    Ks[k, o, i] = K[i]
                    x[i] += K[i] * e
                for i in range(z):
                    for j in range(z):
                        P[i, j] -= s * K[i] * K[j]
            _step_matrix(A, B, k, T)
            _times(T, x, new, False)
            for i in range(z):
                x[i] = new[i]
            _sandwich(T, P, work, False)
            P[n, n] += q
        if want:
            _backward(A, B, C, D, first, last, xs, Ps, Ks, es, ss, d, var, states)
    return total


def smooth(line: Linearised, column, feed, scale: float, start: np.ndarray, time_scale: float,
           channel: str = "") -> Unknown:
    """The unknown input that enters along `column` (N, nx) of the derivatives and `feed` (N, ny) of the outputs.

    Parameters
    ----------
    scale : typical size of d. start : (nx,) standard deviation of the start states' errors.
    time_scale : seconds over which d may change by about `scale`.
    """
    N, ny, nx = line.C.shape
    A, B = line.transition(np.ascontiguousarray(column, dtype=float))
    feed, R = np.ascontiguousarray(feed, dtype=float), line.noise**2
    P0 = np.append(np.asarray(start, dtype=float) ** 2, (10 * scale) ** 2)
    d, var, states = np.zeros(N), np.zeros(N), np.zeros((N, nx))

    def run(q, want, Y=line.residual, segments=line.segments):
        return _filter_and_smooth(A, B, line.C, feed, np.ascontiguousarray(Y), R, q, P0, segments, want, d, var,
                                  states)

    intensities = (scale * GRID) ** 2 * line.h / time_scale
    values = np.array([run(q, False) for q in intensities])
    values[~np.isfinite(values)] = -np.inf
    best = float(intensities[int(np.argmax(values))])
    rise = _rise(run, best, A, B, line, feed, d)
    level = run(best, True)
    return Unknown(channel, d.copy(), np.sqrt(np.maximum(var, 1e-12 * scale**2)), line.states + states, float(level),
                   rise)


def _rise(run, q, A, B, line, feed, d) -> float:
    """Time in which a step in the middle of the longest segment comes out from 10 to 90 %."""
    a, b = max(line.segments, key=lambda s: s[1] - s[0])
    mid, x = (a + b) // 2, np.zeros(A.shape[1])
    Y = np.zeros_like(line.residual)
    for k in range(a, b):
        on = float(k >= mid)
        Y[k] = line.C[k] @ x + feed[k] * on
        x = A[k] @ x + B[k] * on
    run(q, True, Y, np.array([[a, b]]))
    step = d[a:b]
    before, after = np.flatnonzero(step[:mid - a] < 0.1), np.flatnonzero(step[mid - a:] > 0.9)
    if not before.size or not after.size:
        return float((b - a) * line.h)
    return float((mid - a - before[-1] + after[0]) * line.h)


def linearise(problem: Problem, samples: int = SAMPLES) -> Linearised | None:
    """The plant along the null trajectory on segments of the training recordings, averaged to about `samples` instants.

    None where the null simulation ran away, for a black box, and without states. Intervals stay below a tenth of the
    plant's time scale; what is then still too long is shortened to the head of every segment.
    """
    plant, data, fit = problem.plant, problem.coarse, problem.null_coarse
    nx = plant.sizes[0]
    if plant.black_box is not None or not nx:
        return None
    most = max(1, int(0.1 * problem.structure.time_scale / data.sample_time))
    every = 1 if plant.dt else max(1, min(most, len(data.Y) // samples))
    left = max(20, int(samples * every * 1.5) // len(data.segments))
    residual, rows, pieces, clock = fit.residual(data), [], [], []
    for a, b, start in data.segments[:, :3]:
        n = min(int(b - a), left) // every
        if n >= 10:
            pieces.append(a + np.arange(n * every).reshape(n, every))
            clock.append((pieces[-1].mean(axis=1) - start) * data.sample_time)
            rows.append(n)
    if not pieces:
        return None
    index = np.vstack(pieces)
    X, U, r = (np.ascontiguousarray(M[index].mean(axis=1)) for M in (fit.X[:, :nx], data.U, residual))
    if not (np.all(np.isfinite(X)) and np.all(np.abs(r) < 1e6)):
        return None
    ends = np.cumsum([0, *rows])
    noise = np.maximum(problem.floor.level, 1e-4 * np.std(data.Y, axis=0) + 1e-12) / np.sqrt(every)
    F, G, C, D = _jacobians(plant, fit.model.parameters(fit.theta), X, U, problem.ranges,
                            np.maximum(problem.structure.input_max, 1e-6))
    if not all(np.all(np.isfinite(M)) for M in (F, G, C, D)):
        return None
    return Linearised(X, U, r, F, G, C, D, np.array(list(itertools.pairwise(ends)), dtype=np.int64),
                      np.concatenate(clock), noise, every * data.sample_time, bool(plant.dt))


def _jacobians(plant: Plant, p, X, U, ranges, input_max):
    """∂f/∂x, ∂f/∂u, ∂g/∂x, ∂g/∂u by central differences at every instant; once where they never change."""
    def at(k):
        x, u = X[k], U[k]
        columns = []
        for i in range(len(x)):
            e = np.zeros(len(x))
            e[i] = 1e-4 * max(ranges[i], 1e-9)
            columns.append([(f(x + e, u, p) - f(x - e, u, p)) / (2 * e[i]) for f in (plant.derivative, plant.outputs)])
        for j in range(len(u)):
            e = np.zeros(len(u))
            e[j] = 1e-4 * input_max[j]
            columns.append([(f(x, u + e, p) - f(x, u - e, p)) / (2 * e[j]) for f in (plant.derivative, plant.outputs)])
        return np.array([c[0] for c in columns]).T, np.array([c[1] for c in columns]).T

    nx, N = X.shape[1], len(X)
    probe = [at(k) for k in np.linspace(0, N - 1, 6).astype(int)]
    constant = all(np.allclose(a, b, rtol=1e-5, atol=1e-7 * (1 + np.abs(b).max()))
                   for q in probe[1:] for a, b in zip(q, probe[0], strict=True))
    if constant or plant.linear:
        S, O = (np.repeat(M[None], N, axis=0) for M in probe[0])
    else:
        found = [at(k) for k in range(N)]
        S, O = np.array([f[0] for f in found]), np.array([f[1] for f in found])
    return tuple(np.ascontiguousarray(M) for M in (S[:, :, :nx], S[:, :, nx:], O[:, :, :nx], O[:, :, nx:]))


def unknown_inputs(problem: Problem, line: Linearised) -> list[Unknown]:
    """The unknown input at every speed or store (as a force where a speed's inertia is known) and at every
    input, the most likely first."""
    s, found = problem.structure, []
    N, ny, nx = line.C.shape
    start = np.maximum(problem.ranges, 1e-9)
    places = []
    for i, kind in enumerate(s.kinds):
        if kind != "position":
            column, gain = np.zeros((N, nx)), s.mobility.get(i, 1.0)
            column[:, i] = gain
            size = s.force_scale.get(i, s.reach(i) / s.time_scale)
            places.append((f"state:{s.plant.state_names[i]}", column, np.zeros((N, ny)), size))
    for j, name in enumerate(s.plant.input_names):
        places.append((f"input:{name}", line.G[:, :, j], line.D[:, :, j], float(s.input_rms[j])))
    directions = {place[0]: _direction(place[1], place[2]) for place in places}
    for channel, column, feed, size in places:
        unknown = smooth(line, column, feed, max(size, 1e-12), start, max(s.time_scale, line.h), channel)
        same = tuple(c for c, v in directions.items()
                     if c != channel and abs(np.sum(v * directions[channel])) > 1 - 1e-9)
        if np.isfinite(unknown.log_likelihood):
            found.append(replace(unknown, same=same))
    return sorted(found, key=lambda u: -u.log_likelihood)


def _direction(column, feed) -> np.ndarray:
    """How d enters, without its size."""
    M = np.hstack([column, feed])
    return M / max(float(np.sqrt(np.sum(M**2))), 1e-300)
