"""Write the packaged case of `pwaid demo`: a rotary drive whose simulator knows nothing of dry friction.

The truth is integrated with exact sticking at a step 200 times finer than the sampling; inertia and
viscous friction of the simulator are off by 12 % and 20 %; the seed is fixed.

    python examples/make_demo_case.py DIR
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from pwaid.mismatch.case import write_case
from pwaid.recording import Recording

SIMULATOR = '''"""A rotary drive with a soft return spring: motor torque to shaft angle."""

import control
import numpy as np


def update(t, x, u, params):
    J, b, k = params["J"], params["b"], params["k"]
    return np.array([x[1], (u[0] - b * x[1] - k * x[0]) / J])


def output(t, x, u, params):
    return np.array([x[0]])


def build():
    return control.nlsys(update, output, inputs=["torque"], outputs=["theta"], states=["theta", "omega"],
                         params={"J": 0.0224, "b": 0.048, "k": 0.9}, name="rotary_drive")
'''
TRUTH = {"J": 0.020, "b": 0.060, "k": 0.9, "level": 0.12}


def record(rng, name: str, samples: int = 1500, sample_time: float = 0.01, fine: int = 200) -> Recording:
    """One recording: two-amplitude multisine torque, exact stick and slip, 0.5 mrad of sensor noise."""
    t = np.arange(samples) * sample_time
    f = rng.uniform(0.1, 2.5, 10)
    torque = 0.35 * np.sin(2 * np.pi * np.outer(t, f) + rng.uniform(0, 2 * np.pi, 10)).sum(axis=1) / 2.5
    torque *= np.where(t < t[-1] / 2, 1.0, 2.0)
    theta, omega, h = 0.0, 0.0, sample_time / fine
    y = np.empty(samples)
    for i in range(samples):
        y[i] = theta
        for _ in range(fine):
            smooth = torque[i] - TRUTH["b"] * omega - TRUTH["k"] * theta
            if omega == 0.0 and abs(smooth) <= TRUTH["level"]:
                continue
            sign = np.sign(omega) if omega != 0.0 else np.sign(smooth)
            half = omega + 0.5 * h * (smooth - TRUTH["level"] * sign) / TRUTH["J"]
            smooth = torque[i] - TRUTH["b"] * half - TRUTH["k"] * (theta + 0.5 * h * omega)
            new = omega + h * (smooth - TRUTH["level"] * sign) / TRUTH["J"]
            new = 0.0 if new * sign < 0.0 else new
            theta += 0.5 * h * (omega + new)
            omega = new
    y += 0.5e-3 * rng.normal(size=samples)
    return Recording(t, torque[:, None], y[:, None], ("torque",), ("theta",),
                     {"torque": "N m", "theta": "rad"},
                     name=name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=2014)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    train = {f"train_{i}.csv": record(rng, f"train_{i}.csv") for i in range(2)}
    test = {"test_2.csv": record(rng, "test_2.csv")}
    write_case(args.folder, SIMULATOR, train, test, ["J", "b", "k"])
    print("RESULT " + json.dumps({"recordings": 3,
                                  "bytes": sum(p.stat().st_size for p in args.folder.iterdir())}))


if __name__ == "__main__":
    main()
