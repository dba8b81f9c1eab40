"""Baseline: sparse regression of the smoothed derivative on a friction-aware library (SINDy discrepancy
modelling).

For each output y the equation  ẏ = Ξ θ(y, …, u)  (levels, temperatures, currents, speeds) or
ÿ = Ξ θ(y, ẏ, u)  (positions) is regressed: the nominal terms are free, the candidates are thresholded
sequentially
(STLSQ). Derivatives come from a Savitzky–Golay filter. The candidate with the largest share of the variance
names
the effect; when none reaches `MATERIAL`, the verdict is "only parameters".
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from concealed.baselines.common import main, report

MATERIAL = 0.10  # share of the rms of the derivative that a candidate term must carry
WINDOW = 21
ORDER = 3
ROUNDS = 10


def library(q, v, u, order):
    """Nominal and candidate columns; returns (nominal (n, k), {effect id: column})."""
    ones = np.ones(len(u))
    nominal = [v, *u.T] if order == 2 else [q, *u.T]
    drive = u[:, 0]
    spread = drive.std()
    dead = np.sign(drive) * np.maximum(np.abs(drive) - 0.25 * spread, 0.0)
    clipped = np.clip(drive - drive.mean(), -spread, spread)
    terms = {"coulomb_friction": np.sign(v), "quadratic_drag": v * np.abs(v), "constant_load": ones,
             "actuator_deadzone": dead, "actuator_saturation": clipped,
             "actuator_gain_asymmetry": np.abs(drive)}
    if order == 2:
        nominal.append(q)
        terms |= {"cubic_stiffness": q**3, "quadratic_stiffness": q**2, "gravity_torque": np.sin(q),
                  "asymmetric_viscous_friction": np.abs(v)}
    elif q.min() > 0.0:
        terms = {k: c for k, c in terms.items() if k in ("actuator_saturation",)}
        terms |= {"square_root_outflow": np.sqrt(q), "radiation": (q + 273.15) ** 4 / 1e9}
        nominal.append(ones)
    return np.column_stack(nominal), terms


def regress(target, nominal, terms):
    """STLSQ; returns {effect id: share of the target's rms} of the surviving candidates."""
    alive = list(terms)
    for _ in range(ROUNDS):
        full = np.column_stack([nominal, *[terms[k] for k in alive]])
        scale = np.linalg.norm(full, axis=0) + 1e-300
        theta = np.linalg.lstsq(full / scale, target, rcond=1e-8)[0] / scale
        shares = {}
        for i, k in enumerate(alive):
            fitted = np.linalg.lstsq(nominal, terms[k], rcond=None)[0]
            own = theta[nominal.shape[1] + i] * (terms[k] - nominal @ fitted)
            shares[k] = float(own.std() / target.std())
        kept = [k for k in alive if shares[k] >= MATERIAL]
        if kept == alive or not kept:
            return {k: shares[k] for k in kept}
        alive = kept
    return {k: shares[k] for k in alive}


def diagnose(folder, without):
    """Regress the first output's equation over all training recordings."""
    unit = next(iter(folder.outputs.values()))
    order = 2 if unit in ("m", "rad") and not _is_level(folder) else 1
    targets, blocks = [], []
    for name in folder.train:
        t, u, y = folder.recordings[name]
        ts = t[1] - t[0]
        q = savgol_filter(y[:, 0], WINDOW, ORDER)
        v = savgol_filter(y[:, 0], WINDOW, ORDER, deriv=1, delta=ts)
        a = savgol_filter(y[:, 0], WINDOW, ORDER, deriv=2, delta=ts)
        inner = slice(WINDOW, -WINDOW)
        targets.append((a if order == 2 else v)[inner])
        blocks.append((q[inner], (v if order == 2 else q)[inner], u[inner]))
    q, v, u = (np.concatenate(part) for part in zip(*blocks, strict=True))
    nominal, terms = library(q, v, u, order)
    terms = {k: c for k, c in terms.items() if k not in without}
    shares = regress(np.concatenate(targets), nominal, terms) if terms else {}
    best = sorted(shares, key=shares.get, reverse=True)[:3]
    if not best:
        return report("parameters_only", tried=len(terms))
    return report("named", [{"id": best[0], "parameters": {}, "share_explained": shares[best[0]]}],
                  tried=len(terms))


def _is_level(folder):
    return any(unit == "V" and name == "pump" for name, unit in folder.inputs.items())


if __name__ == "__main__":
    main(diagnose, __doc__.splitlines()[0])
