"""Normalised coordinates: an affine change that gives inputs of different physical units a common length.

z = (x − offset) · matrixᵀ; 2011 divides by the units 1.5 A and 35 rad/s, 2014 Example 2 takes Σ^(−1/2) of the data.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pwaid import vertices
from pwaid.errors import InputError

__all__ = ["Scaling"]


@dataclass(frozen=True, eq=False)
class Scaling:
    """The affine change to normalised coordinates, z = (x − offset) · matrixᵀ."""

    offset: np.ndarray
    matrix: np.ndarray

    @classmethod
    def identity(cls, d: int) -> Scaling:
        """No change."""
        return cls(np.zeros(d), np.eye(d))

    @classmethod
    def units(cls, sizes: Any, offset: Any = 0.0) -> Scaling:
        """Divide each input by a physical unit, e.g. (1.5 A, 35 rad/s) (2011 section V)."""
        sizes = np.atleast_1d(np.asarray(sizes, dtype=float))
        if np.any(sizes <= 0) or not np.all(np.isfinite(sizes)):
            raise InputError(f"units are {sizes.tolist()}; expected positive numbers, one an input")
        return cls(np.broadcast_to(np.asarray(offset, float), sizes.shape).copy(), np.diag(1.0 / sizes))

    @classmethod
    def box(cls, bounds: Any) -> Scaling:
        """Divide each input by half the width of a box, shape (d, 2), about its middle."""
        box = vertices.as_bounds(bounds)
        return cls.units((box[:, 1] - box[:, 0]) / 2, box.mean(axis=1))

    @classmethod
    def covariance(cls, X: Any) -> Scaling:
        """Σ^(−1/2) of the data about their mean (2014 Example 2)."""
        X = vertices.as_points(X, "X")
        eigenvalues, V = np.linalg.eigh(np.atleast_2d(np.cov(X.T)))
        if eigenvalues[0] <= 1e-12 * max(eigenvalues[-1], np.finfo(float).tiny):
            raise InputError(
                "the inputs are collinear: their covariance is singular (a constant or redundant column); "
                "leave out the redundant input"
            )
        return cls(X.mean(axis=0), (V / np.sqrt(eigenvalues)) @ V.T)

    def apply(self, X: np.ndarray) -> np.ndarray:
        """Physical to normalised, shape (N, d)."""
        return (X - self.offset) @ self.matrix.T

    def undo(self, Z: np.ndarray) -> np.ndarray:
        """Normalised to physical, shape (N, d)."""
        return np.linalg.solve(self.matrix, Z.T).T + self.offset
