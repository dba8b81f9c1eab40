"""Baseline: nominal simulator with refitted parameters plus a Gaussian process of its residual. Error only,
no name.

The process sees the simulated output and the input, now and at two lags; its training points are thinned to
`POINTS`. Its held-out error is what a flexible correction without any physics reaches.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
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
EVALUATIONS = 12
STEP = 1e-4  # of the forward differences, in units of the scaled variables


def start(folder, y):
    """A plausible initial state: the first measured values, zero elsewhere."""
    x = np.zeros(folder.system.nstates)
    names = list(folder.system.state_labels)
    for j, output in enumerate(folder.outputs):
        state = output.removesuffix("_m")
        if state in names:
            x[names.index(state)] = y[:3, j].mean()
    return x


@dataclass(frozen=True)
class OutputError:
    """Output error of recordings as a function of z: logarithms of the free parameters (unless they are fixed), then
    one initial state per recording in units of `size`."""

    folder: object
    names: tuple
    theta: np.ndarray
    fixed: bool

    def split(self, z):
        """Logarithms of the parameters (free,) and initial states in units of `size` (recordings, states)."""
        n = 0 if self.fixed else len(self.theta)
        return (self.theta if self.fixed else z[:n]), z[n:].reshape(len(self.names), -1)

    def run(self, name, theta, x0):
        """Simulated outputs, shape (n, outputs, runs), of one recording; `theta` (free, runs), `x0` (states, runs)."""
        system = self.folder.system
        params = system.params | {k: system.params[k] * np.exp(v)
                                  for k, v in zip(self.folder.free, theta, strict=True)}
        t, u, _ = self.folder.recordings[name]
        return simulate(system, params, u, t[1] - t[0], x0, self.folder.first)

    def error(self, name, theta, x0):
        """Errors in units of the outputs' spread, shape (n · outputs, runs)."""
        y = self.folder.recordings[name][2]
        e = (self.run(name, theta, x0) - y[:, :, None]) / (y.std(axis=0)[:, None] + 1e-12)
        return np.clip(np.nan_to_num(e, nan=1e3), -1e3, 1e3).reshape(y.size, -1)

    def residual(self, z, size):
        """All errors in one vector."""
        theta, x = self.split(z)
        return np.concatenate([self.error(n, theta[:, None], (x0 * size)[:, None])[:, 0]
                               for n, x0 in zip(self.names, x, strict=True)])

    def jacobian(self, z, size):
        """Forward differences, all columns of a recording in one simulation."""
        theta, x = self.split(z)
        moving, states = (0 if self.fixed else len(theta)), len(size)
        blocks = []
        for i, (name, x0) in enumerate(zip(self.names, x, strict=True)):
            moves = STEP * np.eye(moving + states)
            thetas = np.repeat(theta[:, None], 1 + moving + states, axis=1)
            thetas[:moving, 1:] += moves[:moving]
            starts = np.repeat(x0[:, None], 1 + moving + states, axis=1)
            starts[:, 1:] += moves[moving:]
            e = self.error(name, thetas, starts * size[:, None])
            slopes = (e[:, 1:] - e[:, :1]) / STEP
            block = np.zeros((len(e), len(z)))
            block[:, :moving] = slopes[:, :moving]
            block[:, moving + i * states:moving + (i + 1) * states] = slopes[:, moving:]
            blocks.append(block)
        return np.vstack(blocks)


def refit(folder, names, theta0, fixed):
    """Refit parameters and initial states of the recordings `names`; returns their logarithms and the outputs."""
    problem = OutputError(folder, tuple(names), theta0, fixed)
    starts = np.array([start(folder, folder.recordings[n][2]) for n in names])
    size = np.maximum(np.abs(starts).max(axis=0), 1e-2)
    z0 = np.concatenate([[] if fixed else theta0, (starts / size).ravel()])
    z = least_squares(problem.residual, z0, jac=problem.jacobian, args=(size,), max_nfev=EVALUATIONS, x_scale="jac").x
    theta, x = problem.split(z)
    outputs = {n: problem.run(n, theta[:, None], (x0 * size)[:, None])[:, :, 0]
               for n, x0 in zip(names, x, strict=True)}
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
