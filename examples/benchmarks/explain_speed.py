"""How long does an explanation take? Two training recordings of 4 000 samples, a mass on a spring, all effects.

Three machines: with Coulomb friction, with Coulomb friction and a hardening spring (which makes the pairs run), and
without anything left out. Each is recorded with exact sticking, explained once, and timed stage by stage, in seconds
of wall clock and of CPU (all threads); compiling the user's equations is part of "prepare".

    python examples/benchmarks/explain_speed.py [--samples N] [--jobs N] [--machine friction|pair|clean]
"""

from __future__ import annotations

import argparse
import json
import time

import control
import numpy as np

from pwaid.mismatch import explain
from pwaid.recording import Recording

TRUE = {"m": 1.0, "b": 0.45, "k": 3.0}
MACHINES = {"friction": (0.3, 0.0), "pair": (0.3, 1.5), "clean": (0.0, 0.0)}  # Coulomb level (N), cubic spring (N/m^3)
STAGES = {"refitting": "refit", "screening": "screen", "fitting pairs": "pairs", "fitting": "fits",
          "deciding": "decide", "locating": "locate and report"}


def update(t, x, u, params):
    return np.array([x[1], (u[0] - params["b"] * x[1] - params["k"] * x[0]) / params["m"]])


def output(t, x, u, params):
    return np.array([x[0]])


def record(seed: int, samples: int, level: float, cubic: float, dt: float = 0.02, fine: int = 10) -> Recording:
    """A multisine recording with 2 mm of sensor noise; dry friction sticks exactly."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * dt
    f = rng.uniform(0.1, 1.5, 8)
    u = 0.7 * np.sin(2 * np.pi * np.outer(t, f) + rng.uniform(0, 2 * np.pi, 8)).sum(axis=1)
    x, v, h = 0.0, 0.0, dt / fine
    y = np.empty(samples)
    for i in range(samples):
        y[i] = x
        for _ in range(fine):
            force = u[i] - TRUE["b"] * v - TRUE["k"] * x - cubic * x**3
            if v == 0.0 and abs(force) <= level:
                continue
            sign = np.sign(v) if v != 0.0 else np.sign(force)
            new = v + h * (force - level * sign) / TRUE["m"]
            new = 0.0 if new * sign < 0.0 else new
            x += 0.5 * h * (v + new)
            v = new
    y += 2e-3 * rng.standard_normal(samples)
    return Recording(t, u[:, None], y[:, None], ("F",), ("x",), {"F": "N", "x": "m"}, name=f"{seed}.csv")


class Clock:
    """Seconds of wall clock and of CPU of each stage, from the progress calls."""

    def __init__(self):
        self.marks = [("prepare", time.perf_counter(), time.process_time())]

    def __call__(self, fraction, text):
        name = next((short for begin, short in STAGES.items() if text.startswith(begin)), "end")
        self.marks.append((name, time.perf_counter(), time.process_time()))

    def stages(self) -> dict:
        found = {}
        for (name, wall, cpu), (_, later, cpu_later) in zip(self.marks, self.marks[1:], strict=False):
            found[name] = {"seconds": round(later - wall, 2), "cpu_seconds": round(cpu_later - cpu, 2)}
        return found


def study(name: str, samples: int, jobs: int) -> dict:
    """Explain one machine and time it."""
    train = [record(seed, samples, *MACHINES[name]) for seed in (1, 2)]
    test = record(3, samples, *MACHINES[name])
    simulator = control.nlsys(update, output, inputs=["F"], outputs=["x"], states=["x", "v"],
                              params={"m": 1.1, "b": 0.5, "k": 3.2})
    clock, cpu, wall = Clock(), time.process_time(), time.perf_counter()
    report = explain(simulator, train, test, jobs=jobs, progress=clock)
    figures = {"verdict": report.verdict, "effects": [e["id"] for e in report.effects],
               "seconds": round(time.perf_counter() - wall, 1), "cpu_seconds": round(time.process_time() - cpu, 1),
               "hypotheses": report.content["hypotheses_tried"], "stages": clock.stages()}
    spent = f"{figures['seconds']} s, CPU {figures['cpu_seconds']} s"
    print(f"{name}: {figures['verdict']} {figures['effects']} in {spent}")
    for stage, spent in figures["stages"].items():
        print(f"    {stage:20s} {spent['seconds']:7.2f} s  CPU {spent['cpu_seconds']:7.2f} s")
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=4000, help="per training recording")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--machine", choices=list(MACHINES), help="only this one")
    args = parser.parse_args()
    names = [args.machine] if args.machine else list(MACHINES)
    studies = {name: study(name, args.samples, args.jobs) for name in names}
    worst = max(studies.values(), key=lambda s: s["seconds"])
    print("RESULT " + json.dumps({"seconds": worst["seconds"], "cpu_seconds": worst["cpu_seconds"],
                                  "samples": args.samples, "jobs": args.jobs, "machines": studies}))


if __name__ == "__main__":
    main()
