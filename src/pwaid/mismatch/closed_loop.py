"""The whole loop, reference to plant input and output, with the user's controller around a simulator.

The fit runs on the recorded plant input, where the controller does not matter. With the controller known, the
loop is closed around the nominal, the refitted and the repaired simulator, and both what comes out and what the
controller then commands are compared with the recordings: a stiff loop hides a mismatch from its outputs and
shows it in its commands.

    with references       u = C(r, y)                      y simulated
    without               u = u_rec + C(y) - C(y_rec)      exact for a linear controller
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pwaid.errors import InputError
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.fit import Fit, fit_starts
from pwaid.mismatch.measures import fit_measures
from pwaid.mismatch.model import LIMIT, Model, Settings
from pwaid.mismatch.plant import Plant, as_plant
from pwaid.recording import Recording

__all__ = ["Loop", "Walk", "closed_loop_report", "controller_starts", "make_loop", "simulate_loop"]

FAITHFUL = 90.0  # percent of the recorded input's variation that a controller must reproduce to be called the one


@dataclass(frozen=True)
class Loop:
    """A controller as a model, with its reference signals (N, n_references) per recording; none when empty."""

    controller: Model
    references: Mapping[str, np.ndarray]

    @property
    def n_references(self) -> int:
        return next(iter(self.references.values())).shape[1] if self.references else 0


def _checked(references: Mapping[str, np.ndarray], recordings: Sequence[Recording]) -> dict[str, np.ndarray]:
    """References as arrays (N, n_references), one for each of the recordings."""
    found = {name: np.asarray(array, dtype=float) for name, array in references.items()}
    found = {name: array[:, None] if array.ndim == 1 else array for name, array in found.items()}
    width = {array.shape[1:] for array in found.values()}
    if len(width) > 1 or any(array.ndim != 2 for array in found.values()):
        raise InputError(f"references have shapes {[a.shape for a in found.values()]}; expected (N, n_references) each")
    for r in recordings if found else ():
        if r.name not in found:
            raise InputError(f"recording {r.name} has no references; expected them for every recording")
        if len(found[r.name]) != len(r.time):
            raise InputError(f"the references of {r.name} have {len(found[r.name])} samples, the recording "
                             f"{len(r.time)}; expected one row a sample")
    return found


def make_loop(system, plant: Plant, references: Mapping[str, np.ndarray], sample_time: float,
              recordings: Sequence[Recording]) -> Loop:
    """Check a controller against the plant it closes.

    Parameters
    ----------
    system : control system from (references, measured outputs) to the plant inputs; discrete at the sampling of the
        recordings, or continuous, its inputs then held between samples.
    references : arrays (N, n_references), or (N,), by recording name. recordings : those that need them.

    Raises
    ------
    InputError
        For another number of inputs or outputs, another step, or a plant that is a black box.
    """
    if plant.black_box is not None:
        raise InputError("a controller came with a black box simulate(u), which cannot be closed sample by sample; "
                         "give the right-hand side, or leave the controller out (closed_loop = true)")
    references = _checked(references, recordings)
    _, nu, ny = plant.sizes
    width = next(iter(references.values())).shape[1] if references else 0
    inputs = [f"r{i}" for i in range(width)] + list(plant.output_names)
    controller = as_plant(system, inputs, plant.input_names)
    if controller.black_box is not None:
        raise InputError("the controller is a plain callable; expected a control system (control.ss, tf or nlsys)")
    nx, got, gave = controller.sizes
    if got != width + ny:
        raise InputError(f"the controller has {got} inputs; expected {width + ny}: {width} references ([references] in "
                         f"case.toml), then the outputs {', '.join(plant.output_names)}")
    if gave != nu:
        raise InputError(f"the controller has {gave} outputs; expected the plant's {nu} inputs "
                         f"{', '.join(plant.input_names)}")
    if controller.dt and abs(controller.dt / sample_time - 1) > 1e-3:
        raise InputError(f"the controller steps {controller.dt:g} s, the recordings are sampled every {sample_time:g} "
                         "s; resample the controller")
    still = np.full(nx, -1, dtype=np.int64)
    return Loop(Model(Settings(controller, still, np.zeros(nx), (), np.zeros(0), substeps=4)), dict(references))


class Walk:
    """A model simulated sample by sample over one recording, its inputs decided on the way."""

    def __init__(self, model: Model, theta, x0, samples: int, sample_time: float, first_input):
        plant = model.settings.plant
        _, nu, ny = plant.sizes
        self.model, self.p, self.Ts = model, model.parameters(theta), sample_time
        self.Q, self.delay = model.laws(model.parts(theta), nu)
        self.U, self.Y = np.zeros((samples + 1, nu)), np.zeros((samples + 1, ny))
        self.U[:] = first_input
        self.X = np.zeros((samples + 1, model.nx + model.extra))
        self.x = model.start(np.asarray(x0, dtype=float)[None], self.U, np.array([[0, samples, 0, samples]]))

    def at(self, k: int, u) -> tuple[np.ndarray, np.ndarray]:
        """Outputs at sample k under the input u, and those at k + 1 while it is still held; then moves on."""
        self.U[k:k + 2] = u
        segment = np.array([[k, k + 2, 0, len(self.U)]], dtype=np.int64)
        self.model.run(self.p, self.Q, self.delay, self.x, segment, self.U, self.Ts, self.X, self.Y)
        self.x = self.X[k + 1:k + 2].copy()
        return self.Y[k].copy(), self.Y[k + 1].copy()


def simulate_loop(loop: Loop, fit: Fit, data: Dataset, starts) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (N, ny) and plant inputs (N, nu) of the closed loop over every recording; NaN from where it ran away.

    Outputs that answer the input within the same sample are fed back one sample late.
    """
    Y, U = np.full_like(data.Y, np.nan), np.full_like(data.U, np.nan)
    for r, (a, b) in enumerate(data.recordings):
        first = int(np.flatnonzero(data.segments[:, 0] == a)[0])
        R = _references(loop, data, r)
        plant = Walk(fit.model, fit.theta, fit.X0[first], b - a, data.sample_time, data.U[a])
        controller = Walk(loop.controller, np.zeros(0), starts[r], b - a, data.sample_time, 0.0)
        answer = None if loop.references else _driven(loop, data, r, starts[r])
        y = data.Y[a] if fit.model.nx == 0 else Walk(fit.model, fit.theta, fit.X0[first], 1, data.sample_time,
                                                     data.U[a]).at(0, data.U[a])[0]
        for k in range(b - a):
            u, _ = controller.at(k, np.concatenate([R[k], y]))
            if answer is not None:
                u = data.U[a + k] + u - answer[k]
            Y[a + k], U[a + k] = y, u
            _, y = plant.at(k, u)
            if not (np.all(np.abs(y) < LIMIT) and np.all(np.abs(u) < LIMIT)):
                break
    return Y, U


