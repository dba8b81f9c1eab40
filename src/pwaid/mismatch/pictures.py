"""Pictures of the report: recording against simulation, and the unknown input over the responsible variable.

The others are in `pwaid.mismatch.pictures_where` and `pwaid.mismatch.pictures_choice`; `pictures` gathers them.
"""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.lawcurve import law_over
from pwaid.mismatch.pictures_choice import candidate_bars, experiment_picture, isolability_matrix
from pwaid.mismatch.pictures_where import AFTER, BEFORE, axis_label, mismatch_over_time_and_frequency, shown_recording
from pwaid.mismatch.units import combine
from pwaid.plotting import figure_to_png, new_figure, plot_map

__all__ = ["overview", "pair_map", "pictures", "unknown_law"]

SWINGS = 30  # crossings of the mean that can still be told apart in one panel


def pictures(report) -> list[tuple[str, str, bytes]]:
    """Title, caption and PNG of every picture of the page."""
    return [(title, caption, figure_to_png(figure)) for title, caption, figure in _figures(report)]


def _figures(report):
    """Title, caption and figure, in the order of the page."""
    name = report.problem.test.names[shown_recording(report)]
    yield ("Recording against simulation, before and after",
           f"Held-out recording {name}. Left: outputs, the stretch with the largest error when the whole is too dense "
           "to read. Right: recorded minus simulated, with the noise floor.", overview(report))
    if report.location.samples is not None:
        yield ("What is missing, over the responsible variable",
               "The input that would have to push on the refitted simulator, over the variable it goes with; hinges "
               "where the learned map bends.", unknown_law(report))
    if report.location.pair is not None:
        yield ("What is missing, over two variables",
               "The learned map of the unknown input over the pair that carries it, less linear parts of the others; "
               "lines: hinges.", pair_map(report))
    yield ("The mismatch over time and frequency",
           f"Held-out recording {name}. Left: share of the squared error before the repair, per stretch of time. "
           "Right: spectrum of the residual and of the noise floor.", mismatch_over_time_and_frequency(report))
    if report.content["candidates"]:
        yield ("Candidates",
               "Share of the explainable held-out error that each fitted candidate removes. Passing also asks that "
               "every recording improves and that the parameters are physical.", candidate_bars(report))
    if report.isolability is not None and len(report.isolability.hypotheses) > 1:
        limit = report.content["isolability"]["cannot_tell_apart_below"]
        yield ("Which candidates these recordings tell apart",
               "Error of the column's law refitted to what the row's law simulates, in units of the noise. Below "
               f"{limit:g} in both directions: cannot be told apart.", isolability_matrix(report))
    if report.experiment is not None:
        yield "Next experiment", report.experiment.proposal.words, experiment_picture(report)


