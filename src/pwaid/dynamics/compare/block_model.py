"""Linear output-error and Hammerstein–Wiener models of one input and one output.

    w = f(u),   x(k) = B(q)/F(q) w(k − n_k),   y = g(x) + offset

f and g are piecewise linear with `units` breakpoints, extended linearly (2014 Example 2 compares against such a
model with 10 units on either side); with no units they are the identity, and the model is linear output error.
B has n_b coefficients, F has n_f poles. All parameters are fitted by the simulation error with SciPy's
`least_squares` and exact derivatives. Breakpoints are fixed: those of f at equal steps over the range of u, those of
g likewise over the output of the linear model that the fit starts from, which least squares gives (ARX).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from pwaid.dynamics.fit_measures import rmse
from pwaid.errors import InputError
from pwaid.recording import check_finite

__all__ = ["BlockModel", "OrderSearch", "fit_block_model", "search_orders"]

# Poles are kept inside this circle: a slower one is a drift that the data cannot tell from an integrator.
LARGEST_POLE = 0.9999


def _hats(breaks: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Segment index, and the weights of its two ends, of the piecewise-linear basis, linear outside."""
    i = np.clip(np.searchsorted(breaks, x) - 1, 0, len(breaks) - 2)
    right = (x - breaks[i]) / (breaks[i + 1] - breaks[i])
    return i, 1.0 - right, right


