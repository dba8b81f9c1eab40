"""Pictures of the report; every figure comes from pwaid.plotting."""

from __future__ import annotations

import numpy as np

from pwaid.plotting import figure_to_png, new_figure

__all__ = ["overview", "pictures"]


def pictures(report) -> list[tuple[str, bytes]]:
    """Title and PNG of every picture of the page."""
    return [("Held-out recording against simulation, before and after", figure_to_png(overview(report)))]


def overview(report):
    """Recording, simulations and residuals of the first held-out recording."""
    p = report.problem
    a, b = p.test.recordings[0]
    t = np.arange(b - a) * p.test.sample_time
    ny = p.test.Y.shape[1]
    fig, axes = new_figure(2, ny, (6.0 * ny, 5.0))
    axes = np.asarray(axes).reshape(2, ny)
    stages = [("nominal", p.nominal_test.Y, "0.7"), ("refitted", report.null.test.Y, "tab:orange"),
              ("repaired", report.best.test.Y, "tab:blue")]
    for k, name in enumerate(p.plant.output_names):
        axes[0, k].plot(t, p.test.Y[a:b, k], color="black", lw=1.4, label="recorded")
        for label, Y, color in stages:
            axes[0, k].plot(t, Y[a:b, k], color=color, lw=0.9, label=label)
            axes[1, k].plot(t, p.test.Y[a:b, k] - Y[a:b, k], color=color, lw=0.8, label=label)
        axes[0, k].set_ylabel(name)
        axes[1, k].set_ylabel(f"residual of {name}")
        axes[1, k].set_xlabel("time / s")
        axes[0, k].legend(fontsize=8, loc="upper right")
    return fig
