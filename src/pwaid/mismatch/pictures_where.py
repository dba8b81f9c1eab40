"""Where the mismatch sits: share of the squared error over time, residual spectrum, before and after the repair."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.signal import welch

from pwaid.plotting import new_figure

__all__ = ["AFTER", "BEFORE", "axis_label", "error_shares", "mismatch_over_time_and_frequency", "shown_recording"]

BEFORE, AFTER = "tab:orange", "tab:blue"
PIECES = 40


def axis_label(report, side: str, name: str) -> str:
    """Name and unit of an input or output."""
    unit = report.content["units"][side].get(name, "")
    return f"{name} [{unit}]" if unit else name


def shown_recording(report) -> int:
    """The held-out recording with the largest error after refitting the parameters."""
    p = report.problem
    e = np.sum(((p.test.Y - report.null.test.Y) / p.sigma) ** 2, axis=1)
    return int(np.argmax([np.mean(e[a:b]) for a, b in p.test.recordings]))


def error_shares(before, after, pieces: int = PIECES):
    """Edges (n + 1,) in samples, and the squared residuals (N,) per piece, both as shares of the sum before."""
    edges = np.linspace(0, len(before), min(pieces, len(before)) + 1).astype(int)
    total = max(float(np.sum(before**2)), 1e-300)
    rows = [[float(np.sum(r[i:j] ** 2)) / total for i, j in itertools.pairwise(edges)] for r in (before, after)]
    return edges, np.array(rows)


def mismatch_over_time_and_frequency(report):
    """One row per output: share of the squared error per stretch of time, and the residual's spectrum."""
    p, h = report.problem, report.problem.test.sample_time
    a, b = p.test.recordings[shown_recording(report)]
    ny = p.test.Y.shape[1]
    fig, axes = new_figure(ny, 2, (11.0, 3.1 * ny + 0.3), squeeze=False)
    for k, name in enumerate(p.plant.output_names):
        before, after = (p.test.Y[a:b, k] - Y[a:b, k] for Y in (report.null.test.Y, report.best.test.Y))
        edges, shares = error_shares(before, after)
        left, right = axes[k]
        width = np.diff(edges) * h
        left.bar(edges[:-1] * h, 100 * shares[0], width, align="edge", color=BEFORE, alpha=0.45, edgecolor=BEFORE,
                 label="parameters refitted: 100 %")
        left.bar(edges[:-1] * h, 100 * shares[1], 0.5 * width, align="edge", color=AFTER,
                 label=f"repaired: {100 * shares[1].sum():.3g} %")
        left.set_ylabel(f"squared error of {name} [%]")
        n = int(min(len(before), max(64, len(before) // 6)))
        for r, color, style, label in ((before, BEFORE, "--", "parameters refitted"), (after, AFTER, "-", "repaired")):
            f, power = welch(r, 1 / h, nperseg=n, detrend="constant")
            right.loglog(f[1:], np.sqrt(power[1:]), color=color, ls=style, lw=1.2, label=label)
        floor = p.floor.level[k] * np.sqrt(2 * h)
        right.axhline(floor, color="0.3", ls=":", lw=1.2, label="noise floor, if white")
        low, high = right.get_ylim()
        right.set_ylim(max(low, 0.02 * floor) if floor > 0 else low, high)
        unit = report.content["units"]["outputs"].get(name) or "1"
        right.set_ylabel(f"residual density [{unit}/√Hz]")
        for ax in (left, right):
            ax.legend(fontsize=8, loc="upper right" if ax is left else "best")
            ax.grid(alpha=0.25)
    axes[-1, 0].set_xlabel("time [s]")
    axes[-1, 1].set_xlabel("frequency [Hz]")
    return fig
