"""The inertia matrix that a simulator's own equations show, as a function of the one position it depends on.

A force on one coordinate accelerates all of them by a column of the inverse inertia matrix. Commands, a joint's own
damping and its own spring are such forces, each up to an unknown constant factor; the symmetry of the matrix fixes
the ratios of the factors, and must hold at every position with the same ones. Lagrange's equations then give the
torques that depend on products of speeds, without any new parameter.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from pwaid.mismatch.units import KNOWN

__all__ = ["ShownInertia", "shown_inertia"]

TOLERANCE = 1e-5  # of symmetry and of the fitted form; differences of smooth equations reach 1e-8
SINGULAR = 1e-6  # smallest eigenvalue of the scaled inverse inertia that counts as positive
SAMPLES = 17


@dataclass(frozen=True)
class ShownInertia:
    """The inertia of the coordinates whose speeds are the states `speeds`, up to one common factor.

    M(s) is the sum over k of ``table[i, j, k]`` times the k-th of 1, cos, sin, cos 2, sin 2 of ``turn * s`` (angles),
    or of the powers 0 to 4 of ``turn * s`` (lengths); s is the state `position`, the speed of coordinate `moving`
    times `ratio` is its derivative. `changes` holds, for the up to three free parameters that shape M most, the
    position among the parameters, the nominal value, and the table's derivative by the relative change.
    """

    speeds: tuple[int, ...]
    position: int
    moving: int
    turn: float
    ratio: float
    angular: bool
    table: np.ndarray
    changes: tuple[tuple[int, float, np.ndarray], ...] = ()

    def matrix(self, s: float) -> np.ndarray:
        """M at the position s, (n, n)."""
        return self.table @ _basis(np.array([s]), self.turn, self.angular)[0]


def shown_inertia(structure) -> list[ShownInertia]:
    """One entry per position on which the inertia depends alone; empty where it is constant or does not show.

    Parameters
    ----------
    structure : pwaid.mismatch.structure.Structure
    """
    s, speeds = structure, tuple(structure.velocities())
    if not 1 <= len(speeds) <= 6:
        return []
    found = []
    for moving, v in enumerate(speeds):
        position = s.position_of(v)
        if position < 0 or not s.high[position] > s.low[position]:
            continue
        values = np.linspace(s.low[position], s.high[position], SAMPLES)
        rest = _at_rest(s, 0.5 * (s.low + s.high))
        inverse = _inverse_inertia(s, speeds, _along(rest, position, values))
        if inverse is None:
            continue
        inertia = _fitted(s, speeds, position, moving, values, np.linalg.inv(inverse))
        if inertia is not None and _holds_elsewhere(s, inertia):
            found.append(replace(inertia, changes=_changes(s, inertia, _along(rest, position, values))))
    return found


def _at_rest(s, x) -> np.ndarray:
    x = np.array(x, dtype=float)
    x[list(s.velocities())] = 0.0
    return x


def _along(x, position, values):
    points = np.tile(x, (len(values), 1))
    points[:, position] = values
    return points


def _columns(s, speeds, points, p) -> list[list[np.ndarray]]:
    """Per coordinate the columns (points, n) that forces on it may be: commands, own damping, own spring.

    The commands are the same for every coordinate: which of them drives it is not known.
    """
    commands = [c for c in (_command(s, speeds, points, p, j) for j in range(len(s.input_rms))) if np.any(c)]
    options = []
    for v in speeds:
        own = [_slopes(s, speeds, points, p, i) for i in (v, s.position_of(v)) if i >= 0]
        options.append(commands + [c for c in own if np.any(c)])
    return options


def _command(s, speeds, points, p, j):
    step = np.zeros(len(s.input_rms))
    step[j] = max(s.input_rms[j], 1e-9)
    return np.array([(s.plant.derivative(x, step, p) - s.plant.derivative(x, -step, p))[list(speeds)] / (2 * step[j])
                     for x in points])


def _slopes(s, speeds, points, p, i):
    d = 1e-4 * max(s.reach(i), 1e-9)
    u, step = np.zeros(len(s.input_rms)), np.zeros(points.shape[1])
    step[i] = d
    return np.array([(s.plant.derivative(x + step, u, p) - s.plant.derivative(x - step, u, p))[list(speeds)] / (2 * d)
                     for x in points])


def _inverse_inertia(s, speeds, points, p=None) -> np.ndarray | None:
    """Inverse inertia matrices (points, n, n) up to one factor, or None where the equations do not show them.

    Something must confirm them: symmetry of a coupled pair, or a second force that enters through the same matrix.
    """
    options = _columns(s, speeds, points, p)
    if not all(options) or np.prod([float(len(o)) for o in options]) > 4096:
        return None
    forces = list(itertools.chain.from_iterable(options))
    for chosen in itertools.product(*options):
        columns = np.stack(chosen, axis=2)
        if not np.all(np.isfinite(columns)):
            return None
        factors = _factors(columns)
        if factors is None:
            continue
        inverse = columns / factors
        if _is_inertia(inverse) and _confirmed(inverse, forces):
            return 0.5 * (inverse + inverse.transpose(0, 2, 1))
    return None


def _factors(columns) -> np.ndarray | None:
    """Factors of the columns that make all matrices symmetric, from the strongest couplings outwards."""
    n = columns.shape[1]
    diagonal = np.einsum("kii->ki", columns)
    if np.any(diagonal == 0.0) or np.any(np.sign(diagonal) != np.sign(diagonal[0])):
        return None
    power = np.sqrt(np.mean(columns**2, axis=0))
    strength = power * power.T / np.outer(np.diag(power), np.diag(power))
    factors, reached = np.zeros(n), [0]
    factors[0] = np.sign(diagonal[0, 0])
    while len(reached) < n:
        outside = [j for j in range(n) if j not in reached]
        i, j = max(itertools.product(reached, outside), key=lambda pair: strength[pair])
        if strength[i, j] < TOLERANCE**2:
            return None  # coordinates that do not couple: nothing relates their forces
        a, b = columns[:, j, i], columns[:, i, j]
        factors[j] = factors[i] * (a @ b) / (a @ a)
        reached.append(j)
    return factors


def _is_inertia(inverse) -> bool:
    diagonal = np.einsum("kii->ki", inverse)
    if np.any(diagonal <= 0):
        return False
    size = np.sqrt(diagonal[:, :, None] * diagonal[:, None, :])
    if np.max(np.abs(inverse - inverse.transpose(0, 2, 1)) / size) > TOLERANCE:
        return False
    eigenvalues = np.linalg.eigvalsh(0.5 * (inverse + inverse.transpose(0, 2, 1)) / size)
    return bool(np.all(eigenvalues > SINGULAR))


def _confirmed(inverse, forces) -> bool:
    """Whether a coupled pair, or for one coordinate a second force in constant proportion, confirms the matrices."""
    n, agree = inverse.shape[1], 0
    for column in forces:
        force = np.linalg.solve(inverse, column[:, :, None])[:, :, 0]
        agree += np.max(np.abs(force - force.mean(axis=0))) < TOLERANCE * np.max(np.abs(force))
    return n > 1 or agree > 1


def _basis(values, turn: float, angular: bool) -> np.ndarray:
    z = turn * np.asarray(values, dtype=float)
    if angular:
        return np.column_stack([np.ones_like(z), np.cos(z), np.sin(z), np.cos(2 * z), np.sin(2 * z)])
    return z[:, None] ** np.arange(5)


def _fitted(s, speeds, position, moving, values, matrices) -> ShownInertia | None:
    """The table of M over the position; None when M is constant or of no known form."""
    if np.max(np.ptp(matrices, axis=0)) < 1e-3 * np.max(np.abs(matrices)):
        return None
    symbols = s.state_units[position]
    angular = any(KNOWN.get(symbol) == "angle" for symbol in symbols)
    per_unit = {"deg": np.pi / 180, "rev": 2 * np.pi, "mrad": 1e-3, "urad": 1e-6, "µrad": 1e-6}
    turn = next((per_unit[k] for k in symbols if k in per_unit), 1.0) if angular else 1.0 / s.reach(position)
    table = _table(values, matrices, turn, angular)
    if table is None:
        return None
    return ShownInertia(speeds, position, moving, turn, float(s.ratio[position]), angular, table)


def _table(values, matrices, turn, angular) -> np.ndarray | None:
    """Weights (n, n, 5) of the basis that give the matrices (points, n, n); None when they do not."""
    basis, flat = _basis(values, turn, angular), matrices.reshape(len(values), -1)
    weights = np.linalg.lstsq(basis, flat, rcond=1e-9)[0]
    if np.max(np.abs(basis @ weights - flat)) > TOLERANCE * np.max(np.abs(flat)):
        return None
    return weights.T.reshape(*matrices.shape[1:], -1)


def _changes(s, inertia: ShownInertia, points, step: float = 0.02):
    """Derivatives of the table by the free parameters that shape M and do not only scale it."""
    names, nominal, found = list(s.plant.parameters), s.plant.vector(), []
    values, size = points[:, inertia.position], inertia.table.ravel()
    for k in (names.index(n) for n in s.free if nominal[names.index(n)] != 0.0):
        sides = []
        for factor in (1 + step, 1 - step):
            p = nominal.copy()
            p[k] *= factor
            inverse = _inverse_inertia(s, inertia.speeds, points, p)
            table = None if inverse is None else _table(values, np.linalg.inv(inverse), inertia.turn, inertia.angular)
            sides += [] if table is None else [table]
        if len(sides) < 2:
            continue
        change = (sides[0] - sides[1]) / (2 * step)
        shape = change.ravel() - (change.ravel() @ size) / (size @ size) * size
        if np.linalg.norm(shape) > 1e-4 * np.linalg.norm(size):
            found.append((float(np.linalg.norm(shape)), (k, float(nominal[k]), change)))
    return tuple(entry for _, entry in sorted(found, key=lambda f: -f[0])[:3])


def _holds_elsewhere(s, inertia: ShownInertia, count: int = 6) -> bool:
    """Whether the same matrices show where the other positions are different."""
    rng = np.random.default_rng(0)
    points = np.array([_at_rest(s, s.low + (s.high - s.low) * rng.uniform(size=len(s.low))) for _ in range(count)])
    inverse = _inverse_inertia(s, inertia.speeds, points)
    if inverse is None:
        return False
    products = np.array([w @ inertia.matrix(x[inertia.position]) for w, x in zip(inverse, points, strict=True)])
    factor = np.trace(products[0]) / len(inertia.speeds)
    return bool(np.max(np.abs(products / factor - np.eye(len(inertia.speeds)))) < 30 * TOLERANCE)
