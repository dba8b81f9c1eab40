"""Baseline: sparse regression of the smoothed derivative on a friction-aware library (SINDy discrepancy modelling).

For the first output y the equation ẏ = Ξ θ(y, u) (levels, temperatures, currents, speeds) or ÿ = Ξ θ(y, ẏ, u)
(positions) is regressed: the nominal terms are free, the candidates are thresholded one after another. Derivatives
come from a Savitzky–Golay filter. The candidate that alone carries the largest share of the derivative names the
effect; when none reaches `MATERIAL`, the verdict is "only parameters".
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
    """Drop the weakest candidate until each carries `MATERIAL`; returns {effect id: share of the target's rms}.

    A candidate's share is what it alone adds: its coefficient times the part of its column that neither the nominal
    terms nor the other candidates can imitate. (Whole columns would count the same force several times over where
    candidates are alike, such as q, q³ and sin q.)
    """
    alive = list(terms)
    while alive:
        shares = {k: _alone(target, nominal, [terms[o] for o in alive if o != k], terms[k]) for k in alive}
        weakest = min(alive, key=shares.get)
        if shares[weakest] >= MATERIAL:
            return shares
        alive.remove(weakest)
    return {}


def _alone(target, nominal, others, column):
    """Share of the target's rms that `column` explains after everything else has been projected out."""
    rest = np.column_stack([nominal, *others])
    rest = rest / (np.linalg.norm(rest, axis=0) + 1e-300)
    both = np.column_stack([target, column / (np.linalg.norm(column) + 1e-300)])
    left, own = (both - rest @ np.linalg.lstsq(rest, both, rcond=1e-8)[0]).T
    size = np.linalg.norm(own)
    return float(abs(own @ left) / size / np.linalg.norm(target)) if size > 1e-6 else 0.0


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
