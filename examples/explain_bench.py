"""Why do simulation and bench disagree in overshoot? (Yamada, Ruderman and Fujimoto, section IV.)

Four concealed differences on the simulated bench: Coulomb friction at the motor, at the load, Stribeck friction at the
motor, and parameter errors only (the parameters are off in all four). `pwaid.mismatch` gets the paper's model and
recordings of the loop without and with linear damping: commanded torque, both encoders, torque sensor. The repaired
simulator is then closed with the switched controller, which it has never seen.

    python examples/explain_bench.py [--quick] [--only VARIANT] [--save DIR]
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from _bench import FREE, WITH_GAP, judge_loop, loop_recording, pieces, sampled_loop
from _common import options, result
from _explained import named_laws, outcome
from pwaid.dynamics.dry_friction import DryFriction
from pwaid.mismatch import explain_case
from pwaid.mismatch.case import write_case
from pwaid.systems.yamada2018 import TwoInertia
from pwaid.systems.yamada2018_bench import Bench, step_reference
from pwaid.systems.yamada2018_loop import LoopController

PLANT = TwoInertia().replace(J_L=8.78e-4 * 1.06, K=285.0, D_M=9.30e-2 * 0.92, D_L=3.6e-2 * 1.1)
VARIANTS = {
    "motor": {"motor_friction": DryFriction(0.08)},
    "load": {"load_friction": DryFriction(0.08)},
    "stribeck": {"motor_friction": DryFriction(0.05, 0.10, 0.5)},
    "parameters": {},
}


def prediction(bench: Bench, simulator, duration: float) -> dict:
    """Bench and repaired simulator side by side: the switched controller, and the loop without damping."""
    told = {}
    for kind in ("switched", "none"):
        run = bench.closed_loop(step_reference(duration), LoopController(kind))
        told[kind] = {"bench": judge_loop(run.states[:, 2], run.joint_torque),
                      "predicted": judge_loop(*sampled_loop(simulator, kind, duration, bench.quantum))}
    a, b = told["switched"]["bench"], told["switched"]["predicted"]
    cycles = [[told[k][w]["late_peak_to_peak_mrad"] > 1.0 for w in ("bench", "predicted")] for k in told]
    return {"overshoot_error_mrad": abs(a["overshoot_mrad"] - b["overshoot_mrad"]),
            "impact_error_percent": 100 * abs(b["first_impact"] / a["first_impact"] - 1),
            "limit_cycle_right": all(x == y for x, y in cycles), "loops": told}


def study(name: str, duration: float, out: Path) -> dict:
    """Record, explain, predict."""
    bench = Bench(plant=PLANT, torque_noise=0.01, **VARIANTS[name])
    train, test = {}, {}
    for k, kind in enumerate(("none", "linear")):  # from the step of the reference on, in pieces of 20 ms
        train |= pieces(loop_recording(bench, kind, duration, rng=k)[25:], kind, 50)
        test |= pieces(loop_recording(bench, kind, duration, 0.20, rng=5 + k)[25:], f"test_{kind}", 50)
    case = write_case(out / name / "case", WITH_GAP, train, test, FREE, {"T_s": 0.01}, extra="closed_loop = true")
    report = explain_case(case, out / name / "explained")
    print(f"--- {name}\n{report.summary}")
    figures = outcome(report, "test_none_00.csv", "theta_L", case) | {"laws": named_laws(report)}
    return figures | prediction(bench, report.simulator, 1.2)


def main() -> None:
    args = options(__doc__.splitlines()[0], only=("", "one of " + ", ".join(VARIANTS)))
    out = args.save or Path(tempfile.mkdtemp(prefix="pwaid_bench_"))
    names = [args.only] if args.only else (["motor"] if args.quick else list(VARIANTS))
    studies = {name: study(name, 0.15 if args.quick else 0.25, out) for name in names}
    for name, s in studies.items():
        print(f"{name:10s} {s['verdict']} {s['effects']}: switched overshoot off by {s['overshoot_error_mrad']:.2f} "
              f"mrad, first impact by {s['impact_error_percent']:.1f} %, limit cycle right: {s['limit_cycle_right']}")
    result(**studies[names[0]], variants=studies)


if __name__ == "__main__":
    main()
