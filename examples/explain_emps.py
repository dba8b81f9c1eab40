"""What did the linear model of the EMPS axis leave out?

The nominal simulator is a mass with viscous friction and a force offset. It is trained on DATA_EMPS.mat
(25 s of closed-loop trapezoids; the force is the recorded command) and judged on DATA_EMPS_PULSES.mat.
Set PWAID_DATA to the folder that holds `emps/`.

    PWAID_DATA=... python examples/explain_emps.py [--quick] [--save DIR]
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.signal import butter, filtfilt

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


def force_error(report, path: Path, stage: str, friction=None) -> float:
    """Relative error of the inverse model's force on a record, filtered as its authors do (percent).

    `stage` picks the parameters: "nominal", "without_effect" (the refitted null) or "refitted" (with the effect).
    """
    raw = loadmat(path)
    t, q, force = raw["t"].ravel(), raw["qm"].ravel(), float(raw["gtau"].squeeze()) * raw["vir"].ravel()
    b, a = butter(4, 60.0, fs=1000.0)
    q = filtfilt(b, a, q)
    v = np.gradient(q, t)
    acc = np.gradient(v, t)
    p = {k: value[stage] for k, value in report.content["parameters"].items()}
    model = p["m"] * acc + p["b"] * v + p["offset"] + (friction(v) if friction else 0.0)
    d, c = butter(4, 20.0, fs=1000.0)
    wanted, got = filtfilt(d, c, force), filtfilt(d, c, model)
    inner = slice(500, -500)
    return 100 * float(np.linalg.norm((wanted - got)[inner]) / np.linalg.norm(wanted[inner]))


def named_force(report):
    """The friction the report named, as a function of speed; None when nothing was named."""
    if report.verdict not in ("named", "one_of"):
        return None
    h = report.best
    laws = {e.effect.id: dict(zip([q.name for q in e.effect.quantities], v, strict=True))
            for e, v in zip(h.located, h.values(), strict=True)}

    def force(v):
        total = np.zeros_like(v)
        for name, q in laws.items():
            if name == "coulomb_friction":
                total += q["level"] * np.sign(v)
            elif name == "asymmetric_coulomb_friction":
                total += np.where(v > 0, q["level_positive"], -q["level_negative"])
            elif name == "stribeck_friction":
                total += (q["level"] + q["excess"] * np.exp(-(v / q["stribeck_speed"]) ** 2)) * np.sign(v)
            elif name == "presliding_friction":
                total += q["level"] * np.sign(v)
            elif name == "asymmetric_viscous_friction":
                total += np.where(v > 0, q["coefficient_positive"], q["coefficient_negative"]) * v
            elif name == "quadratic_drag":
                total += q["coefficient"] * v * np.abs(v)
            elif name == "constant_load":
                total -= q["level"]
        return total

    return force


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
    path = data / "DATA_EMPS_PULSES.mat"
    speed = report.fit["test.csv"]["v"]
    result = {
        "verdict": report.verdict, "effects": [e["id"] for e in report.effects],
        "error_nominal": force_error(report, path, "nominal"),  # percent of the force, test record
        "error_refitted": force_error(report, path, "without_effect"),
        "error_repaired": force_error(report, path, "refitted", named_force(report)),
        "speed_rmse_m_s": {stage: speed[stage]["rmse"] for stage in ("nominal", "refitted", "repaired")},
        "seconds": report.content["seconds"], "case": str(case),
    }
    print("RESULT " + json.dumps(result))


if __name__ == "__main__":
    main()
