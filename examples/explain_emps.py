"""What did the linear model of the EMPS axis leave out?

The nominal simulator is a mass with viscous friction and a force offset. It is trained on DATA_EMPS.mat
(25 s of closed-loop trapezoids; the force is the recorded command) and judged on DATA_EMPS_PULSES.mat.
Set PWAID_DATA to the folder that holds `emps/`.

    PWAID_DATA=... python examples/explain_emps.py [--quick] [--save DIR]
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.signal import butter, filtfilt

from _common import result
from _explained import friction, named_laws, outcome
from pwaid.errors import InputError
from pwaid.mismatch import explain_case
from pwaid.mismatch.case import write_case
from pwaid.recording import Recording

SIMULATOR = '''"""EMPS axis, linear: a mass with viscous friction and a drive offset."""

import control
import numpy as np


def update(t, x, u, params):
    m, b, offset = params["m"], params["b"], params["offset"]
    return np.array([x[1], (u[0] - b * x[1] - offset) / m])


def output(t, x, u, params):
    return np.array([x[0], x[1]])


def build():
    return control.nlsys(update, output, inputs=["force"], outputs=["q", "v"], states=["q", "v"],
                         params={"m": 100.0, "b": 300.0, "offset": -3.0}, name="emps")
'''


def recording(path: Path, factor: int, name: str) -> Recording:
    """Force, position and speed; the speed by a zero-phase filter, decimated by `factor`."""
    if not path.is_file():
        raise InputError(f"{path} does not exist; set PWAID_DATA to the folder that holds emps/")
    raw = loadmat(path)
    t, q, force = raw["t"].ravel(), raw["qm"].ravel(), float(raw["gtau"].squeeze()) * raw["vir"].ravel()
    b, a = butter(4, 60.0, fs=1000.0)
    v = np.gradient(filtfilt(b, a, q), t)
    n = len(t) // factor * factor
    held = force[:n].reshape(-1, factor).mean(axis=1)  # the mean force over each longer sample
    units = {"force": "N", "q": "m", "v": "m/s"}
    return Recording(np.arange(len(held)) * factor * 1e-3, held[:, None], np.column_stack([q, v])[:n:factor],
                     ("force",), ("q", "v"), units, name=name)


def inverse_signals(path: Path):
    """Speed and acceleration of the filtered position, and the force, of a record, every ms."""
    raw = loadmat(path)
    t, q, force = raw["t"].ravel(), raw["qm"].ravel(), float(raw["gtau"].squeeze()) * raw["vir"].ravel()
    b, a = butter(4, 60.0, fs=1000.0)
    v = np.gradient(filtfilt(b, a, q), t)
    return v, np.gradient(v, t), force


def force_error(path: Path, m: float, b: float, offset: float, friction=None) -> float:
    """Relative error of the inverse model's force on a record, filtered as its authors do (percent)."""
    v, acc, force = inverse_signals(path)
    model = m * acc + b * v + offset + (friction(v) if friction else 0.0)
    d, c = butter(4, 20.0, fs=1000.0)
    wanted, got = filtfilt(d, c, force), filtfilt(d, c, model)
    inner = slice(500, -500)
    return 100 * float(np.linalg.norm((wanted - got)[inner]) / np.linalg.norm(wanted[inner]))


def fitted_to_force(path: Path) -> dict[str, float]:
    """m, b, offset by least squares on the filtered force itself: the linear inverse model's best case."""
    v, acc, force = inverse_signals(path)
    d, c = butter(4, 20.0, fs=1000.0)
    columns = np.column_stack([filtfilt(d, c, z) for z in (acc, v)] + [np.ones(v.size)])[500:-500]
    values = np.linalg.lstsq(columns, filtfilt(d, c, force)[500:-500], rcond=None)[0]
    return dict(zip(("m", "b", "offset"), map(float, values), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="decimate further: under a minute")
    parser.add_argument("--save", type=Path, help="folder for the case and the report")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    data = Path(os.environ.get("PWAID_DATA", ".")) / "emps"
    factor = 10 if args.quick else 5
    out = args.save or Path(tempfile.mkdtemp(prefix="pwaid_emps_"))
    train = recording(data / "DATA_EMPS.mat", factor, "train.csv")
    half = len(train.time) // 2
    parts = {"train_0.csv": train[:half], "train_1.csv": train[half:]}
    parts = {k: r.replace(time=r.time - r.time[0]) for k, r in parts.items()}
    test = {"test.csv": recording(data / "DATA_EMPS_PULSES.mat", factor, "test.csv")}
    case = write_case(out / "case", SIMULATOR, parts, test, ["m", "b", "offset"],
                      extra="closed_loop = true\ntolerances = { offset = 1.0 }")
    report = explain_case(case, out / "explained", jobs=args.jobs)
    print(report.summary)
    pulses, speed = data / "DATA_EMPS_PULSES.mat", report.fit["test.csv"]["v"]

    def error(stage: str, friction=None) -> float:
        return force_error(pulses, *(report.content["parameters"][k][stage] for k in ("m", "b", "offset")), friction)

    result(**outcome(report, "test.csv", "v", case) | {  # errors in percent of the force on the test record
        "error_nominal": error("nominal"), "error_refitted": error("without_effect"),
        "error_repaired": error("refitted", friction(report, "state:v", dry=False)),
        "error_fitted_to_force": force_error(pulses, **fitted_to_force(data / "DATA_EMPS.mat")),
        "laws": named_laws(report),
        "speed_rmse_m_s": {stage: speed[stage]["rmse"] for stage in ("nominal", "refitted", "repaired")}})


if __name__ == "__main__":
    main()
