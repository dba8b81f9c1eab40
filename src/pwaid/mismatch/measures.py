"""Fit measures per recording and output: RMSE, best-fit rate, variance accounted for, whiteness, share explained."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

__all__ = ["correlations", "fit_measures", "fit_table", "ljung_box"]

LAGS = 20


def correlations(r, lags: int) -> np.ndarray:
    """Autocorrelation of a residual (N,) at lags 1..lags, its mean removed; zeros for a constant one."""
    centred = r - np.mean(r)
    power = float(centred @ centred)
    if not power > 0:
        return np.zeros(lags)
    return np.array([centred[k:] @ centred[:-k] for k in range(1, lags + 1)]) / power


def ljung_box(r, lags: int = LAGS) -> tuple[float, float]:
    """Statistic and p-value of the hypothesis that a residual (N,) is white (Ljung and Box 1978).

    Q = N (N + 2) Σ ρ_k²/(N - k) over `lags` lags, fewer for short residuals; χ² with that many degrees of freedom.
    """
    n = len(r)
    lags = min(lags, n // 5)
    if lags < 1:
        return 0.0, 1.0
    rho = correlations(r, lags)
    q = float(n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, lags + 1))))
    return q, float(chi2.sf(q, lags))


def fit_measures(y, simulated) -> dict[str, float]:
    """RMSE in the output's unit, BFT and VAF in percent, lag-one correlation and whiteness of the residual."""
    r = y - simulated
    spread = float(np.linalg.norm(y - y.mean()))
    variance = float(np.var(y))
    statistic, p = ljung_box(r)
    return {
        "rmse": float(np.sqrt(np.mean(r**2))),
        "bft": float(100 * (1 - np.linalg.norm(r) / spread)) if spread > 0 else float("nan"),
        "vaf": float(100 * (1 - np.var(r) / variance)) if variance > 0 else float("nan"),
        "lag_one": float(correlations(r, 1)[0]) if len(r) > 1 else 0.0,
        "ljung_box": statistic,
        "whiteness_p": p,
    }


def share_of_explainable(rmse: float, before: float, floor: float) -> float:
    """Share of the squared error above the floor that is gone; NaN where `before` is at the floor already."""
    explainable = before**2 - floor**2
    return (before**2 - rmse**2) / explainable if explainable > 0.1 * floor**2 and explainable > 0 else float("nan")


def fit_table(data, output_names, simulations: dict[str, np.ndarray], floor=None) -> dict:
    """{recording: {output: {stage: measures}}} for simulated outputs (N, ny) by stage.

    With `floor` (ny,), the stage ``repaired`` also holds the share of the explainable error of the stage ``refitted``
    that it removes in that recording and output.
    """
    table: dict = {}
    for name, (a, b) in zip(data.names, data.recordings, strict=True):
        table[name] = {
            output: {stage: fit_measures(data.Y[a:b, k], Y[a:b, k]) for stage, Y in simulations.items()}
            for k, output in enumerate(output_names)}
        for k, output in enumerate(output_names if floor is not None else ()):
            stages = table[name][output]
            stages["repaired"]["share_explained"] = share_of_explainable(
                stages["repaired"]["rmse"], stages["refitted"]["rmse"], float(floor[k]))
    return table
