"""Why this answer: candidates with their scores, the isolability matrix, the next experiment."""

from __future__ import annotations

import textwrap

import numpy as np

from pwaid.mismatch.pictures_where import AFTER, BEFORE, axis_label
from pwaid.plotting import new_figure

__all__ = ["candidate_bars", "experiment_picture", "isolability_matrix"]

BARS = 12


def _readable(label: str, width: int = 34) -> str:
    return "\n".join(textwrap.wrap(label.replace("_", " ").replace(":", " "), width))


def candidate_bars(report):
    """Share of the explainable held-out error per candidate, best first, with the threshold and who passed."""
    c = report.content
    rows = [r for r in c["candidates"] if r["share_explained"] is not None][:BARS][::-1]
    fig, ax = new_figure(1, 1, (9.5, 0.8 + 0.42 * len(rows)))
    shares = np.array([100 * r["share_explained"] for r in rows])
    at = np.arange(len(rows))
    passed = [r["passed"] for r in rows]
    ax.barh(at, np.clip(shares, -8, None), color=[AFTER if ok else "0.75" for ok in passed], height=0.7,
            hatch=["" if ok else "//" for ok in passed], edgecolor="white")
    for k, (s, ok) in enumerate(zip(shares, passed, strict=True)):
        ax.text(max(s, 0) + 1, k, f"{s:.3g} %, {'passed' if ok else 'not passed'}", va="center", fontsize=8,
                bbox={"color": "white", "pad": 0.5}, zorder=4)
    ax.axvline(100 * c["share_needed"], color="black", ls="--", lw=1)
    ax.text(100 * c["share_needed"], len(rows) - 0.45, f"needed: {100 * c['share_needed']:.0f} %", fontsize=8,
            ha="center", va="bottom", bbox={"color": "white", "pad": 1})
    ax.set_yticks(at, [_readable(r["where"], 60) for r in rows], fontsize=8)
    ax.set_xlim(-10, max(130.0, float(np.max(shares, initial=0)) + 30))
    ax.set_ylim(-0.6, len(rows))
    ax.set_xlabel("share of the explainable held-out error removed [%]")
    return fig


def isolability_matrix(report):
    """Numbers in a grid: row, the law that simulates; column, the law refitted to it."""
    told = report.isolability
    n = len(told.hypotheses)
    alike = report.content["isolability"]["cannot_tell_apart_below"]
    fig, ax = new_figure(1, 1, (3.6 + 1.15 * n, 1.9 + 0.62 * n))
    ax.imshow(np.log10(np.clip(told.matrix, 1.0, 100.0)), cmap="Blues", vmin=0.0, vmax=2.6, aspect="auto")
    for i in range(n):
        for j in range(n):
            value = told.matrix[i, j]
            text = "–" if i == j else f"{value:.2f}" if value < 10 else f"{value:.0f}"
            weight = "bold" if i != j and value < alike else "normal"
            ax.text(j, i, text, ha="center", va="center", fontsize=9, weight=weight,
                    color="white" if value > 40 else "black")
    ax.set_xticks(range(n), [_readable(label, 20) for label in told.labels], fontsize=7, rotation=30, ha="right")
    ax.set_yticks(range(n), [_readable(label, 34) for label in told.labels], fontsize=8)
    ax.set_xlabel(f"refitted law (bold: below {alike:g} times the noise)")
    ax.set_ylabel("law that simulates")
    return fig


def experiment_picture(report):
    """The proposed input, and what the two hypotheses predict under it."""
    plan, p = report.experiment, report.problem
    j = p.plant.input_names.index(plan.proposal.signal)
    ny = plan.first.shape[1]
    fig, axes = new_figure(1 + ny, 1, (9.5, 1.9 + 2.4 * ny), sharex=True, height_ratios=[1.0] + [1.6] * ny)
    axes[0].step(plan.time, plan.proposal.U[:, j], where="post", color="black", lw=1.0)
    axes[0].set_ylabel(axis_label(report, "inputs", plan.proposal.signal))
    for k in range(ny):
        ax = axes[1 + k]
        d = plan.first[:, k] - plan.second[:, k]
        times = np.sqrt(np.mean(d**2)) / max(p.floor.level[k], 1e-300)
        ax.plot(plan.time, plan.first[:, k], color=AFTER, lw=1.4, label=_readable(plan.pair[0].label, 60))
        ax.plot(plan.time, plan.second[:, k], color=BEFORE, lw=1.4, ls="--",
                label=_readable(f"{plan.pair[1].label}, refitted", 60))
        ax.fill_between(plan.time, plan.first[:, k], plan.second[:, k], color="0.7", alpha=0.5, lw=0,
                        label=f"difference: {np.sqrt(np.mean(d**2)):.3g} RMS, {times:.3g} times the noise")
        ax.set_ylabel(axis_label(report, "outputs", p.plant.output_names[k]))
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.45 * (high - low))
        ax.legend(fontsize=8, loc="upper right")
    for ax in axes:
        ax.grid(alpha=0.25)
        ax.margins(x=0.01)
    axes[-1].set_xlabel("time [s]")
    return fig
