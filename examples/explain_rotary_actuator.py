"""What did the linear motor model of a harmonic drive leave out?

Two stand-ins with dry friction inside, for the actuators of Maruta and Sugie (2011, section V) and of Maruta and
Ohlsson (2014, Example 2), are recorded; the simulator that is handed to `pwaid.mismatch` is the linear motor. The
named friction is drawn beside the one inside.

    python examples/explain_rotary_actuator.py [--quick] [--save DIR]
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from _common import options, result
from _explained import friction, named_laws, outcome
from pwaid.mismatch import explain_case
from pwaid.mismatch.case import write_case
from pwaid.recording import Recording
from pwaid.systems.maruta2011 import DCMotor
from pwaid.systems.maruta2014 import RotaryActuator

DC_MOTOR = '''"""DC motor, linear: inertia and viscous friction, driven by its current."""

import control
import numpy as np


def update(t, x, u, params):
    return np.array([(params["torque_constant"] * u[0] - params["viscous"] * x[0]) / params["inertia"]])


def output(t, x, u, params):
    return np.array([x[0]])


def build():
    return control.nlsys(update, output, inputs=["current"], outputs=["speed"], states=["omega"],
                         params={"inertia": 2.0e-4, "viscous": 1.4e-3, "torque_constant": 0.04}, name="dc_motor")
'''

ROTARY = '''"""Rotary actuator, linear: the amplifier's lag, inertia and viscous friction, in volts of command."""

import control
import numpy as np


def update(t, x, u, params):
    return np.array([(u[0] - x[0]) / params["lag"], (x[0] - params["viscous"] * x[1]) / params["inertia"]])


def output(t, x, u, params):
    return np.array([x[1]])


def build():
    return control.nlsys(update, output, inputs=["command"], outputs=["speed"],
                         states=["torque", "omega"],
                         params={"lag": 4e-3, "inertia": 4.6e-3, "viscous": 4.7e-2}, name="rotary_actuator")
'''


def motor_recording(n: int, command: int, noise: int) -> Recording:
    current = np.repeat(np.random.default_rng(command).uniform(-1.5, 1.5, -(-n // 10)), 10)[:n]
    run = DCMotor().respond(current, noise)
    return Recording(run.time, run.current[:, None], run.speed[:, None], ("current",), ("speed",),
                     {"current": "A", "speed": "rad/s"})


def rotary_recording(n: int, command: int, noise: int) -> Recording:
    """Speed as the central difference of the encoder's angle, which has no delay (the backward one has 5 ms)."""
    u = np.repeat(np.random.default_rng(command).standard_normal(n // 10 + 2), 10)[:n + 2]
    theta = 0.01 * np.cumsum(RotaryActuator().respond(u, noise))
    return Recording(0.01 * np.arange(n), u[2:, None], (theta[2:, None] - theta[:-2, None]) / 0.02, ("command",),
                     ("speed",), {"command": "V", "speed": "rad/s"})


def study(name: str, simulator: str, record, samples: int, free, output: str, truth, reach: float, out: Path) -> dict:
    """Write the case, explain it, and compare the named friction with the one inside."""
    train = {f"train_{k}.csv": record(samples, command=0, noise=k) for k in range(2)}  # one command, recorded twice
    test = {"test.csv": record(samples, command=1, noise=2)}
    case = write_case(out / name / "case", simulator, train, test, free,
                      extra='repeats = [["train_0.csv", "train_1.csv"]]')
    report = explain_case(case, out / name / "explained")
    print(report.summary)
    found = friction(report, "state:omega")
    fast = np.linspace(0.3, 1.0, 60) * reach
    error = np.abs(found(fast) - truth(fast)).mean() / truth(fast).mean()
    figures = outcome(report, "test.csv", output, case)
    return figures | {"laws": named_laws(report), "friction_error_percent": 100 * float(error),
                      "curve": (reach, found, truth)}


def draw(studies: dict, folder: Path) -> None:
    """The named friction beside the one inside."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(studies), figsize=(8, 3.2), layout="constrained")
    for axis, (name, s) in zip(axes, studies.items(), strict=True):
        reach, found, truth = s["curve"]
        v = np.linspace(-reach, reach, 801)
        axis.plot(v, truth(v), "k", lw=2.5, alpha=0.4, label="inside")
        axis.plot(v, found(v), "C3", lw=1.2, label="named")
        axis.set(title=name.replace("_", " "), xlabel="speed, rad/s",
                 ylabel="friction, N m" if name == "dc_motor" else "friction, V of command")
        axis.grid(alpha=0.3)
    axes[0].legend()
    figure.savefig(folder / "explain_rotary_actuator.png", dpi=110)


def main() -> None:
    args = options(__doc__.splitlines()[0])
    out = args.save or Path(tempfile.mkdtemp(prefix="pwaid_actuators_"))
    samples = 500 if args.quick else 3000
    studies = {
        "dc_motor": study("dc_motor", DC_MOTOR, motor_recording, samples, ["inertia", "viscous"], "speed",
                          DCMotor().friction.torque, 30.0, out),
        "rotary_actuator": study("rotary_actuator", ROTARY, rotary_recording, samples, ["inertia", "viscous", "lag"],
                                 "speed", RotaryActuator().friction.torque, 20.0, out),
    }
    if args.save:
        draw(studies, out)
    rotary, motor = ({k: v for k, v in studies[n].items() if k != "curve"} for n in ("rotary_actuator", "dc_motor"))
    result(**rotary, dc_motor=motor)


if __name__ == "__main__":
    main()
