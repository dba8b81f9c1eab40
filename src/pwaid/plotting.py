"""Pictures: maps, paths, simplex shadings. The only file that imports matplotlib.

Figures are made without pyplot, so nothing is registered globally and no window opens: save them, or show them in a
notebook by leaving them as the last expression of a cell.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from pwaid.errors import InputError

__all__ = [
    "figure_to_png",
    "new_figure",
    "plot_map",
    "plot_path",
    "plot_shading",
    "plot_slices",
    "plot_surface",
]


def new_figure(nrows: int = 1, ncols: int = 1, size: tuple[float, float] = (6.4, 4.8), **options: Any):
    """A figure and its axes (an array when there are several), drawn by Agg."""
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(nrows, ncols, **options)


def figure_to_png(figure: Figure, dpi: int = 110) -> bytes:
    """The figure as PNG bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def _plane(f: Any) -> Any:
    if f.mesh.dimension != 2:
        raise InputError(
            f"the map has {f.mesh.dimension} inputs; this picture is for 2: use plot_slices, or plot f(X) over a line"
        )
    return f.mesh


def broken_hinges(f: Any, threshold: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    """Segments (n, 2, 2) of the hinges where the gradient jumps, and the jumps.

    Hinges whose jump, times their length, is below `threshold` of the largest are left out.
    """
    mesh = _plane(f)
    facets = mesh.facets
    jump = np.linalg.norm(f.slopes[facets.left] - f.slopes[facets.right], axis=1)
    ends = np.array([np.delete(mesh.simplices[s], j) for s, j in zip(facets.left, facets.left_apex, strict=True)])
    segments = mesh.points[ends]
    weight = jump * np.linalg.norm(segments[:, 0] - segments[:, 1], axis=1)
    keep = weight > threshold * weight.max(initial=0.0)
    return segments[keep], jump[keep]


def plot_map(f: Any, ax: Any = None, *, labels: tuple[str, str] = ("$x_1$", "$x_2$"), unit: str = "", hinges=True):
    """A map of two inputs seen from above, with its broken hinges drawn (darker for sharper).

    Returns the axes.
    """
    mesh = _plane(f)
    if ax is None:
        _, ax = new_figure()
    drawn = ax.tripcolor(*mesh.points.T, f.values, triangles=mesh.simplices, shading="gouraud", cmap="viridis")
    ax.figure.colorbar(drawn, ax=ax, label=unit)
    if hinges:
        segments, jump = broken_hinges(f)
        if len(segments):
            strength = np.clip(jump / np.quantile(jump, 0.95), 0.08, 1.0)
            ax.add_collection(LineCollection(segments, colors=[(0, 0, 0, s) for s in strength], linewidths=0.7))
    ax.set(xlabel=labels[0], ylabel=labels[1])
    return ax


def plot_surface(f: Any, ax: Any = None, *, labels: tuple[str, str, str] = ("$x_1$", "$x_2$", "$y$")):
    """A map of two inputs as a surface in space, each simplex a flat triangle. Returns the axes."""
    mesh = _plane(f)
    if ax is None:
        _, ax = new_figure(subplot_kw={"projection": "3d"})
    ax.plot_trisurf(
        *mesh.points.T, f.values, triangles=mesh.simplices, cmap="viridis", linewidth=0, antialiased=False
    )
    ax.set(xlabel=labels[0], ylabel=labels[1], zlabel=labels[2])
    return ax


def plot_shading(f: Any, ax: Any = None, *, labels: tuple[str, str] = ("$x_1$", "$x_2$")):
    """Each simplex darker the more it adds to the complexity (2011 eq. 17 and Table I). Returns the axes."""
    mesh = _plane(f)
    if ax is None:
        _, ax = new_figure()
    error = f.extrapolation_error()
    top = np.quantile(error, 0.99) or error.max() or 1.0
    ax.add_collection(
        PolyCollection(mesh.points[mesh.simplices], array=np.clip(error / top, 0, 1), cmap="Greys", linewidths=0)
    )
    ax.autoscale_view()
    ax.set(xlabel=labels[0], ylabel=labels[1])
    return ax


def plot_path(path: Any, ax: Any = None, *, unit: str = "", noise: float | None = None):
    """Held-out RMSE and number of broken hinges over λ/λmax (2014 Fig. 4 and 8). Returns the axes."""
    if ax is None:
        _, ax = new_figure()
    ratio = path.lambdas / (path.lambda_max if np.isfinite(path.lambda_max) and path.lambda_max > 0 else 1.0)
    if path.validation_rmse is not None:
        ax.semilogx(ratio, path.validation_rmse, "o-", ms=3, label="held-out RMSE")
        ax.plot(ratio[path.best_index], path.validation_rmse[path.best_index], "r*", ms=12, label="chosen")
        ax.set_ylabel(f"held-out RMSE{f' [{unit}]' if unit else ''}")
        if noise is not None:
            ax.axhline(noise, color="k", ls=":", lw=1, label="noise")
        ax.legend(loc="upper left")
    twin = ax.twinx()
    twin.semilogx(ratio, path.n_broken, "-", color="0.6", lw=1)
    twin.set_ylabel("broken hinges", color="0.4")
    twin.set_ylim(bottom=0)
    ax.set_xlabel(r"$\lambda/\lambda^{\max}$")
    ax.set_zorder(twin.get_zorder() + 1)
    ax.patch.set_visible(False)
    return ax


def plot_slices(
    f: Any, *, axis: int = 2, levels: Any = 3, labels: tuple[str, ...] = ("$x_1$", "$x_2$", "$x_3$"), resolution=160
):
    """A map of three inputs as slices at fixed values of one of them. Returns the figure.

    Parameters
    ----------
    f : PWAMap
        With three inputs.
    axis : int
        The input held fixed.
    levels : int or sequence of float
        How many slices, or the fixed values in physical units.
    """
    if f.mesh.dimension != 3:
        raise InputError(f"the map has {f.mesh.dimension} inputs; slices are for 3")
    points = f.mesh.points
    low, high = points.min(axis=0), points.max(axis=0)
    if np.isscalar(levels):
        levels = np.quantile(points[:, axis], np.linspace(0, 1, int(levels) + 2)[1:-1])
    free = [k for k in range(3) if k != axis]
    u, v = (np.linspace(low[k], high[k], resolution) for k in free)
    U, V = np.meshgrid(u, v)
    figure, axes = new_figure(1, len(levels), (4.2 * len(levels), 3.6), squeeze=False)
    images = []
    for level in levels:
        X = np.empty((U.size, 3))
        X[:, free[0]], X[:, free[1]], X[:, axis] = U.ravel(), V.ravel(), level
        images.append(f(X, outside="nan").reshape(U.shape))
    limits = {"vmin": np.nanmin(images), "vmax": np.nanmax(images)}
    for ax, image, level in zip(axes[0], images, levels, strict=True):
        drawn = ax.pcolormesh(u, v, image, shading="auto", cmap="viridis", **limits)
        ax.contour(u, v, image, levels=12, colors="k", linewidths=0.4)
        ax.set(xlabel=labels[free[0]], ylabel=labels[free[1]], title=f"{labels[axis]} = {level:.3g}")
    figure.colorbar(drawn, ax=axes[0].tolist())
    return figure
