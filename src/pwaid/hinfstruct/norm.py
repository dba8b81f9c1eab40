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
from pwaid.hinfstruct.statespace import Matrices, as_matrices, frequency_response

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
    fraction_inside = min(fraction, 1 - 1e-9)
    start_grid = np.concatenate([_pole_grid(scaled), [0.1234, 0.7654, 1.618]])
    start = float(np.max(gains_at(scaled, start_grid[np.argsort(-_scan(scaled, start_grid))[:3]])))
    value, upper, count = _two_step(scaled, start, tol, max_iterations)
    if value <= 0.0:
        return HinfNorm(0.0, 0.0, np.zeros(1), np.zeros(1), fraction, count)
    for _ in range(5):
        peaks, gains = _peaks(scaled, value, fraction_inside)
        if gains[0] <= upper:
            return HinfNorm(float(gains[0]), float(upper), back(peaks * unit), gains, fraction, count)
        value, upper, more = _two_step(scaled, float(gains[0]), tol, max_iterations)
        count += more
    raise SolverError(
        f"the gain {gains[0]:.12g} keeps exceeding the certified level {upper:.12g}; loosen tol"
    )


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


def _scan(m: Matrices, omega: np.ndarray) -> np.ndarray:
    """The gains on a long grid, from the partial fractions when the eigenvectors allow it (about 1e-9
    relative).
    """
    values, vectors = np.linalg.eig(m.A)
    if np.linalg.cond(vectors) > 1e6:
        return gains_at(m, omega)
    residues = np.einsum("yi,iu->iyu", m.C @ vectors, np.linalg.solve(vectors, m.B.astype(complex)))
    finite = np.isfinite(omega)
    weights = np.zeros((omega.size, m.order), dtype=complex)
    weights[finite] = 1 / (1j * omega[finite, None] - values)
    return _largest_singular(m.D + np.tensordot(weights, residues, 1))


def _crossings(m: Matrices, gamma: float) -> np.ndarray:
    """Imaginary parts, >= 0, of the eigenvalues of H(gamma) that lie on the imaginary axis up to rounding."""
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


def _highest(m: Matrices, omega: np.ndarray) -> tuple[float, float]:
    """Largest gain over some frequencies, and where."""
    gains = gains_at(m, omega)
    best = int(np.argmax(gains))
    return float(gains[best]), float(omega[best])


def _two_step(m: Matrices, value: float, tol: float, max_iterations: int) -> tuple[float, float, int]:
    """Raise a lower bound until no singular value reaches value (1 + 2 tol).

    Returns (value, that level, iterations).
    """
    if value <= 1e-300 or not m.order:
        return value if value > 1e-300 else 0.0, value, 0
    for count in range(1, max_iterations + 1):
        level = value * (1 + 2 * tol)
        candidates = _crossings(m, level)
        if not candidates.size:
            return value, level, count
        points = np.unique([*candidates, *(_middle(a, b) for a, b in _bands(candidates))])
        best, _ = _highest(m, points)
        # the candidates lie near the axis, not on it, unless the gain climbs next to one of them
        if best < level:
            best = max(best, _climb(m, candidates))
        if best < level:
            return max(value, best), level, count
        value = best
    raise SolverError(
        f"no certified H-infinity norm after {max_iterations} iterations; raise max_iterations or loosen tol"
    )


def _climb(m: Matrices, points: np.ndarray) -> float:
    """Highest gain reached by refining around each suspicious frequency."""
    _, gains = _refine(m, points, np.maximum(points, _EPS) * 1e-3 + 1e-9)
    return float(np.max(gains))


def _refine(m: Matrices, centres: np.ndarray, widths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Local maximum of the gain near each centre:

    Sample, move to the vertex of the best parabola, shrink; all at once.
    """
    pattern = np.linspace(-1.0, 1.0, 9)
    centres, widths = centres.astype(float).copy(), widths.astype(float).copy()
    best_w, best_g = centres.copy(), gains_at(m, centres)
    rows = np.arange(len(centres))
    for _ in range(30):
        trial = np.abs(centres[:, None] + widths[:, None] * pattern)
        values = gains_at(m, trial.ravel()).reshape(trial.shape)
        k = np.argmax(values, axis=1)
        top = values[rows, k]
        gained = top - best_g
        better = gained > 0
        best_w[better], best_g[better] = trial[rows, k][better], top[better]
        inside = (k > 0) & (k < pattern.size - 1)
        kk = np.clip(k, 1, pattern.size - 2)
        before, after = values[rows, kk - 1], values[rows, kk + 1]
        bend = np.minimum(before - 2 * values[rows, kk] + after, -1e-300)
        shift = np.where(inside, np.clip(0.5 * (before - after) / bend, -1, 1), 0.0)
        centres = np.abs(best_w + np.where(better, shift * widths * 0.25, 0.0))
        widths = widths * np.where(inside, 0.12, np.where(better, 1.0, 0.3))
        flat = inside & (gained <= 1e-14 * best_g) & (widths < 1e-3 * centres)
        if np.all(flat | (widths <= 1e-9 * (centres + 1e-12))):
            break
    return best_w, best_g


def _peaks(m: Matrices, value: float, fraction: float) -> tuple[np.ndarray, np.ndarray]:
    """All local maxima with gain >= fraction * value, highest first."""
    if not m.order or value == 0.0:
        return np.array([0.0]), np.array([value])
    grid = _grid(m, value * fraction)
    gains = _scan(m, grid)
    if gains.min() >= (1 - 1e-12) * value:  # all-pass: every frequency is active, two stand for all
        return np.array([0.0, np.inf]), gains[[0, -1]]
    left, right = np.concatenate([[-np.inf], gains[:-1]]), np.concatenate([gains[1:], [-np.inf]])
    spots = np.flatnonzero((gains >= left) & (gains >= right) & (gains >= 0.98 * fraction * value))
    inner = spots[(spots > 0) & (spots < grid.size - 1)]
    found_w, found_g = grid[np.isin(np.arange(grid.size), spots) & ((grid == 0) | np.isinf(grid))], None
    found_g = gains_at(m, found_w) if found_w.size else np.zeros(0)
    if inner.size:
        before, after = grid[inner - 1], np.where(np.isinf(grid[inner + 1]), 2 * grid[inner], grid[inner + 1])
        w, g = _refine(m, grid[inner], np.maximum(grid[inner] - before, after - grid[inner]))
        found_w, found_g = np.concatenate([found_w, w]), np.concatenate([found_g, g])
    keep = found_g >= fraction * value
    found_w, found_g = found_w[keep], found_g[keep]
    order = np.argsort(-found_g, kind="stable")
    chosen: list[int] = []
    for k in order:
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
