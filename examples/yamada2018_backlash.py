"""Figures 3-8 of Yamada, Ruderman and Fujimoto: a drive with backlash under no, linear and switched damping.

Run: python examples/yamada2018_backlash.py [--quick] [--save DIR]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from pwaid.dynamics.phase_portrait import phase_portrait
from pwaid.systems.yamada2018 import TwoInertia, closed_loop, pd_gains

KINDS = ("none", "linear", "switched")
STYLE = {"none": ("tab:blue", "-"), "linear": ("tab:red", "--"), "switched": ("k", "-.")}


def simulate(kind, duration, step, gains=None, load_torque=False):
    """One run: the step reference of Fig. 3, or the load torques of Fig. 6; time, and the outputs by name."""
    system = closed_loop(kind, gains=gains)
    t = np.arange(round(duration / step) + 1) * step
    u = np.zeros((t.size, 2))
    if load_torque:  # -0.50 N m at 0.010 s, and 1.0 N m added at 0.15 s
        u[t >= 0.010 - 1e-9, 1] = -0.50
        u[t >= 0.150 - 1e-9, 1] += 1.0
    else:
        u[t >= 0.010 - 1e-9, 0] = 0.30
    run = system.simulate(t, u)
    return t, dict(zip(system.outputs, run.outputs.T, strict=True)), run


def first_impact(T_s):
    """Height of the first peak of the joint torque above 0.2 N m."""
    peak = (T_s[1:-1] > T_s[:-2]) & (T_s[1:-1] >= T_s[2:]) & (T_s[1:-1] > 0.2)
    return float(T_s[1:-1][peak][0])


def limit_cycle(duration):
    """Peak-to-peak load angle (mrad) and period (ms) without damping, over the last second."""
    t, y, _ = simulate("none", duration, 5e-5)
    t, angle = t[t > duration - 1.0], y["theta_L"][t > duration - 1.0] - 0.30
    up = np.flatnonzero((angle[:-1] < 0) & (angle[1:] >= 0))
    crossings = t[up] - angle[up] * (t[up + 1] - t[up]) / (angle[up + 1] - angle[up])
    return 1e3 * float(np.ptp(angle)), 1e3 * float(np.diff(crossings).mean())


def figures(runs, loads, portraits, directory):
    """Draw Figs. 3-8 and save them."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    def panel(ax, results, signal, label, window, scale=1.0):
        for kind in KINDS:
            t, y, _ = results[kind]
            at = (t >= window[0]) & (t <= window[1])
            colour, line = STYLE[kind]
            ax.plot(t[at], scale * y[signal][at], line, color=colour,
                    label=f"{kind} damping".replace("none", "no"), lw=1.2)
        ax.set(xlabel="time [s]", ylabel=label, xlim=window)
        ax.grid(alpha=0.3)

    figure, axes = plt.subplots(2, 2, figsize=(10, 6.5))
    panel(axes[0, 0], runs, "theta_L", "load-side angle [rad]  (Fig. 3a)", (0.0, 0.12))
    panel(axes[0, 1], runs, "theta_L", "load-side angle [rad]  (Fig. 3b)", (0.10, 0.40))
    axes[0, 1].set_ylim(0.27, 0.33)
    panel(axes[1, 0], runs, "T_s", "joint torque [N m]  (Fig. 4)", (0.0, 0.12))
    panel(axes[1, 1], runs, "T_M", "motor torque [N m]  (Fig. 5a)", (0.0, 0.12))
    axes[0, 0].legend()
    save(figure, directory / "yamada_step.png", plt)

    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6))
    t, y, _ = runs["linear"]
    for signal, label in (("T_PD", "PD"), ("T_B", "damping"), ("T_M", "sum")):
        axes[0].plot(t[t < 0.12], y[signal][t < 0.12], label=label, lw=1.2)
    axes[0].set(xlabel="time [s]", ylabel="torque, linear damping [N m]  (Fig. 5b)")
    axes[0].legend()
    axes[0].grid(alpha=0.3)
    panel(axes[1], loads, "theta_L", "load-side angle [mrad]  (Fig. 6)", (0.0, 0.30), 1e3)
    panel(axes[2], loads, "T_s", "joint torque [N m]  (Fig. 7)", (0.0, 0.30))
    axes[2].legend(loc="upper right")
    save(figure, directory / "yamada_disturbance.png", plt)

    figure, axes = plt.subplots(1, 2, figsize=(10, 4))
    for ax, portrait, title in zip(axes, portraits, ("start in the gap", "start in contact"), strict=True):
        for curve in portrait.curves:
            ax.plot(curve[:, 0], curve[:, 1], lw=1.0)
            ax.plot(*curve[0], "ko", ms=4)
        ax.set(xlabel="omega_B [rad/s]", ylabel="omega_L [rad/s]", title=f"Fig. 8: {title}")
        ax.grid(alpha=0.3)
    save(figure, directory / "yamada_phase.png", plt)