def _window(y, error) -> slice:
    """The stretch that holds at most SWINGS swings of y (N, ny) and most of the error (N,)."""
    centred = y - y.mean(axis=0)
    far = [column[np.abs(column) > 0.3 * np.std(column)] for column in centred.T]  # noise near the mean is no swing
    swings = max(int(np.sum(np.diff(np.signbit(column)))) for column in far)
    n = len(y)
    if swings <= 2 * SWINGS:
        return slice(0, n)
    width = max(50, n * SWINGS // swings)
    running = np.cumsum(np.concatenate([[0.0], error]))
    first = int(np.argmax(running[width:] - running[:-width]))
    return slice(first, first + width)


def overview(report):
    """Recording, simulations and residuals of one held-out recording, one row per output."""
    p = report.problem
    a, b = p.test.recordings[shown_recording(report)]
    t = np.arange(b - a) * p.test.sample_time
    y, ny = p.test.Y[a:b], p.test.Y.shape[1]
    stages = [("nominal", p.nominal_test.Y[a:b], "0.6", ":"),
              ("parameters refitted", report.null.test.Y[a:b], BEFORE, "--"),
              ("repaired", report.best.test.Y[a:b], AFTER, "-")]
    stages = stages if report.best is not report.null else stages[:2]
    fig, axes = new_figure(ny, 2, (11.0, 3.3 * ny + 0.4), squeeze=False)
    window = _window(y, np.sum(((y - stages[1][1]) / p.sigma) ** 2, axis=1))
    for k in range(ny):
        left, right = axes[k]
        left.plot(t[window], y[window, k], color="black", lw=2.2, alpha=0.55, label="recorded")
        for label, Y, color, style in stages:
            left.plot(t[window], Y[window, k], color=color, ls=style, lw=1.1, label=label)
        for label, Y, color, _ in stages[1:]:
            rmse = np.sqrt(np.mean((y[:, k] - Y[:, k]) ** 2))
            right.plot(t, y[:, k] - Y[:, k], color=color, lw=0.8, label=f"{label}: {rmse:.3g} RMS")
        right.axhspan(-p.floor.level[k], p.floor.level[k], color="0.8", zorder=0,
                      label=f"noise floor: {p.floor.level[k]:.3g}")
        low, high = np.min(y[window, k]), np.max(y[window, k])
        left.set_ylim(low - 0.25 * (high - low), high + 0.5 * (high - low))
        low, high = right.get_ylim()
        right.set_ylim(low, high + 0.4 * (high - low))
        left.set_ylabel(axis_label(report, "outputs", p.plant.output_names[k]))
        right.set_ylabel(f"residual of {p.plant.output_names[k]}")
        right.legend(fontsize=8, loc="upper right")
        for ax in (left, right):
            ax.margins(x=0.01)
            ax.grid(alpha=0.25)
    axes[0, 0].legend(fontsize=8, loc="upper right", ncols=2)
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    return fig


def unknown_law(report):
    """The unknown input over the responsible variable: samples, learned map with its bends, fitted law if named."""
    where, shape = report.location, report.location.shape
    fig, ax = new_figure(1, 1, (7.0, 4.6))
    order = np.argsort(where.unknown.deviation)[: int(0.9 * len(where.samples))]
    ax.plot(where.samples[order], shape.partial[order], ".", ms=2, color="0.7",
            label="unknown input (smoothed; jumps are smeared)")
    knots, values = shape.curve.knots, shape.curve.values
    ax.plot(knots, values, color=AFTER, lw=1.6, label="learned map")
    for b in shape.bends:
        ax.axvline(b.position, color=AFTER, ls="--" if b.jump else ":", lw=1)
        ax.axvspan(b.low, b.high, color=AFTER, alpha=0.15)
    ax.plot([b.position for b in shape.bends], [shape.curve(b.position) for b in shape.bends], "o", ms=5,
            color=AFTER, label="hinges with 5 to 95 % bands; dashed: a jump")
    z = np.linspace(knots[0], knots[-1], 801)
    law = law_over(report.problem, report.best, shape.variable, z) if report.decision.members else None
    if law is not None:
        seen = where.samples[order]  # a line is free where the samples are
        line = np.polyfit(seen, np.interp(seen, z, law) - shape.partial[order], 1)
        ax.plot(z, law - np.polyval(line, z), color="tab:red", lw=1.4,
                label=f"fitted {report.effects[0]['id']}, less a line: linear parts belong to parameters")
    ax.set_xlabel(shape.variable)
    ax.set_ylabel(f"unknown input at {where.channel}{_unit(report, where.channel)}")
    ax.grid(alpha=0.25)
    ax.legend(fontsize=8)
    return fig


def pair_map(report):
    """The map over two variables with its hinges."""
    where = report.location
    fig, ax = new_figure(1, 1, (7.0, 4.8))
    a, b = where.pair.variables
    unit = f"unknown input at {where.channel}{_unit(report, where.channel)}"
    plot_map(where.pair.map, ax, labels=(a, b))
    ax.set_title(f"{unit}; held-out gain {100 * where.pair.gain:.0f} %", fontsize=9)
    return fig


def _unit(report, channel: str) -> str:
    """The unit of an unknown input in brackets: a force at a speed, the input's own at an input."""
    kind, _, signal = channel.partition(":")
    plant, s = report.problem.plant, report.problem.structure
    if kind == "input":
        unit = report.content["units"]["inputs"][signal]
    else:
        unit = combine({}, (dict(s.force_units.get(plant.state_names.index(signal), {})), 1))
    return f" [{unit}]" if unit not in ("", "1") else ""
