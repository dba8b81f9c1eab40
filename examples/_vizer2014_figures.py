"""Figures 3-10 of paper 002, and the concealed Coriolis torque; used by vizer2014_flexible_arm.py."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from pwaid.hinfstruct import align_models, balance, bft, c2d, frequency_response, simulate_discrete
from pwaid.hinfstruct.statespace import as_matrices
from pwaid.systems.vizer2014 import (
    OPERATING_POINTS,
    vizer2014_flexible_arm_linear,
    vizer2014_flexible_arm_lpv,
)

KAPPAS = np.cos(OPERATING_POINTS)
TRUTH = vizer2014_flexible_arm_lpv()
DT = 1e-3


def save(fig, directory: Path, name: str) -> None:
    fig.tight_layout()
    fig.savefig(directory / f"{name}.png", dpi=75)
    plt.close(fig)


def figure_3(directory, validations, black_boxes):
    point = 4
    run = validations[point]
    fig, axes = plt.subplots(2, 1, figsize=(8, 5), sharex=True)
    window = slice(1000, 1150)
    for k, ax in enumerate(axes):
        ax.plot(run.time[window], run.outputs[window, k], "k", lw=1.5, label="nonlinear arm")
        for method, style in (("zoh", "C0--"), ("tustin", "C3:")):
            y = simulate_discrete(as_matrices(c2d(black_boxes[method][point], DT)), run.inputs)
            score = bft(run.outputs[:, k], y[:, k])
            ax.plot(run.time[window], y[window, k], style, label=f"local model, {method}: BFT {score:.1f} %")
        ax.set_ylabel(f"y{k + 1} (rad/s)")
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.25 * (high - low))
        ax.legend(loc="upper center", fontsize=7, ncol=3)
    axes[0].set_title("Figure 3: local model at theta2 = 5 pi/8, validation data")
    axes[-1].set_xlabel("time (s)")
    save(fig, directory, "hinf_figure3")


def rigid(theta2: float, omega: np.ndarray) -> np.ndarray:
    """Responses of the same arm without flexibility: M_rr ddtheta = Lambda (reference - dtheta)."""
    M = (TRUTH.M0 + np.cos(theta2) * TRUTH.M1)[:2, :2]
    gains = np.diag(TRUTH.gains)
    return np.linalg.solve(1j * omega[:, None, None] * M + gains, np.broadcast_to(gains, (omega.size, 2, 2)))


def figure_4(directory, black_boxes):
    omega = np.geomspace(5, np.pi / DT, 400)
    theta2 = OPERATING_POINTS[0]
    curves = {
        "analytic": (frequency_response(as_matrices(vizer2014_flexible_arm_linear(theta2)), omega), "k-"),
        "rigid": (rigid(theta2, omega), "0.6"),
        "estimated, ZOH": (frequency_response(as_matrices(black_boxes["zoh"][0]), omega), "C0--"),
        "estimated, Tustin": (frequency_response(as_matrices(black_boxes["tustin"][0]), omega), "C3:"),
    }
    fig, axes = plt.subplots(2, 2, figsize=(9, 6), sharex=True)
    for i in range(2):
        for j in range(2):
            for name, (response, style) in curves.items():
                axes[i, j].semilogx(omega, 20 * np.log10(np.abs(response[:, i, j])), style, label=name)
            axes[i, j].set_title(f"y{i + 1} from u{j + 1}", fontsize=9)
            axes[i, j].set_ylim(-60, 15)
    for ax in axes[1]:
        ax.set_xlabel("frequency (rad/s)")
    for ax in axes[:, 0]:
        ax.set_ylabel("magnitude (dB)")
    axes[0, 0].legend(fontsize=7, loc="lower left")
    fig.suptitle("Figure 4: magnitudes at theta2 = pi/8", fontsize=10)
    save(fig, directory, "hinf_figure4")


def figure_5(directory, zoh, tustin):
    fig, axes = plt.subplots(4, 4, figsize=(11, 8), sharex=True)
    for k, ax in enumerate(axes.T.ravel()):
        sign = -1 if k >= 8 else 1
        ax.plot(
            KAPPAS, sign * np.array([r.theta[k] for r in tustin]), "C3x:", ms=4, label="restructured, Tustin"
        )
        ax.plot(
            KAPPAS, sign * np.array([TRUTH.theta(x)[k]
            for x in KAPPAS]), "ks-", ms=6, mfc="none", label="analytic"
        )
        ax.plot(KAPPAS, sign * np.array([r.theta[k] for r in zoh]), "C0o--", ms=3, label="restructured, ZOH")
        ax.set_title(f"{'-' if sign < 0 else ''}theta{k + 1}", fontsize=8)
        seen = sign * np.array([r.theta[k] for r in [*tustin[1:], *zoh]])
        margin = 0.15 * np.ptp(seen)
        ax.set_ylim(seen.min() - margin, seen.max() + margin)  # the Tustin point at pi/8 may lie outside
        ax.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3))
        ax.tick_params(labelsize=7)
    axes[0, 0].legend(fontsize=6)
    for ax in axes[-1]:
        ax.set_xlabel("cos(theta2)", fontsize=8)
    fig.suptitle("Figure 5: parameters along the scheduling variable", fontsize=10)
    save(fig, directory, "hinf_figure5")


def figure_6(directory, black_boxes):
    aligned = [as_matrices(m) for m in align_models([balance(b).system for b in black_boxes["zoh"]])]
    fig, axes = plt.subplots(2, 2, figsize=(9, 6), sharex=True)
    for ax, name, k in zip(axes.ravel(), "ABCD", range(4), strict=True):
        ax.plot(KAPPAS, np.array([m[k].ravel() for m in aligned]), ".-", ms=4, lw=0.8)
        ax.set_title(f"entries of {name}", fontsize=9)
    for ax in axes[1]:
        ax.set_xlabel("cos(theta2)")
    fig.suptitle("Figure 6: coefficients of the balanced local models", fontsize=10)
    save(fig, directory, "hinf_figure6")


def figure_7(directory, sweeps):
    fig, ax = plt.subplots(figsize=(7, 3))
    for sweep, style in zip(sweeps, ("k-", "C0--", "C1:"), strict=True):
        ax.plot(sweep.time, sweep.theta2 / np.pi * 8, style, label=f"{sweep.time[-1]:.1f} s sweep")
    ax.set_xlabel("time (s)")
    ax.set_ylabel("theta2 (pi/8 rad)")
    ax.legend(fontsize=8)
    ax.set_title("Figure 7: theta2 during LPV validation", fontsize=10)
    save(fig, directory, "hinf_figure7")


def figures_8_to_10(directory, sweep, outputs):
    titles = {8: ("struc. ZOH", "restructured"), 9: ("anal.", "analytic"), 10: ("bal. ZOH", "balanced")}
    window = slice(12000, 18000, 10)
    for number, (key, title) in titles.items():
        fig, axes = plt.subplots(2, 1, figsize=(8, 5), sharex=True)
        for k, ax in enumerate(axes):
            y = outputs[key][window, k]
            ax.plot(sweep.time[window], sweep.outputs[window, k], "k", lw=1.2, label="nonlinear arm")
            ax.plot(sweep.time[window], y, "C0--", lw=1,
                    label=f"LPV model, BFT {bft(sweep.outputs[:, k], outputs[key][:, k]):.1f} %")
            size = np.ptp(sweep.outputs[window, k])
            centre = sweep.outputs[window, k].mean()
            ax.set_ylim(centre - 1.2 * size, centre + 1.2 * size)
            ax.set_ylabel(f"y{k + 1} (rad/s)")
            ax.legend(fontsize=7, loc="upper right")
        axes[-1].set_xlabel("time (s)")
        axes[0].set_title(f"Figure {number}: LPV model from the {title} local models, d = 2", fontsize=10)
        save(fig, directory, f"hinf_figure{number}")


def figure_coriolis(directory, sweep, physics):
    fig, axes = plt.subplots(2, 1, figsize=(8, 5), sharex=True)
    show = slice(None, None, 20)
    for flag, style, name in ((False, "C3", "frozen"), (True, "C0--", "with the Coriolis torque of M1")):
        y = physics.model.simulate(sweep.time, sweep.inputs, sweep.theta2, coriolis=flag)
        axes[0].plot(
            sweep.time[show], y[show, 0], style, lw=1, label=f"{name}: BFT {bft(sweep.outputs, y)[0]:.1f} %"
        )
        axes[1].plot(sweep.time[show], (sweep.outputs - y)[show, 0], style, lw=1, label=name)
    axes[0].plot(sweep.time[show], sweep.outputs[show, 0], "k:", lw=1.5, label="nonlinear arm")
    axes[0].set_ylabel("y1 (rad/s)")
    axes[1].set_ylabel("error of y1 (rad/s)")
    axes[1].set_xlabel("time (s)")
    for ax in axes:
        ax.legend(fontsize=7)
    axes[0].set_title("What the local experiments conceal: 1.5 s sweep, PRBS 0.1 rad/s", fontsize=10)
    save(fig, directory, "hinf_coriolis")


def draw(directory: Path, validations, black_boxes, zoh, tustin, sweeps, lpv_outputs, physics) -> None:
    """Write hinf_figure3.png ... hinf_figure10.png and hinf_coriolis.png into ``directory``."""
    directory.mkdir(parents=True, exist_ok=True)
    figure_3(directory, validations, black_boxes)
    figure_4(directory, black_boxes)
    figure_5(directory, zoh, tustin)
    figure_6(directory, black_boxes)
    figure_7(directory, sweeps)
    figures_8_to_10(directory, sweeps[0], lpv_outputs)
    figure_coriolis(directory, sweeps[2], physics)
