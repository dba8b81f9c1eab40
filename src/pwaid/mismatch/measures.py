"""Fit measures per recording and output: RMSE, best-fit rate, variance accounted for, whiteness."""

from __future__ import annotations

import numpy as np

__all__ = ["fit_measures", "fit_table"]


def fit_measures(y, simulated) -> dict[str, float]:
    """RMSE in the output's unit, BFT and VAF in percent, and the lag-one correlation of the residual."""
    r = y - simulated
    spread = float(np.linalg.norm(y - y.mean()))
    variance = float(np.var(y))
    centred = r - r.mean()
    power = float(centred @ centred)
    return {
        "rmse": float(np.sqrt(np.mean(r**2))),
        "bft": float(100 * (1 - np.linalg.norm(r) / spread)) if spread > 0 else float("nan"),
        "vaf": float(100 * (1 - np.var(r) / variance)) if variance > 0 else float("nan"),
        "lag_one": float(centred[1:] @ centred[:-1] / power) if power > 0 else 0.0,
    }


def fit_table(data, output_names, simulations: dict[str, np.ndarray]) -> dict:
    """{recording: {output: {stage: measures}}} for simulated outputs (N, ny) by stage."""
    table: dict = {}
    for name, (a, b) in zip(data.names, data.recordings, strict=True):
        table[name] = {
            output: {stage: fit_measures(data.Y[a:b, k], Y[a:b, k]) for stage, Y in simulations.items()}
            for k, output in enumerate(output_names)}
    return table