def save(figure, path, plt):
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)
    print(f"wrote {path}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="coarser samples and a shorter limit cycle")
    parser.add_argument("--save", metavar="DIR", help="write the figures there")
    options = parser.parse_args()
    step = 2e-5 if options.quick else 1e-5

    gains, plant = pd_gains(), TwoInertia()
    runs = {kind: simulate(kind, 0.40, step) for kind in KINDS}
    loads = {kind: simulate(kind, 0.30, step, load_torque=True) for kind in KINDS}
    impact = {kind: first_impact(runs[kind][1]["T_s"]) for kind in KINDS}
    overshoot = {kind: 1e3 * (runs[kind][1]["theta_L"].max() - 0.30) for kind in KINDS}
    motor_only = pd_gains(viscous=plant.D_M)
    other = {kind: first_impact(simulate(kind, 0.05, step, motor_only)[1]["T_s"])
             for kind in ("none", "linear")}
    size, period = limit_cycle(4.0 if options.quick else 6.0)

    system = closed_loop("switched")
    signs = [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)]  # (omega_B, omega_L)
    t = np.arange(0.0, 2.0, 2e-4)
    portraits = []
    for twist in (0.0, 0.010):
        starts = np.zeros((4, len(system.states)))
        starts[:, 1], starts[:, 0], starts[:, 3] = *np.transpose(signs), twist
        portraits.append(phase_portrait(system, ("omega_B", "omega_L"), starts, t))
    print(f"closed loop with switched damping: {len(system.cells)} cells")
    for kind in KINDS:
        peak = 1e3 * np.abs(loads[kind][1]["theta_L"]).max()
        print(f"{kind:9s} first impact {impact[kind]:.4f} N m, overshoot {overshoot[kind]:6.2f} mrad, "
              f"largest angle under load torque {peak:6.2f} mrad, "
              f"{len(runs[kind][2].crossings)} crossings")
    last = max(np.abs(path.states[-1, 2]) for portrait in portraits for path in portrait.trajectories)
    print(f"the eight free motions of Fig. 8: largest load angle after 2 s {1e3 * last:.3f} mrad")
    if options.save:
        directory = Path(options.save)
        directory.mkdir(parents=True, exist_ok=True)
        figures(runs, loads, portraits, directory)
    result = {
        "K_P": gains.K_P,
        "K_D": gains.K_D,
        "tau_D_ms": 1e3 * gains.tau_D,
        "reduction_percent": 100 * (1 - impact["linear"] / impact["none"]),
        "reduction_motor_damping_percent": 100 * (1 - other["linear"] / other["none"]),
        **{f"overshoot_{kind}_mrad": float(overshoot[kind]) for kind in KINDS},
        "limit_cycle_mrad": size,
        "limit_cycle_ms": period,
    }
    print("RESULT " + json.dumps(result))


if __name__ == "__main__":
    main()
