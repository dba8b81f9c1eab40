"""How much of a residual still follows from the inputs: what physics leaves, and a disturbance does not.

A residual that a flexible model learned on the training recordings predicts on held-out ones is a function of what
drove the machine: some law is missing there, or a wrong one stands in its place. A disturbance cannot be predicted
so, however large it is. The regressors are the simulated states and the inputs at several lags with their moduli,
signed squares and signs, time, and its products with them (a drift is alike in every recording); ridge regression
keeps them from fitting noise.
"""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit

__all__ = ["predictability"]

LAGS, SHAPED = 8, 3  # lags in all, and those with nonlinear regressors too
RIDGE = 0.01  # of the samples: an R² of 0.01 per regressor is not worth fitting


def _regressors(data: Dataset, fit: Fit, step: int) -> np.ndarray:
    Z = np.hstack([fit.X[:, :fit.model.nx], data.U])
    rows = []
    for a, b, begin in data.segments[:, :3]:
        z, t = Z[a:b], ((np.arange(a, b) - begin) * data.sample_time)[:, None]
        columns = [t, t * z]
        for k in range(LAGS):
            shift = min(k * step, len(z))
            late = np.vstack([np.repeat(z[:1], shift, axis=0), z[:len(z) - shift]])
            columns.append(late)
            if k < SHAPED:
                columns += [np.abs(late), late * np.abs(late), np.sign(late)]
        rows.append(np.hstack(columns))
    return np.vstack(rows)


def predictability(train: Dataset, fit: Fit, test: Dataset, held: Fit, time_scale: float) -> np.ndarray:
    """Share of each output's held-out residual that what was learned on the training residual predicts, (ny,).

    Parameters
    ----------
    train, fit : training recordings and the simulation fitted to them. test, held : held-out ones.
    time_scale : seconds; lags are thirds of it.
    """
    step = max(1, int(time_scale / train.sample_time / 3))
    A, B = _regressors(train, fit, step), _regressors(test, held, step)
    centre, spread = A.mean(0), A.std(0) + 1e-12
    A, B = (A - centre) / spread, np.clip((B - centre) / spread, -5.0, 5.0)
    r, q = train.Y - fit.Y, test.Y - held.Y
    w = np.linalg.solve(A.T @ A + RIDGE * len(A) * np.eye(A.shape[1]), A.T @ (r - r.mean(0)))
    left = q - r.mean(0) - B @ w
    return 1.0 - np.mean(left**2, axis=0) / np.maximum(np.mean(q**2, axis=0), 1e-300)
