"""The bench of Yamada, Ruderman and Fujimoto (section IV) for the explain scripts: recordings, simulator, loop."""

from __future__ import annotations

import numpy as np

from pwaid.recording import Recording
from pwaid.systems.yamada2018_bench import Bench, step_reference
from pwaid.systems.yamada2018_loop import LoopController, read_encoder

UNITS = {"T_M": "N m", "theta_M": "rad", "theta_L": "rad", "T_s": "N m"}
OUTPUTS = ("theta_M", "theta_L", "T_s")
FREE = ["J_M", "D_M", "K", "D_B", "J_L", "D_L"]

WITH_GAP = '''"""The drive of Table II with its backlash and without dry friction; SI units."""

import control
import numpy as np


def update(t, x, u, params):
    twist = x[0] - x[2]
    torque = 0.0
    if twist >= params["beta"]:
        torque = params["D_B"] * (x[1] - x[3]) + params["K"] * (twist - params["beta"])
    if twist <= -params["beta"]:
        torque = params["D_B"] * (x[1] - x[3]) + params["K"] * (twist + params["beta"])
    return np.array([x[1], (u[0] - torque - params["D_M"] * x[1]) / params["J_M"],
                     x[3], (torque - params["D_L"] * x[3]) / params["J_L"]])


def output(t, x, u, params):
    twist = x[0] - x[2]
    torque = 0.0
    if twist >= params["beta"]:
        torque = params["D_B"] * (x[1] - x[3]) + params["K"] * (twist - params["beta"])
    if twist <= -params["beta"]:
        torque = params["D_B"] * (x[1] - x[3]) + params["K"] * (twist + params["beta"])
    return np.array([x[0], x[2], torque])


def build():
    return control.nlsys(update, output, inputs=["T_M"], outputs=["theta_M", "theta_L", "T_s"],
                         states=["theta_M", "omega_M", "theta_L", "omega_L"], name="drive",
                         params={"J_M": 8.78e-4, "D_M": 9.30e-2, "K": 300.0, "D_B": 0.1, "J_L": 8.78e-4,
                                 "D_L": 3.60e-2, "beta": 7.80e-3})
'''

WITHOUT_GAP = '''"""The drive of Table II with an elastic joint, without backlash and without dry friction; SI units."""

import control
import numpy as np


def update(t, x, u, params):
    torque = params["D_B"] * (x[1] - x[3]) + params["K"] * (x[0] - x[2])
    return np.array([x[1], (u[0] - torque - params["D_M"] * x[1]) / params["J_M"],
                     x[3], (torque - params["D_L"] * x[3]) / params["J_L"]])


def output(t, x, u, params):
    return np.array([x[0], x[2]])


def build():
    return control.nlsys(update, output, inputs=["T_M"], outputs=["theta_M", "theta_L"],
                         states=["theta_M", "omega_M", "theta_L", "omega_L"], name="drive",
                         params={"J_M": 8.78e-4, "D_M": 9.30e-2, "K": 300.0, "D_B": 0.1, "J_L": 8.78e-4,
                                 "D_L": 3.60e-2})
'''


def loop_recording(bench: Bench, kind: str, duration: float, size: float = 0.30, rng=None) -> Recording:
    """Torque command, encoders and torque sensor of a step under one kind of damping."""
    run = bench.closed_loop(step_reference(duration, size=size), LoopController(kind), rng=rng)
    outputs = np.column_stack([run.theta_M, run.theta_L, run.T_s])
    return Recording(run.time, run.T_M[:, None], outputs, ("T_M",), OUTPUTS, UNITS)


def pieces(recording: Recording, name: str, samples: int) -> dict[str, Recording]:
    """The recording cut into pieces with start states of their own: one contact makes a drive with a gap diverge."""
    cuts = [recording[k:k + samples] for k in range(0, len(recording.time) - samples + 1, samples)]
    return {f"{name}_{k:02d}.csv": c.replace(time=c.time - c.time[0]) for k, c in enumerate(cuts)}


def sampled_loop(simulator, kind: str, duration: float, quantum: float) -> tuple[np.ndarray, np.ndarray]:
    """Load angle and joint torque of a repaired (discrete-time) simulator closed with the bench's controller."""
    controller = LoopController(kind)
    reference = step_reference(duration)
    x, state = np.zeros(simulator.nstates), controller.start()
    outputs = np.empty((reference.size, 3))
    for k, r in enumerate(reference):
        t = k / controller.rate
        outputs[k] = simulator.output(t, x, np.zeros(1))
        state, torque = controller.step(state, r, *read_encoder(outputs[k, :2], quantum))
        x = np.ravel(simulator.dynamics(t, x, np.array([torque])))
    return outputs[:, 1], outputs[:, 2]


def first_impact(T_s) -> float:
    """Height of the first impact, N m: the largest torque until the joint opens or 20 ms have passed."""
    begin = int(np.argmax(np.abs(T_s) > 0.15))
    return float(np.max(np.abs(T_s[begin:begin + 50])))


def judge_loop(theta_L, T_s, rate: float = 2500.0) -> dict:
    """Overshoot (mrad), first impact (N m), late peak to peak (mrad) of the step of 0.30 rad."""
    late = theta_L[-round(0.3 * rate):]
    return {"overshoot_mrad": 1e3 * (float(np.max(theta_L)) - 0.30), "first_impact": first_impact(T_s),
            "late_peak_to_peak_mrad": 1e3 * float(np.ptp(late))}
