"""Baseline: nominal simulator with refitted parameters plus a Gaussian process of its residual. Error only,
no name.

The process sees the simulated output and the input, now and at two lags; its training points are thinned to
`POINTS`. Its held-out error is what a flexible correction without any physics reaches.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from concealed.baselines.common import main, report, simulate

POINTS = 300
LAGS = (0, 5, 20)
EVALUATIONS = 6


def start(folder, y):
    """A plausible initial state: the first measured values, zero elsewhere."""
    x = np.zeros(folder.system.nstates)
    names = list(folder.system.state_labels)
    for j, output in enumerate(folder.outputs):
        state = output.removesuffix("_m")
        if state in names:
            x[names.index(state)] = y[:3, j].mean()
    return x


def refit(folder, names, theta0, fixed):
    """Refit (log) parameters and initial states of the recordings `names` by output error."""
    params = dict(folder.system.params)
    scale = {n: folder.recordings[n][2].std(axis=0) + 1e-12 for n in names}
    starts = [start(folder, folder.recordings[n][2]) for n in names]
    size = np.concatenate([np.maximum(np.abs(x), 1e-2) for x in starts])

    def residual(z):
        theta = theta0 if fixed else z[: len(theta0)]
        x = np.split(z[0 if fixed else len(theta0):] * size, len(names))
        now = params | {k: params[k] * np.exp(v) for k, v in zip(folder.free, theta, strict=True)}
        parts = []
        for name, x0 in zip(names, x, strict=True):
            t, u, y = folder.recordings[name]
            parts.append(((simulate(folder.system, now, u, t[1] - t[0], x0) - y) / scale[name]).ravel())
        return np.clip(np.nan_to_num(np.concatenate(parts), nan=1e3), -1e3, 1e3)

    z0 = np.concatenate([[] if fixed else theta0, np.concatenate(starts) / size])
    z = least_squares(residual, z0, max_nfev=EVALUATIONS, x_scale="jac").x
    theta = theta0 if fixed else z[: len(theta0)]
    states = np.split(z[0 if fixed else len(theta0):] * size, len(names))
    now = params | {k: params[k] * np.exp(v) for k, v in zip(folder.free, theta, strict=True)}
    outputs = {}
    for name, x0 in zip(names, states, strict=True):
        t, u, _ = folder.recordings[name]
        outputs[name] = simulate(folder.system, now, u, t[1] - t[0], x0)
    return theta, outputs


def features(u, simulated):
    """Input and simulated output now and at the lags, shape (n, features)."""
    both = np.column_stack([u, simulated])
    return np.column_stack([np.vstack([np.repeat(both[:1], lag, axis=0),
                                       both[: len(both) - lag]]) for lag in LAGS])


def diagnose(folder, without):
    """Fit, correct, and report the held-out error before and after."""
    theta, train = refit(folder, folder.train, np.zeros(len(folder.free)), fixed=False)
    _, test = refit(folder, folder.test, theta, fixed=True)
    X = np.vstack([features(folder.recordings[n][1], train[n]) for n in folder.train])
    R = np.vstack([folder.recordings[n][2] - train[n] for n in folder.train])
    mean, spread = X.mean(axis=0), X.std(axis=0) + 1e-12
    pick = np.linspace(0, len(X) - 1, min(POINTS, len(X))).astype(int)
    fit = {}
    for j, output in enumerate(folder.outputs):
        unit = R[:, j].std() + 1e-300
        kernel = ConstantKernel(1.0) * RBF(2.0) + WhiteKernel(0.1)
        process = GaussianProcessRegressor(kernel, normalize_y=True, random_state=0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            process.fit((X[pick] - mean) / spread, R[pick, j] / unit)
        for name in folder.test:
            _, u, y = folder.recordings[name]
            error = y[:, j] - test[name][:, j]
            better = error - unit * process.predict((features(u, test[name]) - mean) / spread)
            fit.setdefault(name, {})[output] = {"refitted": {"rmse": _rms(error)},
                                                "repaired": {"rmse": _rms(better)}}
    return report("unexplained", fit=fit)


def _rms(x):
    return float(np.sqrt(np.mean(x**2)))


if __name__ == "__main__":
    main(diagnose, __doc__.splitlines()[0])
