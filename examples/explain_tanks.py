"""What did the textbook model of the cascaded tanks leave out?

Square-root outflow, no overflow. Trained on the estimation record, judged in free run on the
validation record. Set PWAID_DATA to the folder that holds `cascaded_tanks/`.

    PWAID_DATA=... python examples/explain_tanks.py [--quick] [--save DIR]
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from _common import result
from _explained import outcome
from pwaid.errors import InputError
from pwaid.mismatch import explain_case
from pwaid.mismatch.case import write_case
from pwaid.recording import Recording

SIMULATOR = '''"""Two tanks in cascade with square-root outflow; levels in sensor volts."""

import control
import numpy as np


def update(t, x, u, params):
    upper = np.sqrt(np.maximum(x[0], 0.0))
    lower = np.sqrt(np.maximum(x[1], 0.0))
    return np.array([params["k4"] * u[0] - params["k1"] * upper, params["k2"] * upper - params["k3"] * lower])


def output(t, x, u, params):
    return np.array([x[1]])


def build():
    return control.nlsys(update, output, inputs=["pump"], outputs=["level"], states=["h1", "h2"],
                         params={"k1": 0.054, "k2": 0.062, "k3": 0.05, "k4": 0.04}, name="tanks")
'''


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the same run: it is short")
    parser.add_argument("--save", type=Path, help="folder for the case and the report")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    path = Path(os.environ.get("PWAID_DATA", ".")) / "cascaded_tanks" / "dataBenchmark.mat"
    if not path.is_file():
        raise InputError(f"{path} does not exist; set PWAID_DATA to the folder that holds cascaded_tanks/")
    raw = loadmat(path)
    t = np.arange(raw["uEst"].size) * float(raw["Ts"].squeeze())
    units = {"pump": "V", "level": "V"}
    records = {f"{name}.csv": Recording(t, raw[f"u{key}"].reshape(-1, 1), raw[f"y{key}"].reshape(-1, 1),
                                        ("pump",),
                                        ("level",), units, name=f"{name}.csv")
               for name, key in (("estimation", "Est"), ("validation", "Val"))}
    out = args.save or Path(tempfile.mkdtemp(prefix="pwaid_tanks_"))
    case = write_case(out / "case", SIMULATOR, {"estimation.csv": records["estimation.csv"]},
                      {"validation.csv": records["validation.csv"]}, ["k1", "k2", "k3", "k4"])
    report = explain_case(case, out / "explained", jobs=args.jobs)
    print(report.summary)
    result(**outcome(report, "validation.csv", "level", case))


if __name__ == "__main__":
    main()
