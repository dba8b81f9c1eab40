"""One cell of a piecewise-affine system: what holds while G x + H u + g ≥ 0 (Yamada et al., equations
6-8).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pwaid.errors import InputError

__all__ = ["Cell", "freeze"]


def _array(value, shape: tuple, what: str) -> np.ndarray:
    """`value` as a read-only float array of `shape` (None: any length there); zeros where `value` is None."""
    if value is None:
        array = np.zeros([length or 0 for length in shape])
    else:
        array = np.array(value, dtype=float)
    fits = array.ndim == len(shape) and all(s in (None, t) for s, t in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = "(" + ", ".join("any" if s is None else str(s) for s in shape) + ")"
        raise InputError(f"{what} has shape {array.shape}; expected {wanted}; check the sizes of the cell's "
                         "matrices")
    if not np.isfinite(array).all():
        raise InputError(f"{what} holds NaN or infinity; every entry of a cell's matrices must be finite")
    array.flags.writeable = False
    return array


def freeze(record) -> None:
    """Make every array that a dataclass instance holds read-only."""
    for value in vars(record).values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False


@dataclass(frozen=True)
class Cell:
    """ẋ = A x + a + B u and y = C x + c + D u while every row of G x + H u + g is ≥ 0.

    Parameters
    ----------
    A, a, B : array_like (n, n), (n,), (n, m)
        Dynamics; a and B default to zero (B to no input).
    G, g : array_like (r, n), (r,)
        Guards; without them the cell is the whole space.
    H : array_like (r, m), optional
        How the guards depend on the inputs; zero in the paper's form. Controllers need it: their inputs are
        measured.
    C, c, D : array_like (p, n), (p,), (p, m), optional
        Outputs; the states when C is not given.
    F, f : array_like (q, n), (q,), optional
        The continuity matrices of equation (8), checked by `PWASystem.continuity`.
    name : str
        For messages and tables.
    """

    A: np.ndarray
    a: np.ndarray | None = None
    B: np.ndarray | None = None
    G: np.ndarray | None = None
    g: np.ndarray | None = None
    H: np.ndarray | None = None
    C: np.ndarray | None = None
    c: np.ndarray | None = None
    D: np.ndarray | None = None
    F: np.ndarray | None = None
    f: np.ndarray | None = None
    name: str = ""

    def __post_init__(self):
        where = f"of cell {self.name!r}" if self.name else "of a cell"
        A = np.asarray(self.A, dtype=float)
        if A.ndim != 2 or A.shape[0] != A.shape[1]:
            raise InputError(f"A {where} has shape {A.shape}; expected a square matrix (n, n)")
        n = A.shape[0]
        B = _array(np.zeros((n, 0)) if self.B is None else self.B, (n, None), f"B {where}")
        m = B.shape[1]
        G = _array(np.zeros((0, n)) if self.G is None else self.G, (None, n), f"G {where}")
        if self.G is not None and self.g is None:
            raise InputError(f"G {where} came without g; give both, as in G x + g ≥ 0")
        r = G.shape[0]
        C = _array(np.eye(n) if self.C is None else self.C, (None, n), f"C {where}")
        p = C.shape[0]
        F = _array(np.zeros((0, n)) if self.F is None else self.F, (None, n), f"F {where}")
        fields = {
            "A": _array(A, (n, n), f"A {where}"), "B": B, "G": G, "C": C, "F": F,
            "a": _array(self.a, (n,), f"a {where}"),
            "g": _array(self.g, (r,), f"g {where}"),
            "H": _array(self.H, (r, m), f"H {where}"),
            "c": _array(self.c, (p,), f"c {where}"),
            "D": _array(self.D, (p, m), f"D {where}"),
            "f": _array(self.f, (F.shape[0],), f"f {where}"),
        }  # fmt: skip
        for key, value in fields.items():
            object.__setattr__(self, key, value)

    def velocity(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """A x + a + B u."""
        return self.A @ x + self.a + self.B @ u

    def output(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """C x + c + D u; x and u may hold one sample per row."""
        return x @ self.C.T + self.c + u @ self.D.T

    def margin(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """G x + H u + g, one value per guard; the cell holds (x, u) when none is negative."""
        return x @ self.G.T + u @ self.H.T + self.g

    def replace(self, **changes) -> Cell:
        """A changed copy."""
        return replace(self, **changes)
