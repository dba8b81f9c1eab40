"""H-infinity norm with a certified upper bound and all its peak frequencies.

Two-step method (Bruinsma & Steinbuch 1990; Vizer et al. 2014, section 2.4): gamma is a singular value of
G(jw) exactly when jw is an eigenvalue of the Hamiltonian matrix

    H(gamma) = [ F            -B R^-1 B' ]      R = D'D - gamma² I,  F = A - B R^-1 D'C,
               [ gamma² C'S^-1 C    -F'  ]      S = D D' - gamma² I.

Raise a lower bound gamma until H(gamma (1 + 2 tol)) has no eigenvalue on the imaginary axis: that level is
then an upper bound. The crossings of the level eta * norm bracket every frequency band where the gain exceeds
that level. numpy only; the arithmetic is done on a balanced, time-scaled copy of the system.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.linalg

from pwaid.errors import InputError, SolverError
from pwaid.hinfstruct.statespace import Matrices, as_matrices, freeze, frequency_response

__all__ = ["HinfNorm", "hinf_norm"]

_EPS = np.finfo(float).eps


@dataclass(frozen=True)
class HinfNorm:
    """The H-infinity norm of a stable system.

    Attributes
    ----------
    value : float
        Largest gain found: sigma_max(G(j frequencies[0])), a true lower bound of the norm.
    upper : float
        Certified upper bound: no singular value of G reaches this level at any frequency.
    frequencies : array, shape (k,)
        Every peak (local maximum over frequency, 0 and inf included) whose gain is at least ``fraction *
        value``, highest first; rad/s.
    gains : array, shape (k,)
        sigma_max at these frequencies.
    fraction : float
    iterations : int
        Hamiltonian eigenvalue problems solved.
    """

    value: float
    upper: float
    frequencies: np.ndarray
    gains: np.ndarray
    fraction: float
    iterations: int

    def __post_init__(self):
        freeze(self)

    @property
    def frequency(self) -> float:
        """Frequency of the highest peak, rad/s."""
        return float(self.frequencies[0])

    def active(self, rtol: float = 1e-6) -> np.ndarray:
        """The peaks within ``rtol`` of the norm: the set Omega of (17), rad/s."""
        return self.frequencies[self.gains >= (1 - rtol) * self.value]


def hinf_norm(system, *, tol: float = 1e-10, fraction: float = 0.99, max_iterations: int = 60) -> HinfNorm:
    """H-infinity norm of a proper, stable system.

    Parameters
    ----------
    system : control.StateSpace or tuple (A, B, C, D)
        Continuous or discrete time; a discrete one is mapped by the bilinear transform, which keeps the norm.
    tol : float
        The certified bound is ``value * (1 + 2 tol)``.
    fraction : float
        Peaks with at least this fraction of the norm are returned, 0 < fraction <= 1.
    max_iterations : int
        Limit of the two-step iteration (it converges quadratically; 3 to 6 are usual).

    Returns
    -------
    HinfNorm

    Raises
    ------
    InputError
        Unstable system (the norm is infinite), bad matrices or options.
    SolverError
        No certificate within ``max_iterations``.

    Notes
    -----
    Bands above the level come from eigenvalues; peaks *within* one band are found on a grid refined around
    the poles, so two peaks whose valley stays above the level are both returned when the grid separates them.
    """
    if not 0 < fraction <= 1:
        raise InputError(f"fraction = {fraction}; expected a number in (0, 1]")
    if not 0 < tol < 0.1:
        raise InputError(f"tol = {tol}; expected a number in (0, 0.1), for example 1e-10")
    m = as_matrices(system)
    if not m.stable:
        worst = m.poles[np.argmax(m.poles.real if m.dt == 0 else np.abs(m.poles))]
        raise InputError(
            f"the system is not stable (pole {worst:.6g}), so its H-infinity norm is infinite; "
            "pass a stable system, or compare only its stable part"
        )
    if m.dt:
        continuous, back = _bilinear(m), lambda w: 2 / m.dt * np.arctan(w)
    else:
        continuous, back = m, lambda w: w
    scaled, unit = _scale(continuous)
    gain = _Gain(scaled) if scaled.order else None
    value, where = _start(scaled, gain)
    if gain is None or value <= gain.floor:  # a constant, or zero up to rounding (an exact difference)
        upper = value + (gain.floor if gain else 0.0)
        return HinfNorm(value, upper, np.zeros(1), np.array([value]), fraction, 0)
    count = 0
    for _ in range(5):
        value, where, upper, more = _two_step(gain, value, where, tol, max_iterations)
        count += more
        peaks, gains = _peaks(gain, value, min(fraction, 1 - 1e-9))
        if gains[0] < value:  # the refined peaks miss the best frequency seen, by rounding
            apart = np.array([not _same(w, where) for w in peaks])
            peaks, gains = np.append(where, peaks[apart]), np.append(value, gains[apart])
        value, where = float(gains[0]), float(peaks[0])
        if value <= upper:
            return HinfNorm(value, float(upper), back(peaks * unit), gains, fraction, count)
    if value - upper <= gain.floor:  # by rounding of the gains
        return HinfNorm(value, float(value + gain.floor), back(peaks * unit), gains, fraction, count)
    raise SolverError(f"the gain {value:.12g} keeps exceeding the certified level {upper:.12g}; loosen tol")


def _start(m: Matrices, gain: _Gain | None) -> tuple[float, float]:
    """A lower bound of the norm and its frequency: largest gain at 0, at infinity, around the poles."""
    grid = np.concatenate([_pole_grid(m), [0.1234, 0.7654, 1.618]])
    if gain is not None:
        grid = grid[np.argsort(-gain(grid, np.inf, 1.0))[:5]]
    return _highest(m, grid)


def _highest(m: Matrices, omega: np.ndarray) -> tuple[float, float]:
    """Largest gain over some frequencies, and where."""
    gains = gains_at(m, omega)
    best = int(np.argmax(gains))
    return float(gains[best]), float(omega[best])


def _bilinear(m: Matrices) -> Matrices:
    """Continuous system with the same values on the imaginary axis as m on the unit circle, s = (z - 1)/(z +
    1).
    """
    inverse = np.linalg.inv(m.A + np.eye(m.order))
    root2 = np.sqrt(2.0)
    return Matrices(
        inverse @ (m.A - np.eye(m.order)), root2 * inverse @ m.B,
        root2 * m.C @ inverse, m.D - m.C @ inverse @ m.B,
    )


def _scale(m: Matrices) -> tuple[Matrices, float]:
    """Balance the states and measure time so that the fastest pole has modulus one.

    Returns the frequency unit, rad/s.
    """
    if not m.order:
        return m, 1.0
    unit = float(np.max(np.abs(m.poles)))
    # Diagonal scaling of the whole realisation, so that large and small entries of B and C are evened out
    # too.
    nu, ny = m.B.shape[1], m.C.shape[0]
    block = np.zeros((m.order + nu + ny,) * 2)
    block[: m.order, : m.order] = m.A / unit
    block[: m.order, m.order : m.order + nu] = m.B / unit
    block[m.order + nu :, : m.order] = m.C
    _, (scale, _) = scipy.linalg.matrix_balance(block, permute=False, separate=True)
    d = scale[: m.order]
    return Matrices(m.A / unit * d / d[:, None], m.B / unit / d[:, None], m.C * d, m.D), unit


def gains_at(m: Matrices, omega) -> np.ndarray:
    """sigma_max(G(j omega))."""
    return _largest_singular(frequency_response(m, omega))


def _largest_singular(response: np.ndarray) -> np.ndarray:
    """sigma_max of a stack of matrices; closed forms for one and two columns or rows."""
    if response.shape[1] < response.shape[2]:
        response = np.swapaxes(response, 1, 2)
    columns = response.shape[2]
    if columns > 2:
        return np.linalg.svd(response, compute_uv=False)[:, 0]
    squares = np.sum(np.abs(response) ** 2, axis=1)
    if columns == 1:
        return np.sqrt(squares[:, 0])
    cross = np.abs(np.sum(response[:, :, 0].conj() * response[:, :, 1], axis=1))
    half = 0.5 * (squares[:, 0] - squares[:, 1])
    return np.sqrt(0.5 * (squares[:, 0] + squares[:, 1]) + np.hypot(half, cross))


class _Gain:
    """sigma_max(G(j omega)) on long grids: by partial fractions where accurate enough, else by solving.

    ``noise`` estimates the rounding error of the partial fractions, absolute; ``floor`` that of any
    evaluation.
    """

    def __init__(self, m: Matrices):
        self.m = m
        self.poles, vectors = np.linalg.eig(m.A)
        condition = np.linalg.cond(vectors)
        if not condition < 1e12:
            self.noise, self.floor = np.inf, 0.0
            return
        left = np.linalg.solve(vectors, m.B.astype(complex))
        self.residues = np.einsum("yi,iu->iyu", m.C @ vectors, left)
        size = np.linalg.norm(self.residues, axis=(1, 2)) / np.maximum(np.abs(self.poles.real), 1e-300)
        self.noise = 4 * _EPS * condition * float(size.max())
        self.floor = 1e2 * _EPS * float(size.max() + np.abs(m.D).max(initial=0.0))

    def __call__(self, omega: np.ndarray, value: float, accuracy: float) -> np.ndarray:
        """Gains, accurate to about ``accuracy * value``."""
        if np.isinf(self.noise) or self.noise > accuracy * value:
            return gains_at(self.m, omega)
        weights = np.zeros((omega.size, self.m.order), dtype=complex)
        finite = np.isfinite(omega)
        weights[finite] = 1 / (1j * omega[finite, None] - self.poles)
        return _largest_singular(self.m.D + np.tensordot(weights, self.residues, 1))


def _crossings(m: Matrices, gamma: float) -> np.ndarray:
    """Imaginary parts, >= 0, of the eigenvalues of H(gamma) that lie on the imaginary axis up to rounding.

    H does not exist where gamma is a singular value of D: a slightly lower level is taken there.
    """
    singular = np.linalg.svd(m.D, compute_uv=False)
    while np.any(np.abs(singular - gamma) <= 1e-9 * gamma):
        gamma *= 1.0 - 1e-7
    R = m.D.T @ m.D - gamma**2 * np.eye(m.D.shape[1])
    S = m.D @ m.D.T - gamma**2 * np.eye(m.D.shape[0])
    F = m.A - m.B @ np.linalg.solve(R, m.D.T @ m.C)
    # B and C are scaled by sqrt(gamma) each way, so both off-diagonal blocks have comparable size.
    H = np.block(
        [[F, -gamma * m.B @ np.linalg.solve(R, m.B.T)], [gamma * m.C.T @ np.linalg.solve(S, m.C), -F.T]]
    )
    values = np.linalg.eigvals(H)
    # A double eigenvalue just off the axis is perturbed by sqrt(eps): keep generous candidates, judge them by
    # gain.
    slack = 30 * np.sqrt(
        _EPS * np.linalg.norm(H, 1) * (np.abs(values) + _EPS)
    ) + 10 * _EPS * np.linalg.norm(H, 1)
    near = (np.abs(values.real) <= slack) & (values.imag >= 0)
    return np.unique(values.imag[near])


def _bands(crossings: np.ndarray) -> list[tuple[float, float]]:
    """Frequency bands where the gain may exceed a level:

    Intervals between its neighbouring candidate crossings.
    """
    edges = np.unique(np.concatenate([[0.0], crossings, [np.inf]]))
    return list(pairwise(edges))


def _middle(low: float, high: float) -> float:
    if np.isinf(high):
        return 2 * low + 1.0
    return 0.5 * (low + high)


def _two_step(
    gain: _Gain, value: float, where: float, tol: float, max_iterations: int
) -> tuple[float, float, float, int]:
    """Raise a lower bound until no singular value reaches value (1 + 2 tol).

    Returns the bound, its frequency, that level, and the iterations.
    """
    for count in range(1, max_iterations + 1):
        level = value * (1 + 2 * tol)
        candidates = _crossings(gain.m, level)
        if not candidates.size:
            return value, where, level, count
        points = np.unique([*candidates, *(_middle(a, b) for a, b in _bands(candidates))])
        # The best few, evaluated exactly: the lower bound must be a true gain.
        rough = gain(points, value, 1e-9)
        best, best_where = _highest(gain.m, points[np.argsort(-rough)[:3]])
        if best < level:  # the candidates lie near the axis, not on it, unless the gain climbs next to them
            near = candidates[gain(candidates, value, 1e-9) > 0.5 * value]
            if near.size:
                found, _ = _refine(gain, near, near * 1e-3 + 1e-9, value)
                best, best_where = max((best, best_where), _highest(gain.m, found))
        if best < level:
            value, where = max((value, where), (best, best_where))
            return value, where, level, count
        value, where = best, best_where
    raise SolverError(
        f"no certified H-infinity norm after {max_iterations} iterations; raise max_iterations or loosen tol"
    )


def _refine(
    gain: _Gain, centres: np.ndarray, widths: np.ndarray, value: float
) -> tuple[np.ndarray, np.ndarray]:
    """Local maximum of the gain near each centre: sample, move to the vertex of the best parabola, shrink."""
    pattern = np.linspace(-1.0, 1.0, 9)
    best_w, widths = centres.astype(float).copy(), widths.astype(float).copy()
    centres, best_g = best_w.copy(), gain(best_w, value, 1e-12)
    rows = np.arange(len(centres))
    for _ in range(30):
        trial = np.abs(centres[:, None] + widths[:, None] * pattern)
        values = gain(trial.ravel(), value, 1e-12).reshape(trial.shape)
        k = np.argmax(values, axis=1)
        better = values[rows, k] > best_g
        best_w[better], best_g[better] = trial[rows, k][better], values[rows, k][better]
        inside = (k > 0) & (k < pattern.size - 1)
        kk = np.clip(k, 1, pattern.size - 2)
        before, after = values[rows, kk - 1], values[rows, kk + 1]
        bend = np.minimum(before - 2 * values[rows, kk] + after, -1e-300)
        shift = np.where(inside, np.clip(0.5 * (before - after) / bend, -1, 1), 0.0)
        centres = np.abs(np.where(inside, trial[rows, k] + shift * widths * 0.25, best_w))
        # Neighbours within 1e-9 of the top: the vertex of the parabola is exact to rounding.
        flat = inside & (values[rows, kk] - np.minimum(before, after) <= 1e-9 * best_g)
        if np.all(flat | (widths <= 1e-9 * (centres + 1e-12))):
            break
        widths = widths * np.where(inside, 0.12, np.where(better, 1.0, 0.3))
    vertex = gains_at(gain.m, centres)  # the vertex is the better frequency where the gain is flat
    exact = gains_at(gain.m, best_w)
    take = vertex >= exact * (1 - 1e-13)
    return np.where(take, centres, best_w), np.where(take, vertex, exact)


def _peaks(gain: _Gain, value: float, fraction: float) -> tuple[np.ndarray, np.ndarray]:
    """All local maxima with gain >= fraction * value, highest first."""
    m = gain.m
    grid = _grid(m, value * fraction)
    gains = gain(grid, value, 1e-6)
    if gains.min() >= (1 - 1e-6) * value and gains_at(m, grid).min() >= (1 - 1e-12) * value:
        # All-pass: every frequency is active, two stand for all.
        return np.array([0.0, np.inf]), np.full(2, value)
    left, right = np.concatenate([[-np.inf], gains[:-1]]), np.concatenate([gains[1:], [-np.inf]])
    spots = np.flatnonzero((gains >= left) & (gains >= right) & (gains >= 0.98 * fraction * value))
    edge = (grid[spots] == 0) | np.isinf(grid[spots])
    found_w, found_g = grid[spots[edge]], gains_at(m, grid[spots[edge]])
    inner = spots[~edge]
    if inner.size:
        before = grid[inner - 1]
        after = np.where(np.isinf(grid[inner + 1]), 2 * grid[inner], grid[inner + 1])
        w, g = _refine(gain, grid[inner], np.maximum(grid[inner] - before, after - grid[inner]), value)
        found_w, found_g = np.concatenate([found_w, w]), np.concatenate([found_g, g])
    if not found_g.size or found_g.max() < fraction * value:
        best = int(np.argmax(gains_at(m, grid)))
        found_w, found_g = grid[best : best + 1], gains_at(m, grid[best : best + 1])
        value = min(value, float(found_g[0]))
    keep = found_g >= fraction * value
    found_w, found_g = found_w[keep], found_g[keep]
    chosen: list[int] = []
    for k in np.argsort(-found_g, kind="stable"):
        if all(not _same(found_w[k], found_w[j]) for j in chosen):
            chosen.append(int(k))
    return found_w[chosen], found_g[chosen]


def _same(w1: float, w2: float) -> bool:
    if np.isinf(w1) or np.isinf(w2):
        return bool(w1 == w2)
    return bool(abs(w1 - w2) <= 1e-6 * max(w1, w2) + 1e-12)


def _pole_grid(m: Matrices) -> np.ndarray:
    """0, inf, and frequencies around the poles:

    Their moduli, and their imaginary parts give or take the half-widths.
    """
    if not m.order:
        return np.array([0.0, np.inf])
    poles = m.poles
    near = np.abs(poles.imag)[:, None] + np.outer(np.abs(poles.real), [-3, -1, -0.3, 0, 0.3, 1, 3])
    return np.unique(np.abs(np.concatenate([[0.0, np.inf], np.abs(poles), near.ravel()])))


def _grid(m: Matrices, level: float) -> np.ndarray:
    """Frequencies dense enough to separate the peaks: bands above the level, poles and their half-widths."""
    size = np.abs(m.poles)
    parts = [_pole_grid(m), np.geomspace(0.02 * size.min(), 50 * size.max(), 60)]
    for low, high in _bands(_crossings(m, level)):
        parts.append(np.linspace(low, high if np.isfinite(high) else max(10 * low, 50 * size.max()), 9))
    return np.unique(np.concatenate(parts))
