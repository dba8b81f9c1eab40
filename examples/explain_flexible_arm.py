"""What does the frozen LPV model of a flexible arm leave out? (Vizer, Mercère, Prot and Laroche, section 3.)

The recordings are sweeps of the elbow of the true nonlinear arm. The simulator handed to `pwaid.mismatch` is the
paper's model M(kappa) ddq = forces, kappa = cos(theta2), interpolated between frozen operating points: no force in it
depends on products of speeds. Payload, stiffnesses and velocity-loop gains are 5 to 10 % off as well. Joint speeds
carry noise at 30 dB (footnote 5 of the paper), the elbow's encoder 0.5 mrad. The test sweep is faster than all
training sweeps and runs the other way.

    python examples/explain_flexible_arm.py [--quick] [--save DIR]
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from _common import options, result
from _explained import named_laws, outcome
from pwaid.mismatch import explain_case
from pwaid.mismatch.case import write_case
from pwaid.recording import Recording
from pwaid.systems.vizer2014 import FlexibleArmParameters, vizer2014_flexible_arm_lpv, vizer2014_flexible_arm_sweep

TRUE = FlexibleArmParameters()
NOMINAL = {"payload": 0.45, "k1": 1.08 * 4 * TRUE.ei1 * TRUE.l1, "k2": 0.93 * 4 * TRUE.ei2 * TRUE.l2,
           "gain1": 1.05 * TRUE.gain1, "gain2": 0.95 * TRUE.gain2}
UNITS = {"dtheta1_ref": "rad/s", "dtheta2_ref": "rad/s", "y1": "rad/s", "y2": "rad/s", "theta2": "rad"}

SIMULATOR = '''"""Two-link flexible arm, LPV model frozen in kappa = cos(theta2): M(kappa) ddq = torques and springs.

q = (theta1, theta2, v1, v2). M0 and M1 are those without payload, P0 and P1 per kilogram of it. SI units.
"""

import control
import numpy as np

M0 = np.array({M0})
M1 = np.array({M1})
P0 = np.array({P0})
P1 = np.array({P1})
C1 = np.array({C1})


def solve(M, f):
    """M^-1 f by elimination; M is positive definite and overwritten."""
    n = f.size
    for i in range(n):
        for r in range(i + 1, n):
            c = M[r, i] / M[i, i]
            for j in range(i, n):
                M[r, j] -= c * M[i, j]
            f[r] -= c * f[i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            f[i] -= M[i, j] * f[j]
        f[i] /= M[i, i]
    return f


def update(t, x, u, params):
    kappa = np.cos(x[6])
    M = M0 + kappa * M1 + params["payload"] * (P0 + kappa * P1)
    f = np.array([params["gain1"] * (u[0] - x[2]), params["gain2"] * (u[1] - x[3]),
                  -params["k1"] * x[0], -params["k2"] * x[1]])
    ddq = solve(M, f)
    return np.array([x[4], x[5], ddq[0], ddq[1], ddq[2], ddq[3], x[3]])


def output(t, x, u, params):
    y1 = C1[0, 0] * x[2] + C1[0, 1] * x[3] + C1[0, 2] * x[4] + C1[0, 3] * x[5]
    y2 = C1[1, 0] * x[2] + C1[1, 1] * x[3] + C1[1, 2] * x[4] + C1[1, 3] * x[5]
    return np.array([y1, y2, x[6]])


def build():
    return control.nlsys(update, output, inputs=["dtheta1_ref", "dtheta2_ref"], outputs=["y1", "y2", "theta2"],
                         states=["v1", "v2", "dtheta1", "dtheta2", "dv1", "dv2", "theta2"], name="flexible_arm",
                         params={params})
'''


def simulator() -> str:
    """The frozen model's file: inertia without payload and per kilogram of payload, in which it is linear."""
    light, heavy = (vizer2014_flexible_arm_lpv(replace(TRUE, m_tip=m)) for m in (0.0, 1.0))
    numbers = {"M0": light.M0, "M1": light.M1, "P0": heavy.M0 - light.M0, "P1": heavy.M1 - light.M1,
               "C1": light.output}
    text = SIMULATOR.replace("{params}", repr(NOMINAL))
    for name, matrix in numbers.items():
        text = text.replace("{" + name + "}", repr(matrix.round(12).tolist()))
    return text


def sweep(duration: float, amplitude: float, seed: int, backwards: bool = False) -> Recording:
    """A sweep of the elbow over 3 pi/4 with PRBS on both joints, every 2 ms, noise at 30 dB."""
    ends = np.pi / 8 * np.array([1, 7])
    run = vizer2014_flexible_arm_sweep(duration, amplitude=amplitude, rng=[7, seed], decimation=20,
                                       start=ends[int(backwards)], stop=ends[1 - int(backwards)])
    rng = np.random.default_rng([8, seed])
    angle = run.theta2 + 5e-4 * rng.standard_normal(run.time.size)
    return Recording(run.time, run.inputs, np.column_stack([run.noisy(30, rng), angle]),
                     ("dtheta1_ref", "dtheta2_ref"), ("y1", "y2", "theta2"), UNITS)


def fits(report, test: str) -> dict:
    """BFT of the joint speeds on the test sweep, percent, at each stage."""
    held = report.fit[test]
    return {stage: [held[y][stage]["bft"] for y in ("y1", "y2")] for stage in ("nominal", "refitted", "repaired")}


def draw(report, folder: Path) -> None:
    """Speed of joint 1 on the unseen sweep: recorded, refitted frozen model, repaired."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    test, dt = report.problem.test, report.problem.train.sample_time
    time = np.arange(len(test.Y)) * dt
    figure, axes = plt.subplots(2, 1, figsize=(8, 4.2), sharex=True, layout="constrained")
    axes[0].plot(time, test.Y[:, 0], "k", lw=2, alpha=0.35, label="recorded")
    for Y, colour, label in ((report.null.test.Y, "C0", "frozen, parameters refitted"),
                             (report.best.test.Y, "C3", "with coriolis_torque")):
        axes[0].plot(time, Y[:, 0], colour, lw=1, label=label)
        axes[1].plot(time, test.Y[:, 0] - Y[:, 0], colour, lw=1)
    axes[0].set(ylabel="y1, rad/s", title="unseen sweep of 1 s")
    axes[0].legend(fontsize=8)
    axes[1].set(xlabel="time, s", ylabel="error, rad/s")
    for axis in axes:
        axis.grid(alpha=0.3)
    figure.savefig(folder / "explain_flexible_arm.png", dpi=110)


def main() -> None:
    args = options(__doc__.splitlines()[0])
    out = args.save or Path(tempfile.mkdtemp(prefix="pwaid_arm_"))
    train = {"fast.csv": sweep(1.5, 0.1, 1), "faster.csv": sweep(1.2, 0.1, 2, backwards=True)}
    if not args.quick:
        train = {"slow.csv": sweep(3.0, 0.3, 0)} | train
    test = {"test.csv": sweep(1.0, 0.1, 3, backwards=True)}
    case = write_case(out / "case", simulator(), train, test, list(NOMINAL))
    report = explain_case(case, out / "explained")
    print(report.summary)
    if args.save:
        draw(report, out)
    result(**outcome(report, "test.csv", "y1", case), laws=named_laws(report), bft_percent=fits(report, "test.csv"))


if __name__ == "__main__":
    main()