def _basis(breaks: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The basis as a dense matrix, shape (N, units)."""
    i, left, right = _hats(breaks, x)
    H = np.zeros((len(x), len(breaks)))
    rows = np.arange(len(x))
    H[rows, i], H[rows, i + 1] = left, right
    return H


@dataclass(frozen=True, eq=False)
class BlockModel:
    """A fitted Hammerstein–Wiener or output-error model.

    Attributes
    ----------
    b, f : ndarray, shape (n_b,), (n_f,)
        B(q) = Σ b_i q^(−i), F(q) = 1 + Σ f_i q^(−i).
    delay : int
        n_k.
    input_breaks, input_values : ndarray, shape (units,), or None
        f; the identity when None.
    output_breaks, output_values : ndarray, shape (units,), or None
        g; the identity when None.
    offset : float
        Added to the output.
    """

    b: np.ndarray
    f: np.ndarray
    delay: int
    offset: float
    input_breaks: np.ndarray | None = None
    input_values: np.ndarray | None = None
    output_breaks: np.ndarray | None = None
    output_values: np.ndarray | None = None

    def simulate(self, u: Any) -> np.ndarray:
        """Output for the input u (N,), from rest, shape (N,)."""
        u = np.asarray(u, dtype=float).ravel()
        check_finite(u, "u")
        return self._stages(u)[2]

    @property
    def orders(self) -> tuple[int, int, int]:
        """(n_b, n_f, n_k)."""
        return len(self.b), len(self.f), self.delay

    def _stages(self, u):
        w = u if self.input_breaks is None else _basis(self.input_breaks, u) @ self.input_values
        x = lfilter(self._numerator, np.r_[1.0, self.f], w)
        y = x if self.output_breaks is None else _basis(self.output_breaks, x) @ self.output_values
        return w, x, y + self.offset

    @property
    def _numerator(self) -> np.ndarray:
        return np.r_[np.zeros(self.delay), self.b]

    # -- parameters as one vector [b, f, input values, output values, offset] -----------------------------------

    def _pack(self) -> np.ndarray:
        parts = [self.b, self.f]
        parts += [v for v in (self.input_values, self.output_values) if v is not None]
        return np.concatenate([*parts, [self.offset]])

    def _unpack(self, p: np.ndarray) -> BlockModel:
        sizes = [len(self.b), len(self.f)]
        sizes += [0 if v is None else len(v) for v in (self.input_values, self.output_values)]
        b, f, inside, outside = np.split(p[:-1], np.cumsum(sizes)[:-1])
        return BlockModel(
            b, f, self.delay, float(p[-1]),
            self.input_breaks, inside if self.input_breaks is not None else None,
            self.output_breaks, outside if self.output_breaks is not None else None,
        )  # fmt: skip

    def _is_stable(self) -> bool:
        return bool(np.all(np.abs(np.roots(np.r_[1.0, self.f])) < LARGEST_POLE))

    def _jacobian(self, u: np.ndarray) -> np.ndarray:
        """∂y/∂p, shape (N, parameters)."""
        w, x, _ = self._stages(u)
        F = np.r_[1.0, self.f]
        filtered_w, filtered_x = lfilter([1.0], F, w), lfilter([1.0], F, x)
        columns = [_delayed(filtered_w, self.delay + i) for i in range(len(self.b))]
        columns += [-_delayed(filtered_x, 1 + j) for j in range(len(self.f))]
        if self.input_breaks is not None:
            columns += list(lfilter(self._numerator, F, _basis(self.input_breaks, u), axis=0).T)
        J = np.column_stack(columns)
        if self.output_breaks is not None:
            i, _, _ = _hats(self.output_breaks, x)
            slope = (np.diff(self.output_values) / np.diff(self.output_breaks))[i]
            J = np.column_stack([J * slope[:, None], _basis(self.output_breaks, x)])
        return np.column_stack([J, np.ones(len(u))])


def _delayed(x: np.ndarray, n: int) -> np.ndarray:
    return np.r_[np.zeros(n), x[: len(x) - n]] if n else x


def _least_squares_start(u, y, n_b, n_f, delay) -> BlockModel:
    """ARX by least squares, unstable poles mirrored into the circle, offset from the means."""
    first = max(n_f, n_b - 1 + delay)
    uc, yc, n = u - u.mean(), y - y.mean(), len(u)
    columns = [uc[first - delay - i : n - delay - i] for i in range(n_b)]
    columns += [-yc[first - 1 - j : n - 1 - j] for j in range(n_f)]
    theta = np.linalg.lstsq(np.column_stack(columns), yc[first:], rcond=None)[0]
    roots = np.roots(np.r_[1.0, theta[n_b:]])
    size = np.abs(roots)
    inside = np.minimum(0.99, 1.0 / np.maximum(size, 1e-12))
    roots = np.where(size >= 0.995, roots / np.maximum(size, 1e-12) * inside, roots)
    f = np.real(np.poly(roots))[1:]
    gain = theta[:n_b].sum() / (1.0 + f.sum())
    return BlockModel(theta[:n_b], f, delay, float(y.mean() - gain * u.mean()))


def _improve(model: BlockModel, u, y, washout: int, evaluations: int) -> BlockModel:
    """Least simulation error from a starting model."""
    scale = float(y.std()) or 1.0

    def residual(p):
        trial = model._unpack(p)
        if not trial._is_stable():
            return np.full(len(y) - washout, 1e3)
        return (trial.simulate(u) - y)[washout:] / scale

    def jacobian(p):
        return model._unpack(p)._jacobian(u)[washout:] / scale

    found = least_squares(
        residual, model._pack(), jacobian, method="trf", x_scale="jac", max_nfev=evaluations, ftol=1e-6
    )
    return model._unpack(found.x)


def fit_block_model(
    u: Any,
    y: Any,
    orders: Sequence[int],
    *,
    units: int = 0,
    washout: int = 50,
    evaluations: int = 40,
) -> BlockModel:
    """Fit by simulation error.

    Parameters
    ----------
    u, y : array_like, shape (N,)
        Input and output, one recording.
    orders : (n_b, n_f, n_k)
        Zeros plus one, poles, input delay; n_b ≥ 1, n_f ≥ 1, n_k ≥ 0.
    units : int
        Breakpoints of f and of g; 0 for linear output error.
    washout : int
        First samples that do not count, because the initial state is unknown.
    evaluations : int
        At most this many simulations for the linear and for the nonlinear stage.

    Raises
    ------
    InputError
        Bad orders, or too few samples.
    """
    u, y = np.asarray(u, float).ravel(), np.asarray(y, float).ravel()
    check_finite(u, "u")
    check_finite(y, "y")
    n_b, n_f, delay = (int(n) for n in orders)
    if n_b < 1 or n_f < 1 or delay < 0 or units < 0 or units == 1:
        raise InputError(f"orders {tuple(orders)}, units {units}; expected n_b, n_f ≥ 1, n_k ≥ 0, units 0 or ≥ 2")
    if len(u) != len(y) or len(u) - washout < 4 * (n_b + n_f + 2 * units + 1):
        raise InputError(f"{len(u)} inputs and {len(y)} outputs came; expected equal numbers, several a parameter")
    model = _improve(_least_squares_start(u, y, n_b, n_f, delay), u, y, washout, evaluations)
    if units:
        x = model._stages(u)[1]
        inside, outside = _spread(u, units), _spread(x, units)
        model = BlockModel(model.b, model.f, delay, model.offset, inside, inside.copy(), outside, outside.copy())
        model = _improve(model, u, y, washout, evaluations)
    return model


def _spread(x: np.ndarray, units: int) -> np.ndarray:
    """Equally spaced breakpoints over the middle 99.8 % of x, widened a little."""
    low, high = np.quantile(x, [0.001, 0.999])
    return np.linspace(low, high, units) if high > low else low + np.linspace(-1.0, 1.0, units)


@dataclass(frozen=True, eq=False)
class OrderSearch:
    """The best model found and every order tried with its validation RMSE."""

    model: BlockModel
    tried: dict[tuple[int, int, int], float]


def search_orders(
    train: tuple[Any, Any],
    validation: tuple[Any, Any],
    *,
    units: int = 0,
    n_b: Sequence[int] = range(1, 11),
    n_f: Sequence[int] = range(1, 11),
    n_k: Sequence[int] = range(10),
    start: Sequence[int] = (2, 2, 0),
    washout: int = 50,
    evaluations: int = 40,
    search_samples: int = 5_000,
    progress: Callable[[str], None] | None = None,
) -> OrderSearch:
    """Orders with the least simulation RMSE on validation data (2014 eq. 23), searched one at a time.

    The 1000 combinations of (23) are not all fitted: from `start` each order runs through its range with the others
    kept, again and again until nothing improves. The search fits the first `search_samples` training samples; the
    orders found are then fitted to all of them.
    """
    u, y = (np.asarray(a, float).ravel() for a in train)
    uv, yv = (np.asarray(a, float).ravel() for a in validation)
    options = {"units": units, "washout": washout, "evaluations": evaluations}
    tried: dict[tuple[int, int, int], float] = {}

    def error(orders):
        if orders not in tried:
            model = fit_block_model(u[:search_samples], y[:search_samples], orders, **options)
            tried[orders] = rmse(yv[washout:], model.simulate(uv)[washout:])
            if progress:
                progress(f"orders {orders}: validation RMSE {tried[orders]:.4g}")
        return tried[orders]

    best = tuple(int(n) for n in start)
    while True:
        before = best
        for position, choices in ((2, n_k), (1, n_f), (0, n_b)):
            neighbours = [best[:position] + (int(c),) + best[position + 1 :] for c in choices]
            best = min([best, *neighbours], key=error)
        if best == before:
            break
    return OrderSearch(fit_block_model(u, y, best, **options), tried)
