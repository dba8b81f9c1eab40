"""To and from python-control's nonlinear systems."""

from __future__ import annotations

from itertools import product

import control
import numpy as np

from pwaid.dynamics.cell import Cell
from pwaid.dynamics.pwa_borders import has_interior, interior_point
from pwaid.dynamics.pwa_system import PWASystem
from pwaid.errors import InputError

__all__ = ["cells_of_hyperplanes", "from_nlsys", "to_nlsys"]


def to_nlsys(system: PWASystem, name: str | None = None) -> control.NonlinearIOSystem:
    """The system as a `control.NonlinearIOSystem` with the same signal names; on borders the first cell
    counts.
    """

    def update(t, x, u, params):
        return system.velocity(x, np.atleast_1d(u))

    def output(t, x, u, params):
        return system.output(x, np.atleast_1d(u))

    return control.nlsys(update, output, inputs=list(system.inputs), outputs=list(system.outputs),
                         states=list(system.states), name=name or system.name.replace(" ", "_"))  # fmt: skip


def cells_of_hyperplanes(normals, offsets) -> list[tuple[np.ndarray, np.ndarray]]:
    """The cells (G, g) into which the hyperplanes normals·x + offsets = 0 cut the space; those with an
    interior.
    """
    G, g = np.atleast_2d(np.asarray(normals, dtype=float)), np.atleast_1d(np.asarray(offsets, dtype=float))
    if g.shape != (len(G),):
        raise InputError(f"{len(G)} normals and offsets of shape {g.shape}; expected one offset per normal")
    cells = []
    for signs in product((1.0, -1.0), repeat=len(G)):
        s = np.array(signs)
        candidate = (s[:, None] * G, s * g)
        if has_interior(Cell(A=np.zeros((G.shape[1],) * 2), G=candidate[0], g=candidate[1])):
            cells.append(candidate)
    return cells


def from_nlsys(system: control.NonlinearIOSystem, cells, tol: float = 1e-8, rng=None) -> PWASystem:
    """Read the affine pieces of a python-control system that is affine in every one of the given cells.

    Parameters
    ----------
    system : control.NonlinearIOSystem
        Continuous-time.
    cells : sequence of (G, g)
        Guards G x + g ≥ 0 of each cell; `cells_of_hyperplanes` makes them from borders.
    tol : float
        Largest deviation from affine that is accepted, relative to the velocities and outputs found.
    rng : numpy.random.Generator, optional
        For the test points.

    Returns
    -------
    PWASystem

    Raises
    ------
    InputError
        A cell without interior, or a right-hand side that is not affine there; says where and by how much.
    """
    if not system.isctime():
        raise InputError(f"system {system.name!r} is sampled with dt = {system.dt}; expected a "
                         "continuous-time system")
    rng = np.random.default_rng(0) if rng is None else rng
    n, m = system.nstates, system.ninputs

    def evaluate(x, u):
        return np.concatenate([np.atleast_1d(system.dynamics(0.0, x, u)),
                               np.atleast_1d(system.output(0.0, x, u))])

    found = []
    for k, (G, g) in enumerate(cells):
        G, g = np.asarray(G, dtype=float).reshape(-1, n), np.asarray(g, dtype=float)
        lengths = np.linalg.norm(G, axis=1)
        centre, depth = interior_point(G / lengths[:, None], g / lengths)
        if centre is None or depth <= 0:
            raise InputError(f"cell {k} has no interior; check the signs of its guards G x + g >= 0")
        radius = 0.5 * min(depth, 1.0)
        base = evaluate(centre, np.zeros(m))
        by_x = np.array([(evaluate(centre + radius * e, np.zeros(m)) - base) / radius for e in np.eye(n)]).T
        by_u = np.array([evaluate(centre, e) - base for e in np.eye(m)]).reshape(m, base.size).T
        for _ in range(8):
            dx = rng.standard_normal(n)
            dx *= radius / max(np.linalg.norm(dx), 1e-300)
            u = rng.standard_normal(m)
            error = np.abs(evaluate(centre + dx, u) - (base + by_x @ dx + by_u @ u)).max()
            if error > tol * max(1.0, np.abs(base).max(), np.abs(by_x).max() * radius):
                raise InputError(
                    f"cell {k}: the system is not affine, off by {error:.3g} at x = {centre + dx}, u = {u}; "
                    "cut the cell where the law changes, or approximate the law by a PWA map first"
                )
        constant = base - by_x @ centre
        found.append(Cell(A=by_x[:n], a=constant[:n], B=by_u[:n], G=G, g=g, C=by_x[n:], c=constant[n:],
                          D=by_u[n:]))
    return PWASystem(tuple(found), system.state_labels, system.input_labels, system.output_labels,
                     system.name)
