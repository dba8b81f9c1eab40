"""Pictures of the report; every figure comes from pwaid.mismatch.lawcurve import law_over
from pwaid.plotting."""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.lawcurve import law_over
from pwaid.plotting import figure_to_png, new_figure

__all__ = ["overview", "pictures", "unknown_law"]


def pictures(report) -> list[tuple[str, bytes]]:
    """Title and PNG of every picture of the page."""
    found = [("Held-out recording against simulation, before and after", figure_to_png(overview(report)))]
    if report.location.samples is not None:
        found.append(("Unknown input over the responsible variable", figure_to_png(unknown_law(report))))
    return found


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


def unknown_law(report):
    """The unknown input over the responsible variable: samples, learned map with its bends, fitted law if named."""
    where, shape = report.location, report.location.shape
    fig, ax = new_figure(1, 1, (7.0, 4.6))
    order = np.argsort(where.unknown.deviation)[: int(0.9 * len(where.samples))]
    ax.plot(where.samples[order], shape.partial[order], ".", ms=2, color="0.7",
            label="unknown input (smoothed; jumps are smeared)")
    knots, values = shape.curve.knots, shape.curve.values
    ax.plot(knots, values, color="tab:blue", lw=1.6, label="learned map")
    for b in shape.bends:
        ax.axvline(b.position, color="tab:blue", ls="--" if b.jump else ":", lw=1)
        ax.axvspan(b.low, b.high, color="tab:blue", alpha=0.15)
    ax.plot([b.position for b in shape.bends], [shape.curve(b.position) for b in shape.bends], "o", ms=5,
            color="tab:blue", label="hinges with 5 to 95 % bands; dashed: a jump")
    z = np.linspace(knots[0], knots[-1], 801)
    law = law_over(report.problem, report.best, shape.variable, z) if report.decision.members else None
    if law is not None:
        ax.plot(z, law - np.polyval(np.polyfit(z, law - shape.curve(z), 1), z), color="tab:red", lw=1.4,
                label=f"fitted {report.effects[0]['id']}, less a line: linear parts belong to parameters")
    ax.set_xlabel(shape.variable)
    ax.set_ylabel(f"unknown input at {where.channel}")
    ax.legend(fontsize=8)
    return fig
