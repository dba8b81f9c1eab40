"""Before the long work: does the simulator run over the recordings, how long does it take, where does it start?"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pwaid.errors import InputError
from pwaid.mismatch.dataset import Dataset
from pwaid.mismatch.model import Model, Settings
from pwaid.mismatch.plant import Plant
from pwaid.recording import Recording

__all__ = [
    "SlowSimulationWarning",
    "check_black_box",
    "check_names",
    "check_recordings",
    "expected_time",
    "failed_trials",
    "prepare_black_box",
]

PULSED = 4.0  # time constants over which inputs lead to the start of a recording
SWEEPS = 1500  # simulations of all recordings assumed for a run with the whole catalogue: an estimate, not counted
TIMED_SUBSTEPS = 2
SHORTEST = 20  # samples: fewer hold no block to bootstrap and no difference to estimate the noise from
SKIPPED = 0.25  # of a recording, at most


def _nominal(plant: Plant, data: Dataset, r: int) -> np.ndarray:
    """The black box as it came, over one recording."""
    a, b = data.recordings[r]
    U = np.zeros((b - a, plant.sizes[1] + len(plant.force_names)))
    U[:, :plant.sizes[1]] = data.U[a:b]
    try:
        return plant.black_box.call(U, plant.black_box.parameters, np.zeros(plant.sizes[0]))
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"the simulator raised {type(error).__name__}: {error} over recording {data.names[r]} (u of "
                         f"shape {data.U[a:b].shape}); expected y of shape ({b - a}, {plant.sizes[2]})") from error


def check_recordings(plant: Plant, train: Sequence[Recording], test: Sequence[Recording]) -> None:
    """Channels, lengths, sampling and independence of the recordings.

    Raises
    ------
    InputError
        For recordings that do not fit the simulator or each other, or that were used twice.
    """
    _, nu, ny = plant.sizes
    for r in (*train, *test):
        for have, want, what in ((r.inputs.shape[1], nu, "inputs"), (r.outputs.shape[1], ny, "outputs")):
            if have != want:
                raise InputError(f"{r.name} has {have} {what}, the simulator {want}; give the simulator's {what}")
        if len(r) < SHORTEST:
            raise InputError(f"{r.name} has {len(r)} samples; expected at least {SHORTEST}: record longer, or leave it "
                             "out")
    step = train[0].sample_time
    for r in test:
        if r.names != train[0].names:
            raise InputError(f"{r.name} has the channels {r.names} and {train[0].name} {train[0].names}; expected the "
                             "same channels in the same order")
        if abs(r.sample_time / step - 1) > 1e-3:
            raise InputError(f"the test recording {r.name} is sampled every {r.sample_time:g} s, the training ones "
                             f"every {step:g} s; resample them to one clock")
        used = next((q.name for q in train if _inside(r, q)), None)
        if used is not None:
            raise InputError(f"test recording {r.name} is also a training recording (its samples are in {used}); hold "
                             "one out")
    if plant.black_box is None and plant.dt and abs(plant.dt / step - 1) > 1e-3:
        raise InputError(f"the simulator steps {plant.dt:g} s, the recordings are sampled every {step:g} s; resample "
                         "one of them")


def check_names(plant: Plant, tolerances, noise_floor) -> None:
    """Raises InputError for a tolerance or a floor of something the simulator does not have."""
    rows = ((tolerances, plant.parameters, "parameter"), (noise_floor, plant.output_names, "output"))
    for given, known, what in rows:
        for name, value in (given or {}).items():
            if name not in known:
                raise InputError(f"{name!r} is no {what} of the simulator; it has {', '.join(known) or 'none'}")
            if not 0 < value < np.inf:
                raise InputError(f"{name!r} was given {value!r}; expected a positive number")


def _inside(r: Recording, q: Recording) -> bool:
    """Whether all samples of r, inputs and outputs, are a stretch of q."""
    a, b = (np.hstack([z.inputs, z.outputs]) for z in (r, q))
    starts = np.flatnonzero(np.all(b[:len(b) - len(a) + 1] == a[0], axis=1)) if len(b) >= len(a) else ()
    return any(np.array_equal(b[k:k + len(a)], a) for k in starts)


class SlowSimulationWarning(UserWarning):
    """The simulator runs in Python; the text says how long that may take."""


def expected_time(plant: Plant, data: Dataset) -> str:
    """How long explaining may take, from a few simulated samples; an empty text when it is compiled or soon done.

    `SWEEPS` simulations of all recordings are expected. A black box is timed over the first recording; the Python
    loop over the first samples of all, which it simulates side by side.
    """
    if plant.rhs is not None:
        return ""
    started = time.perf_counter()
    if plant.black_box is not None:
        _nominal(plant, data, 0)
        one = (time.perf_counter() - started) * len(data.names)
    else:
        nx = plant.sizes[0]
        model = Model(Settings(plant, np.full(nx, -1, dtype=np.int64), np.zeros(nx), (), np.zeros(0),
                               substeps=TIMED_SUBSTEPS))
        head = replace(data, segments=np.array([(a, min(b, a + 20), a, b) for a, b in data.recordings]))
        model.simulate(np.zeros(0), np.zeros((len(head.segments), nx)), head)  # compiles what runs the columns
        started = time.perf_counter()
        model.simulate(np.zeros(0), np.zeros((len(head.segments), nx)), head)
        one = (time.perf_counter() - started) / 20 * float(np.max(np.diff(data.recordings)))
    minutes = one * SWEEPS / 60
    if minutes < 1.0:
        return ""
    return (f"the simulator runs in Python and takes about {one:.2g} s for the recordings; some {SWEEPS} simulations "
            f"are needed: expect about {minutes:.0f} minutes. Shorter recordings, fewer effects (without=...), or "
            "simple arithmetic on x[i], u[j], params['name'], which compiles, would help")


def prepare_black_box(plant: Plant, data: Dataset, held: Dataset) -> tuple[Plant, Dataset, Dataset, list[str]]:
    """The black box tried on every recording, its unknown start made free where that can be done.

    A callable without x0 is led to its start by inputs in front of the recording; where they cannot (it is not at
    rest before, or hardly answers small inputs), what the start spoils is left out of the comparison. Returns the
    plant, the training and the held-out data, and notes.
    """
    simulated, tested = check_black_box(plant, data), check_black_box(plant, held)
    if plant.black_box.start.size:
        return plant, data, held, []
    led = _with_history(plant, data, simulated)
    if led is not None:
        seconds = led.black_box.pulses[-1][2] * data.sample_time
        return led, data, held, ["the simulator takes no x0: its start is fitted as pulses of the inputs over "
                                 f"{seconds:.3g} s before every recording"]
    notes = ["the simulator takes no x0, and inputs in front of a recording do not set its start: it starts as it "
             "likes, and an error that dies out may be its start; an x0 argument would let pwaid fit it"]
    samples = max(_spoiled(data, simulated), _spoiled(held, tested))
    if not samples:
        return plant, data, held, notes
    notes.append(f"the first {samples * data.sample_time:.3g} s of every recording are not compared: the error there "
                 "dies out, as from another start")
    return plant, data.without_start(samples), held.without_start(samples), notes


def failed_trials(plant: Plant) -> list[str]:
    """A note when the simulator raised on the way: such trials counted as diverged."""
    raised = sorted(plant.raised)
    more = f" and {len(raised) - 1} other errors" if len(raised) > 1 else ""
    return [f"the simulator raised {raised[0]}{more} at some states, inputs or parameters: these count as diverged"
            ] if raised else []


def _with_history(plant: Plant, data: Dataset, simulated) -> Plant | None:
    """The plant led to its start by inputs, where inputs held in front of a recording leave it as it is."""
    spread = np.std(data.Y, axis=0) + 1e-300
    rate = np.std(np.diff(data.Y, axis=0), axis=0) + 1e-300
    shortest = int(np.min(np.diff(data.recordings)))
    samples = int(np.clip(PULSED * np.median(spread / rate), 8, max(8, shortest // 2)))
    a, b = data.recordings[0]
    rms = np.sqrt(np.mean(data.U**2, axis=0))
    for base in (np.zeros(data.U.shape[1]), data.U[a]):
        box = plant.black_box.with_history(samples, base, rms)
        U = np.zeros((b - a, plant.sizes[1] + len(plant.force_names)))
        U[:, :plant.sizes[1]] = data.U[a:b]
        y = box.run(U, box.parameters, np.zeros(box.n_starts))
        if y is not None and np.all(np.abs(y - simulated[0]) < 1e-6 * spread) and _leads_evenly(box, U, y):
            return replace(plant, black_box=box, state_names=tuple(f"start_{i}" for i in range(box.n_starts)))
    return None


def _leads_evenly(box, U, y) -> bool:
    """Whether small pulses move the start about as much, in proportion, as large ones: only then can they be fitted."""
    for i, size in enumerate(box.sizes):
        moved = []
        for factor in (1e-3, 1.0):
            pulse = np.zeros(box.n_starts)
            pulse[i] = factor * size
            other = box.run(U, box.parameters, pulse)
            if other is None or not np.all(np.isfinite(other)):
                return False
            moved.append(np.linalg.norm(other - y) / factor)
        if not moved[1] / 3 <= moved[0] <= 3 * moved[1]:
            return False
    return True


def check_black_box(plant: Plant, data: Dataset) -> list[np.ndarray]:
    """The nominal outputs over every recording, the callable's contract checked on the way.

    Raises
    ------
    InputError
        When it raises, returns another shape or numbers that are not finite, or is not repeatable.
    """
    found = []
    for r, name in enumerate(data.names):
        y = _nominal(plant, data, r)
        if not np.all(np.isfinite(y)):
            k = int(np.argwhere(~np.isfinite(y))[0, 0])
            raise InputError(f"the simulation of {name} is not finite from sample {k} on (it diverges); check signs, "
                             "units and the internal step of the simulator")
        found.append(y)
    again = _nominal(plant, data, 0)
    if not np.allclose(again, found[0], rtol=1e-9, atol=1e-12 * (1 + np.max(np.abs(again)))):
        raise InputError(f"two simulations of {data.names[0]} differ by up to {np.max(np.abs(again - found[0])):.3g}; "
                         "expected the same outputs for the same inputs: fix its random numbers and its start")
    return found


def _spoiled(data: Dataset, simulated: list[np.ndarray]) -> int:
    """Samples at the beginning of the recordings in which the unknown start shows.

    Blocks of a fortieth of a recording count while their error is more than three times the median block's of the
    second half.
    """
    found = 0
    for (a, b), y in zip(data.recordings, simulated, strict=True):
        block = max(1, (b - a) // 40)
        count = (b - a) // block
        e = ((data.Y[a:b] - y) / (np.std(data.Y, axis=0) + 1e-300))[:count * block]
        rms = np.sqrt(np.mean(e.reshape(count, -1) ** 2, axis=1))
        usual, k = 3.0 * np.median(rms[count // 2:]), 0
        while k < SKIPPED * count and rms[k] > usual:
            k += 1
        found = max(found, k * block)
    return found
