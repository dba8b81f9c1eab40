"""A negative control: a laboratory hair dryer that a linear model of adequate order describes.

The nominal simulator is a third-order linear model with dead time in its extra states, identified on the
first half of the record; the tool should find little or nothing to name. Set PWAID_DATA to the folder
that holds `hair_dryer/`.

    PWAID_DATA=... python examples/explain_hair_dryer.py [--quick] [--save DIR]
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.optimize import least_squares
from scipy.signal import lfilter

from _common import result
from _explained import outcome
from pwaid.errors import InputError
from pwaid.mismatch import explain_case
from pwaid.mismatch.case import write_case
from pwaid.recording import Recording

ORDER, DELAY, SAMPLE_TIME = 3, 2, 0.08


def identify(u, y):
    """Output-error fit from an ARX start: (a, b) of A(q) y = q^-DELAY B(q) u."""
    n, start = ORDER, ORDER + DELAY

    def rows(source):
        lags = [-source[start - i:len(source) - i] for i in range(1, n + 1)]
        return np.column_stack(lags + [u[start - DELAY - i:len(u) - DELAY - i] for i in range(n)])

    first = np.linalg.lstsq(rows(y), y[start:], rcond=None)[0]

    def error(theta):
        simulated = lfilter(np.concatenate([np.zeros(DELAY), theta[n:]]), np.concatenate([[1.0], theta[:n]]),
                            u)
        return np.clip((y - simulated)[20:], -1e3, 1e3)

    theta = least_squares(error, first).x
    return theta[:n], theta[n:]


def simulator_text(a, b) -> str:
    """A discrete state space of the transfer function, as a case's simulator.py."""
    size = ORDER + DELAY + 1
    A, B = np.zeros((size, size)), np.zeros((size, 1))
    num = np.concatenate([np.zeros(DELAY), b, np.zeros(size - DELAY - len(b))])
    den = np.concatenate([a, np.zeros(size - len(a))])
    A[:, 0] = -den
    A[:-1, 1:] = np.eye(size - 1)
    B[:, 0] = num[1:size + 1] if len(num) > size else np.concatenate([num[1:], [0.0]])[:size]
    gain = "params['gain']"
    return f'''"""Linear model of the hair dryer, order {ORDER} with {DELAY} samples of dead time."""

import control
import numpy as np

A = np.array({A.round(9).tolist()})
B = np.array({B[:, 0].round(9).tolist()})


def update(t, x, u, params):
    return A @ x + B * ({gain} * u[0])


def output(t, x, u, params):
    return np.array([x[0]])


def build():
    return control.nlsys(update, output, inputs=["heater"], outputs=["temperature"], states={size},
                         params={{"gain": 1.0}}, dt={SAMPLE_TIME}, name="hair_dryer")
'''


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the same run: it is short")
    parser.add_argument("--save", type=Path, help="folder for the case and the report")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    path = Path(os.environ.get("PWAID_DATA", ".")) / "hair_dryer" / "hair_dryer.mat"
    if not path.is_file():
        raise InputError(f"{path} does not exist; set PWAID_DATA to the folder that holds hair_dryer/")
    raw = loadmat(path)
    table = next(np.asarray(v, dtype=float) for k,
                 v in raw.items() if not k.startswith("__") and np.asarray(v).size > 1000)
    u, y = table[:, -2], table[:, -1]
    u, y = u - u[:600].mean(), y - y[:600].mean()
    a, b = identify(u[:600], y[:600])
    t = np.arange(len(u)) * SAMPLE_TIME
    units = {"heater": "V", "temperature": "V"}

    def rec(first, last, name):
        return Recording(t[:last - first], u[first:last, None], y[first:last, None], ("heater",),
                         ("temperature",),
                         units, name=name)

    out = args.save or Path(tempfile.mkdtemp(prefix="pwaid_hair_dryer_"))
    case = write_case(out / "case", simulator_text(a, b),
                      {"train_0.csv": rec(0, 300, "train_0.csv"),
                       "train_1.csv": rec(300, 600, "train_1.csv")},
                      {"test.csv": rec(600, 1000, "test.csv")}, ["gain"])
    report = explain_case(case, out / "explained", jobs=args.jobs)
    print(report.summary)
    result(**outcome(report, "test.csv", "temperature", case))


if __name__ == "__main__":
    main()
