"""PWAMap: a continuous piecewise-affine map given by its values at the vertices of a mesh.

Inside a simplex the map is the affine function through its vertices (2011 Definition 1, 2014 Definition 1). Outside
the mesh it follows a rule that the caller names:

    "raise"   an `OutsideMeshError`, the default
    "nan"     NaN
    "affine"  the affine law of the simplex behind the nearest boundary facet
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from pwaid import nearest
from pwaid.delaunay import MeshQuality, SimplexMesh
from pwaid.errors import InputError
from pwaid.lerp import extrapolation_error
from pwaid.recording import check_finite
from pwaid.scaling import Scaling

__all__ = ["OUTSIDE_RULES", "PWAMap"]

OUTSIDE_RULES = ("raise", "nan", "affine")
FORMAT = "pwaid.map/1"


@dataclass(frozen=True, eq=False)
class PWAMap:
    """A continuous piecewise-affine map R^d → R.

    Parameters
    ----------
    mesh : SimplexMesh
        With n_points vertices.
    values : array_like, shape (n_points,)
        ŷ at the vertices.

    Raises
    ------
    InputError
        `values` does not fit the mesh or is not finite.
    """

    mesh: SimplexMesh
    values: np.ndarray

    def __post_init__(self) -> None:
        values = np.array(self.values, dtype=float)
        if values.shape != (self.mesh.n_points,):
            raise InputError(f"values have shape {values.shape}; expected ({self.mesh.n_points},), one a vertex")
        check_finite(values, "values")
        values.setflags(write=False)
        object.__setattr__(self, "values", values)

    def active_simplex(self, X: Any, outside: str = "nan") -> np.ndarray:
        """Index of the simplex in force at each point, shape (N,).

        Outside the mesh: −1 with ``"nan"``, the simplex behind the nearest boundary facet with ``"affine"``.
        """
        return self._find(X, outside)[0]

    def __call__(self, X: Any, outside: str = "raise") -> np.ndarray:
        """Values of the map, shape (N,).

        Parameters
        ----------
        X : array_like, shape (N, d)
            Points in physical units; (N,) for d = 1.
        outside : {"raise", "nan", "affine"}
            The rule outside the mesh.

        Raises
        ------
        OutsideMeshError
            Points outside the mesh under the rule ``"raise"``.
        """
        simplex, weights = self._find(X, outside)
        result = np.full(len(simplex), np.nan)
        known = simplex >= 0
        vertices = self.mesh.simplices[simplex[known]]
        result[known] = np.einsum("kj,kj->k", weights[known], self.values[vertices])
        return result

    def gradient(self, X: Any, outside: str = "raise") -> np.ndarray:
        """Gradients in physical units, shape (N, d); on a hinge, that of one of its simplices."""
        simplex, _ = self._find(X, outside)
        slopes = np.vstack([self.slopes, np.full(self.mesh.dimension, np.nan)])
        return slopes[simplex]

    def extrapolation_error(self) -> np.ndarray:
        """Contribution of each simplex to the complexity (2011 eq. 17), shape (n_simplices,)."""
        return extrapolation_error(self.mesh, self.values)

    @property
    def slopes(self) -> np.ndarray:
        """The gradient in each simplex, physical units, shape (n_simplices, d)."""
        gradients, _ = self.mesh._barycentric
        V = self.values[self.mesh.simplices]
        V = V - V[:, :1]
        return np.einsum("sj,sjd->sd", V, gradients) @ self.mesh.scaling.matrix

    def _find(self, X: Any, outside: str) -> tuple[np.ndarray, np.ndarray]:
        if outside not in OUTSIDE_RULES:
            raise InputError(f"outside is {outside!r}; expected one of {', '.join(map(repr, OUTSIDE_RULES))}")
        X = self.mesh.check_points(X)
        simplex, weights = self.mesh.locate(X)
        if outside == "raise":
            self.mesh.require_inside(simplex, X)
        elif outside == "affine" and np.any(simplex < 0):
            simplex, weights = nearest.extend(self.mesh, X, simplex, weights)
        return simplex, weights

    # -- files -----------------------------------------------------------------------------------------------

    def save(self, path: str | Path) -> Path:
        """Write the map to a ``.npz`` file (arrays only, no pickles); returns the path written."""
        path = Path(path)
        if path.suffix != ".npz":
            path = path.with_name(path.name + ".npz")
        mesh = self.mesh
        head = {"format": FORMAT, "convex": mesh.convex, "quality": vars(mesh.quality)}
        np.savez_compressed(
            path,
            head=np.array(json.dumps(head)),
            points=mesh.points,
            simplices=mesh.simplices,
            neighbors=mesh.neighbors,
            offset=mesh.scaling.offset,
            matrix=mesh.scaling.matrix,
            values=self.values,
        )
        return path

    @classmethod
    def load(cls, path: str | Path) -> PWAMap:
        """Read a map that `save` wrote.

        Raises
        ------
        InputError
            The file is missing or is not a pwaid map.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError(f"{path} is not a file; expected a map written by PWAMap.save")
        try:
            with np.load(path, allow_pickle=False) as file:
                content = {key: file[key] for key in file.files}
            head = json.loads(str(content["head"]))
        except (OSError, EOFError, ValueError, KeyError, BadZipFile) as error:
            raise InputError(f"{path.name} is not a pwaid map ({error}); expected a file of PWAMap.save") from error
        if head.get("format") != FORMAT:
            raise InputError(f"{path.name} has the format {head.get('format')!r}; this version reads {FORMAT!r}")
        mesh = SimplexMesh(
            content["points"],
            content["simplices"],
            content["neighbors"],
            Scaling(content["offset"], content["matrix"]),
            MeshQuality(**head["quality"]),
            head["convex"],
        )
        return cls(mesh, content["values"])
