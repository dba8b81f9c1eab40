"""What the baselines share: reading a case folder, simulating the nominal, writing a report of the same
schema."""

from __future__ import annotations

import argparse
import importlib.util
import json
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SUBSTEPS = 2


@dataclass(frozen=True)
class Folder:
    """A case folder: simulator, recordings {file: (t, u, y)}, names, units."""

    system: object
    recordings: dict
    train: tuple
    test: tuple
    inputs: dict
    outputs: dict
    free: tuple
    first: bool


def read(path):
    """Read a case folder as any user's script would."""
    spec = tomllib.loads((path / "case.toml").read_text(encoding="utf-8"))
    loader = importlib.util.spec_from_file_location("simulator", path / spec["simulator"])
    module = importlib.util.module_from_spec(loader)
    loader.loader.exec_module(module)
    nu = len(spec["inputs"])
    recordings = {}
    for name in [*spec["train"], *spec["test"]]:
        table = np.loadtxt(path / name, delimiter=",", skiprows=1, ndmin=2)
        recordings[name] = (table[:, 0], table[:, 1:1 + nu], table[:, 1 + nu:])
    return Folder(module.build(), recordings, tuple(spec["train"]), tuple(spec["test"]), spec["inputs"],
                  spec["outputs"], tuple(spec["free_parameters"]), spec.get("hold") == "first")


def simulate(system, params, u, ts, x0, first=False):
    """Outputs of a continuous python-control system, RK4; several runs at a time.

    Parameters
    ----------
    params : dict
        Values, or arrays of shape (runs,).
    x0 : array, shape (states, runs)
    first : bool
        The input runs straight between samples instead of being held.

    Returns
    -------
    array, shape (n, outputs, runs)
        nan from where a run is no longer finite.
    """
    x = np.array(x0, float)
    out = np.full((len(u), system.noutputs, x.shape[1]), np.nan)
    h = ts / SUBSTEPS
    rate, read_out = system.updfcn, system.outfcn
    with np.errstate(all="ignore"):
        for k, now in enumerate(u):
            out[k] = read_out(0.0, x, now, params)
            slope = (u[min(k + 1, len(u) - 1)] - now) / SUBSTEPS if first else 0.0 * now
            for j in range(SUBSTEPS):
                a, b, c = (now + (j + part) * slope for part in (0.0, 0.5, 1.0))
                k1 = rate(0.0, x, a, params)
                k2 = rate(0.0, x + 0.5 * h * k1, b, params)
                k3 = rate(0.0, x + 0.5 * h * k2, b, params)
                k4 = rate(0.0, x + h * k3, c, params)
                x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return out


def report(verdict, effects=(), fit=None, tried=0, seconds=0.0):
    """A report of schema `pwaid.mismatch/1` with the fields a baseline can fill."""
    return {"schema": "pwaid.mismatch/1", "verdict": verdict, "effects": list(effects), "candidates": [],
            "location": {}, "parameters": {}, "fit": fit or {}, "noise_floor": {}, "next_experiment": "",
            "warnings": [], "hypotheses_tried": tried, "seconds": round(seconds, 3)}


def main(diagnose, description):
    """Command line of a baseline: `CASE_DIR -o OUT [--without ID …]`; `diagnose(folder, without)` ->
    report."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("case", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--without", action="append", default=[])
    args = parser.parse_args()
    start = time.time()
    result = diagnose(read(args.case), set(args.without))
    result["seconds"] = round(time.time() - start, 3)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "report.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
