"""Write a case folder (what the tool sees) and the entry of the key (what it must not see)."""

from __future__ import annotations

import hashlib
import io

import numpy as np

from concealed import vector
from concealed.classes import equivalents

DIGITS = 9


def write_case(case, folder):
    """Write `case.toml`, `simulator.py` and the recordings into `folder`; return the SHA-256 of all of it."""
    folder.mkdir(parents=True)
    plant = case.plant
    params = {q.name: v for q, v in zip(plant.params, case.nominal, strict=True)}
    text = plant.source(plant, params, case.measured, case.variant)
    (folder / "simulator.py").write_text(text, encoding="utf-8")
    (folder / "case.toml").write_text(_toml(case), encoding="utf-8")
    names = ["t", *[n for n, _ in plant.inputs], *[plant.states[i][0] + "_m" for i in case.measured]]
    for rec in case.recordings:
        t = np.arange(len(rec.u)) * plant.ts
        table = np.column_stack([t, rec.u, rec.y])
        np.savetxt(folder / f"{rec.name}.csv", table, delimiter=",", header=",".join(names), comments="",
                   fmt=f"%.{DIGITS}g")
    return digest(folder)


def digest(folder):
    """SHA-256 over names and contents of the files of a folder."""
    total = hashlib.sha256()
    for path in sorted(folder.iterdir()):
        if path.is_file():
            total.update(path.name.encode() + b"\0" + path.read_bytes())
    return total.hexdigest()


def _toml(case):
    plant = case.plant
    def listed(role):
        return "[" + ", ".join(f'"{r.name}.csv"' for r in case.recordings if r.role == role) + "]"
    free = "[" + ", ".join(f'"{plant.params[i].name}"' for i in case.free) + "]"
    lines = ['simulator = "simulator.py"', 'time = "t"', f"train = {listed('train')}",
             f"test = {listed('test')}",
             f"free_parameters = {free}"]
    if case.recipe.hold == "first":
        lines.append('hold = "first"')
    outputs = [(plant.states[i][0] + "_m", plant.states[i][1]) for i in case.measured]
    if case.recipe.repeats:
        lines.append('repeats = [["train_0.csv", "train_again.csv"]]')
    if case.recipe.floor:
        floors = ", ".join(f"{n} = {s:.2g}" for (n, _), s in zip(outputs, case.sigma, strict=True))
        lines.append(f"noise_floor = {{ {floors} }}")
    lines += ["", "[inputs]", *[f'{n} = "{u}"' for n, u in plant.inputs], "", "[outputs]",
              *[f'{n} = "{u}"' for n, u in outputs], ""]
    return "\n".join(lines)


def truth_bytes(case):
    """The noise-free outputs of all recordings as an `.npz`, for the scorer."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **{r.name + ".csv": r.free.astype(np.float32) for r in case.recordings})
    return buffer.getvalue()


def key_entry(case, name, cell, seed):
    """What the scorer must know about the case."""
    plant, recipe = case.plant, case.recipe
    outputs = [plant.states[i][0] + "_m" for i in case.measured]
    same = equivalents(case)
    return {
        "class": name, "cell": cell, "condition": _condition(recipe), "seed": seed, "plant": plant.name,
        "excitation": recipe.excitation, "measured": outputs, "noise": recipe.noise, "hold": recipe.hold,
        "disturbance": recipe.disturbance, "repeats": recipe.repeats, "noise_floor_given": recipe.floor,
        "stranger": recipe.stranger, "variant": case.variant,
        "effects": [{"id": d.id, "family": d.family, "where": d.where, "equivalents": same[d.id],
                     "parameters": {k: _number(case, d, v, u) for k, (v, u) in d.parameters.items()}}
                    for d in case.drawn],
        "parameters_true": {q.name: float(v) for q, v in zip(plant.params, case.p, strict=True)},
        "parameters_nominal": {q.name: float(v) for q, v in zip(plant.params, case.nominal, strict=True)},
        "free_parameters": [plant.params[i].name for i in case.free],
        "clutter": case.facts["clutter"], "clutter_ratio": case.facts["clutter_ratio"],
        "detectability": case.margins, "detectability_heldout": case.heldout_margins,
        "detectability_over_coulomb": case.nested,
        "nominal_ratio": case.facts["nominal_ratio"], "disturbance_ratio": case.facts["disturbance_ratio"],
        "attempts": case.facts["attempts"], "sigma": dict(zip(outputs, map(float, case.sigma), strict=True)),
        "effect_vector": {n: float(v) for n, v in zip(vector.NAMES, case.e, strict=True) if v != 0.0},
        "floor_rmse": {r.name + ".csv": _rms_by_output(r.y - r.free, outputs) for r in case.recordings},
    }


def _number(case, drawn, value, unit):
    """A true value with its unit; what acts at the input also in the unit of the input."""
    out = {"value": float(value), "unit": unit}
    force, command = case.plant.force_unit, case.plant.inputs[0][1]
    names = [q.name for q in case.plant.params]
    if "gain" not in names or force == command:
        return out
    gain = case.p[names.index("gain")]
    if drawn.id in ("constant_load", "periodic_disturbance") and unit == force:
        out["also"] = [{"value": float(value / gain), "unit": command}]
    if drawn.id == "load_dependent_friction":
        out["also"] = [{"value": float(value * gain), "unit": f"{force}/{command}"}]
    return out


def _rms_by_output(error, outputs):
    return {n: float(np.sqrt(np.mean(e**2))) for n, e in zip(outputs, error.T, strict=True)}


def _condition(recipe):
    if recipe.disturbance > 0.0:
        return "disturbance"
    return recipe.excitation
