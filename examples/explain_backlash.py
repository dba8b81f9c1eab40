"""The backlash left out: the bench of Yamada, Ruderman and Fujimoto against a simulator with an elastic joint only.

Commanded torque and both encoders of the loop without and with linear damping; the joint's parameters are off as well.

    python examples/explain_backlash.py [--quick] [--save DIR]
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from _bench import FREE, WITHOUT_GAP, loop_recording, pieces
from _common import options, result
from _explained import named_laws, outcome
from pwaid.mismatch import explain_case
from pwaid.mismatch.case import write_case
from pwaid.systems.yamada2018 import TwoInertia
from pwaid.systems.yamada2018_bench import Bench

PLANT = TwoInertia().replace(J_L=8.78e-4 * 1.06, K=285.0, D_M=9.30e-2 * 0.92, D_L=3.6e-2 * 1.1)


def encoders(recording):
    """The recording without the torque sensor."""
    units = {k: u for k, u in recording.units.items() if k != "T_s"}
    return recording.replace(outputs=recording.outputs[:, :2], output_names=recording.output_names[:2], units=units)


def main() -> None:
    args = options(__doc__.splitlines()[0])
    out = args.save or Path(tempfile.mkdtemp(prefix="pwaid_backlash_"))
    bench, duration = Bench(plant=PLANT), 0.25 if args.quick else 0.5
    train, test = {}, {}
    for kind in ("none", "linear"):
        train |= pieces(encoders(loop_recording(bench, kind, duration))[25:], kind, 40)
        test |= pieces(encoders(loop_recording(bench, kind, duration, 0.20))[25:], f"test_{kind}", 40)
    case = write_case(out / "case", WITHOUT_GAP, train, test, FREE, extra="closed_loop = true")
    report = explain_case(case, out / "explained")
    print(report.summary)
    gap = next((q["half_gap"] for name, _, q in named_laws(report) if name == "backlash"), float("nan"))
    result(**outcome(report, "test_none_00.csv", "theta_L", case), half_gap=gap, half_gap_inside=PLANT.beta,
           half_gap_error_percent=100 * abs(gap / PLANT.beta - 1))


if __name__ == "__main__":
    main()
