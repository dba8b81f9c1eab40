"""Gap against time, one line a solver."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["gap_against_time"]

MARKERS = {"engine": "o", "Clarabel": "s", "PIQP": "^", "ADMM": "d", "OSQP": "v"}


def gap_against_time(curves: dict[str, list[tuple[float, float]]], path: Path) -> None:
    """Draw judged gaps over CPU seconds, both logarithmic, and save the picture."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for name, points in curves.items():
        points = sorted(points)
        x, y = [t for t, _ in points], [max(g, 1e-12) for _, g in points]
        axes.loglog(x, y, marker=MARKERS.get(name, "x"), linewidth=2.5 if name == "engine" else 1.2, label=name)
    axes.set_xlabel("CPU time, s (one thread)")
    axes.set_ylabel("certified relative gap")
    axes.set_title("Pyramid, λ = 0.01 λmax: time to a gap")
    axes.grid(True, which="major", alpha=0.4)
    axes.legend()
    figure.savefig(path, dpi=90)
    plt.close(figure)