def _driven(loop: Loop, data: Dataset, r: int, start) -> np.ndarray:
    """The controller's answer to the recorded outputs (N, nu)."""
    a, b = data.recordings[r]
    alone = Dataset(data.names[r:r + 1], data.Y[a:b], data.U[a:b], np.array([[0, b - a, 0, b - a]]), data.sample_time)
    return loop.controller.simulate(np.zeros(0), start[None], alone)[0]


def _references(loop: Loop, data: Dataset, r: int) -> np.ndarray:
    a, b = data.recordings[r]
    return loop.references[data.names[r]][:b - a] if loop.references else np.zeros((b - a, 0))


def controller_starts(loop: Loop, data: Dataset, input_names) -> tuple[np.ndarray, dict[str, float] | None]:
    """Start state of the controller per recording, and how well it reproduces the recorded inputs (BFT, percent).

    Driven by the recorded references and outputs, its start fitted. Without references it starts at zero, and
    nothing can be compared.
    """
    nx = loop.controller.nx
    rec = data.recordings
    if not loop.references:
        return np.zeros((len(rec), nx)), None
    R = np.vstack([_references(loop, data, r) for r in range(len(rec))])
    rows = np.array([(a, b, a, b) for a, b in rec], dtype=np.int64)
    driven = Dataset(data.names, np.ascontiguousarray(np.hstack([R, data.Y])), data.U, rows, data.sample_time)
    fit = fit_starts(loop.controller, driven, np.std(data.U, axis=0) + 1e-12, np.zeros(0), np.zeros((len(rec), nx)),
                     np.ones(nx))
    return fit.X0, {n: fit_measures(data.U[:, j], fit.Y[:, j])["bft"] for j, n in enumerate(input_names)}


def closed_loop_report(loop: Loop, plant: Plant, data: Dataset, stages: Mapping[str, Fit]) -> tuple[dict, list[str]]:
    """The `closed_loop` entry of report.json and notes, for fits by stage on the held-out recordings.

    `fit`: measures of every output and input by recording and stage; `error_share`: root mean square error of the
    refitted loop over the standard deviation, by signal; `shows_in_inputs`: share of these errors, squared, that
    falls on the inputs; `controller_bft`: how well the controller reproduces the recorded inputs.
    """
    starts, faithful = controller_starts(loop, data, plant.input_names)
    runs = {stage: simulate_loop(loop, fit, data, starts) for stage, fit in stages.items()}
    table: dict = {}
    for name, (a, b) in zip(data.names, data.recordings, strict=True):
        rows = table[name] = {}
        for which, names, recorded in ((0, plant.output_names, data.Y), (1, plant.input_names, data.U)):
            for k, signal in enumerate(names):
                rows[signal] = {stage: fit_measures(recorded[a:b, k], run[which][a:b, k])
                                for stage, run in runs.items()}
    Y, U = runs["refitted"]
    errors = [np.sqrt(np.mean((recorded - run) ** 2, axis=0)) / (np.std(recorded, axis=0) + 1e-300)
              for recorded, run in ((data.Y, Y), (data.U, U))]
    share = float(np.sum(errors[1] ** 2) / max(np.sum(errors[1] ** 2) + np.sum(errors[0] ** 2), 1e-300))
    content = {"fit": table, "controller_bft": faithful, "references": bool(loop.references),
               "error_share": dict(zip((*plant.output_names, *plant.input_names), map(float, np.concatenate(errors)),
                                       strict=True)), "shows_in_inputs": share}
    return content, _notes(content, plant, errors)


def _notes(content, plant, errors) -> list[str]:
    notes = []
    for name, bft in (content["controller_bft"] or {}).items():
        if not bft >= FAITHFUL:
            notes.append(f"the controller, driven by the recorded references and outputs, reproduces {bft:.0f} % of "
                         f"{name}: it is not quite the one that closed the loop")
    y, u = (float(np.max(e)) for e in errors)
    if not (np.isfinite(y) and np.isfinite(u)):
        notes.append("the loop closed around the refitted simulator runs away")
    elif u > 3 * y:
        notes.append(f"the loop hides the mismatch: closed around the refitted simulator it errs by {100 * y:.1f} % on "
                     f"{', '.join(plant.output_names)} and by {100 * u:.1f} % on {', '.join(plant.input_names)}")
    return notes
