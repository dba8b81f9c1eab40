"""Simplex meshes: points, simplices, neighbours, facets, point location, clipping.

A mesh is triangulated in the normalised coordinates of `pwaid.scaling`. Points go in and come out in physical units;
distances, heights and facet measures are those of the normalised coordinates.
Slivers are handled by the rule in `pwaid.triangulation`; `SimplexMesh.quality` reports what was done.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from pwaid import triangulation, vertices, walk
from pwaid.errors import InputError, OutsideMeshError
from pwaid.recording import check_finite
from pwaid.scaling import Scaling
from pwaid.triangulation import MeshQuality

__all__ = ["Facets", "MeshQuality", "Scaling", "SimplexMesh"]

# Coordinates down to minus this count as inside: a point on the hull, after rounding, belongs to the mesh.
INSIDE_TOLERANCE = 1e-10
UNTOUCHED = MeshQuality()


@dataclass(frozen=True, eq=False)
class Facets:
    """The interior facets (hinges) of a mesh, one entry each.

    Attributes
    ----------
    left, right : ndarray of int, shape (n,)
        The two simplices.
    left_apex, right_apex : ndarray of int, shape (n,)
        Local index (0…d) of the vertex opposite the facet in each of them.
    """

    left: np.ndarray
    right: np.ndarray
    left_apex: np.ndarray
    right_apex: np.ndarray

    def __len__(self) -> int:
        return self.left.size


@dataclass(frozen=True, eq=False)
class SimplexMesh:
    """A triangulation of points in R^d, d ≥ 1.

    Make one with `from_points`, `uniform`, `gaussian`, `blue_noise`, `from_data` or `grid`.

    Attributes
    ----------
    points : ndarray, shape (n_points, d)
        Vertices x̂ in physical units.
    simplices : ndarray of int, shape (n_simplices, d + 1)
        Vertex indices.
    neighbors : ndarray of int, shape (n_simplices, d + 1)
        The simplex opposite each vertex, −1 at the boundary.
    scaling : Scaling
        Physical to normalised coordinates.
    quality : MeshQuality
        What was done to slivers.
    convex : bool
        False after clipping: the union of the simplices then need not be convex.
    """

    points: np.ndarray
    simplices: np.ndarray
    neighbors: np.ndarray
    scaling: Scaling
    quality: MeshQuality = UNTOUCHED
    convex: bool = True

    def __post_init__(self) -> None:
        for name in ("points", "simplices", "neighbors"):
            getattr(self, name).setflags(write=False)

    # -- making ----------------------------------------------------------------------------------------------

    @classmethod
    def from_points(cls, points: Any, *, scaling: Scaling | None = None) -> SimplexMesh:
        """Delaunay triangulation of given points (2011 Remark 1).

        Parameters
        ----------
        points : array_like, shape (n, d) or (n,)
            Distinct points in physical units that span R^d; at least d + 1 of them.
        scaling : Scaling, optional
            Physical to normalised coordinates; none by default.

        Raises
        ------
        InputError
            Non-finite or repeated points, too few, or all of them on one hyperplane.
        """
        P = vertices.as_points(points)
        n, d = P.shape
        scaling = scaling or Scaling.identity(d)
        if scaling.offset.size != d:
            raise InputError(f"the scaling is for {scaling.offset.size} inputs, the points have {d}")
        if n < d + 1:
            raise InputError(f"{n} points came; a mesh in {d} dimensions needs at least {d + 1}")
        n_distinct = len(np.unique(P, axis=0))
        if n_distinct < n:
            raise InputError(f"{n - n_distinct} of {n} points are repeated; expected distinct points: use np.unique")
        Z = scaling.apply(P)
        spread = np.linalg.svd(Z - Z.mean(axis=0), compute_uv=False)
        if spread[-1] <= 1e-10 * spread[0]:
            raise InputError(
                f"the {n} points lie in a plane of fewer than {d} dimensions (collinear inputs); "
                "leave out the redundant input"
            )
        Z, simplices, quality = triangulation.triangulate(Z)
        if quality.moved:
            P = scaling.undo(Z)
        return cls._assemble(P, simplices, scaling, quality)

    @classmethod
    def _assemble(cls, P, simplices, scaling, quality, convex=True) -> SimplexMesh:
        """Drop unused vertices, find neighbours, and measure the slivers left."""
        used = np.zeros(len(P), bool)
        used[simplices] = True
        simplices = (np.cumsum(used) - 1)[simplices]
        neighbors = triangulation.neighbors(simplices)
        mesh = cls(P[used].copy(), simplices.astype(np.int32), neighbors, scaling, quality, convex)
        return replace(mesh, quality=replace(quality, worst_aspect_ratio=float(mesh.aspect_ratios.max())))

    @classmethod
    def uniform(cls, bounds: Any, n: int, rng: Any = None) -> SimplexMesh:
        """`n` uniform random points in a box, corners included; normalised by the box (2011 section V)."""
        return cls.from_points(vertices.uniform_points(bounds, n, rng), scaling=Scaling.box(bounds))

    @classmethod
    def blue_noise(cls, bounds: Any, n: int, rng: Any = None) -> SimplexMesh:
        """`n` evenly spread points in a box, corners and faces included; normalised by the box."""
        return cls.from_points(vertices.blue_noise_points(bounds, n, rng), scaling=Scaling.box(bounds))

    @classmethod
    def gaussian(cls, X: Any, n: int, rng: Any = None) -> SimplexMesh:
        """`n` normal points with the mean and covariance of X, normalised by Σ^(−1/2) (2014 Example 2)."""
        scaling = Scaling.covariance(X)
        return cls.from_points(vertices.gaussian_points(X, n, rng), scaling=scaling)

    @classmethod
    def from_data(
        cls, X: Any, n: int | None = None, rng: Any = None, *, scaling: Scaling | None = None
    ) -> SimplexMesh:
        """`n` points that follow the density of X, with the corners of a box round it.

        The normalisation is by each column's standard deviation unless `scaling` is given.
        """
        X = vertices.as_points(X, "X")
        if scaling is None:
            deviation = X.std(axis=0)
            if np.any(deviation == 0):
                k = int(np.argmax(deviation == 0))
                raise InputError(f"column {k} of X is constant; expected every input to vary: leave it out")
            scaling = Scaling.units(deviation, X.mean(axis=0))
        P = vertices.data_points(scaling.apply(X), n, rng)
        return cls.from_points(scaling.undo(P), scaling=scaling)

    @classmethod
    def grid(cls, bounds: Any, shape: Any) -> SimplexMesh:
        """A regular grid, each cell cut into d! simplices the same way (Kuhn), normalised by the box.

        Cospherical lattice points have no unique Delaunay triangulation, so this one is built directly.
        """
        box = vertices.as_bounds(bounds)
        d = len(box)
        counts = np.broadcast_to(np.asarray(shape, dtype=int), (d,))
        if np.any(counts < 2):
            raise InputError(f"shape is {counts.tolist()}; expected at least 2 points a dimension")
        axes = [np.linspace(a, b, m) for (a, b), m in zip(box, counts, strict=True)]
        P = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
        return cls._assemble(P, triangulation.kuhn(counts), Scaling.box(box), UNTOUCHED)

    # -- shape -----------------------------------------------------------------------------------------------

    @property
    def dimension(self) -> int:
        """d, the number of inputs."""
        return self.points.shape[1]

    @property
    def n_points(self) -> int:
        """N̂, the number of vertices."""
        return self.points.shape[0]

    @property
    def n_simplices(self) -> int:
        """How many simplices."""
        return self.simplices.shape[0]

    @cached_property
    def normalised(self) -> np.ndarray:
        """Vertices in normalised coordinates, shape (n_points, d)."""
        return self.scaling.apply(self.points)

    @cached_property
    def _barycentric(self) -> tuple[np.ndarray, np.ndarray]:
        """Gradients (n_simplices, d + 1, d) and offsets (n_simplices, d + 1) of the barycentric coordinates."""
        V = self.normalised[self.simplices]
        edges = V[:, :-1] - V[:, -1:]
        first = np.linalg.inv(edges).transpose(0, 2, 1)
        gradients = np.concatenate([first, -first.sum(axis=1, keepdims=True)], axis=1)
        offsets = -np.einsum("sjk,sk->sj", gradients, V[:, -1])
        offsets[:, -1] += 1.0
        return np.ascontiguousarray(gradients), np.ascontiguousarray(offsets)

    @cached_property
    def _origins(self) -> np.ndarray:
        """The last vertex of each simplex, normalised, shape (n_simplices, d)."""
        return self.normalised[self.simplices[:, -1]]

    @cached_property
    def heights(self) -> np.ndarray:
        """Distance of each vertex from the opposite facet's hyperplane, normalised, shape (n_simplices, d + 1)."""
        return 1.0 / np.linalg.norm(self._barycentric[0], axis=2)

    @cached_property
    def volumes(self) -> np.ndarray:
        """Normalised volumes, shape (n_simplices,)."""
        return triangulation.volumes(self.normalised, self.simplices)

    @cached_property
    def aspect_ratios(self) -> np.ndarray:
        """Longest edge over smallest height of each simplex, shape (n_simplices,)."""
        return triangulation.longest_edges(self.normalised, self.simplices) / self.heights.min(axis=1)

    @cached_property
    def facets(self) -> Facets:
        """The interior facets: the mesh's hinges."""
        s, j = np.nonzero(self.neighbors > np.arange(self.n_simplices)[:, None])
        other = self.neighbors[s, j]
        k = np.argmax(self.neighbors[other] == s[:, None], axis=1)
        return Facets(s, other, j, k)

    @cached_property
    def boundary(self) -> tuple[np.ndarray, np.ndarray]:
        """The boundary facets as (simplex, local index of the opposite vertex)."""
        return np.nonzero(self.neighbors < 0)

    # -- point location --------------------------------------------------------------------------------------

    @cached_property
    def _buckets(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A start simplex for each bucket of a regular grid with about as many cells as simplices."""
        Z = self.normalised
        d = self.dimension
        low, high = Z.min(axis=0), Z.max(axis=0)
        shape = np.full(d, max(1, min(64 if d > 2 else 1024, round(self.n_simplices ** (1.0 / d)))))
        width = (high - low) / shape
        axes = [low[k] + width[k] * (np.arange(shape[k]) + 0.5) for k in range(d)]
        centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
        of_vertex = np.zeros(self.n_points, np.int64)
        of_vertex[self.simplices] = np.arange(self.n_simplices)[:, None]
        start = of_vertex[cKDTree(Z).query(centres)[1]]
        return start, low, 1.0 / width, shape.astype(np.int64)

    @cached_property
    def _boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounding boxes of the simplices, widened by rounding."""
        V = self.normalised[self.simplices]
        wide = 1e-9 * (V.max() - V.min())
        return V.min(axis=1) - wide, V.max(axis=1) + wide

    def locate(self, X: Any) -> tuple[np.ndarray, np.ndarray]:
        """The simplex of each point and the point's barycentric coordinates in it.

        Parameters
        ----------
        X : array_like, shape (N, d)
            Points in physical units.

        Returns
        -------
        simplex : ndarray of int, shape (N,)
            −1 outside the mesh.
        weights : ndarray, shape (N, d + 1)
            Barycentric coordinates, NaN outside.
        """
        Z = np.ascontiguousarray(self.scaling.apply(self.check_points(X)))
        gradients, origins = self._barycentric[0], self._origins
        simplex = np.empty(len(Z), np.int64)
        weights = np.empty((len(Z), self.dimension + 1))
        walk.locate(gradients, origins, self.neighbors, Z, *self._buckets, INSIDE_TOLERANCE, simplex, weights)
        if not self.convex or np.any(simplex < -self.n_simplices):
            walk.locate_exhaustively(gradients, origins, *self._boxes, Z, INSIDE_TOLERANCE, simplex, weights)
        outside = simplex < 0
        simplex[outside] = -1
        weights[outside] = np.nan
        return simplex, weights

    def contains(self, X: Any) -> np.ndarray:
        """Whether each point lies in the mesh, shape (N,)."""
        return self.locate(X)[0] >= 0

    def check_points(self, X: Any) -> np.ndarray:
        """X as a finite (N, d) array of this mesh's dimension, or an `InputError`."""
        X = np.asarray(X, dtype=float)
        if X.ndim == 1 and self.dimension == 1:
            X = X[:, None]
        if X.ndim != 2 or X.shape[1] != self.dimension:
            hint = ""
            if X.ndim == 2 and X.shape[0] == self.dimension:
                hint = "; it looks transposed: pass X.T"
            elif X.ndim == 1 and X.size == self.dimension:
                hint = "; for one point pass X[None, :]"
            raise InputError(f"X has shape {X.shape}; expected (N, {self.dimension}){hint}")
        check_finite(X, "X")
        return X

    def require_inside(self, simplex: np.ndarray, X: np.ndarray) -> None:
        """Raise `OutsideMeshError` when `locate` found points outside."""
        outside = np.flatnonzero(simplex < 0)
        if outside.size:
            k = int(outside[0])
            raise OutsideMeshError(
                f"{outside.size} of {simplex.size} points lie outside the mesh, the first at index {k}: "
                f"{np.asarray(X)[k].tolist()}, where the mesh spans {self.points.min(axis=0).tolist()} to "
                f"{self.points.max(axis=0).tolist()}; use a larger mesh, drop them with mesh.contains(X), "
                'or name a rule (outside="affine")'
            )

    # -- changing (copies) -----------------------------------------------------------------------------------

    def clip(self, *, bounds: Any = None, hull: Any = None) -> SimplexMesh:
        """Keep the simplices that meet a box or the convex hull of points (2014 Example 1).

        Simplices are kept whole, so the result still covers the region; the vertices of the others go.

        Parameters
        ----------
        bounds : array_like, shape (d, 2), optional
            The box, physical units.
        hull : array_like, shape (n, d), optional
            Points whose convex hull is the region, physical units.
        """
        if (bounds is None) == (hull is None):
            raise InputError("give either bounds= or hull= to clip to")
        corners = vertices.box_corners(bounds) if hull is None else vertices.as_points(hull, "hull")
        if corners.shape[1] != self.dimension:
            raise InputError(f"the region has {corners.shape[1]} dimensions, the mesh {self.dimension}")
        region = self.scaling.apply(corners)
        keep = ~_separated(self, region)
        if not keep.any():
            raise InputError("no simplex of the mesh meets the region; expected a region inside the mesh")
        return self._assemble(self.points, self.simplices[keep], self.scaling, self.quality, convex=False)


def _separated(mesh: SimplexMesh, region: np.ndarray) -> np.ndarray:
    """Whether a facet plane of the simplex or of the region parts the two, for each simplex.

    Exact in d ≤ 2; for d ≥ 3 a few simplices that only come near an edge of the region are kept as well.
    """
    gradients, offsets = mesh._barycentric
    Z, tolerance = mesh.normalised[mesh.simplices], 1e-12
    d = mesh.dimension
    if d == 1:
        return (Z[:, :, 0].max(axis=1) <= region.min() + tolerance) | (
            Z[:, :, 0].min(axis=1) >= region.max() - tolerance
        )
    apart = np.zeros(mesh.n_simplices, bool)
    hull = ConvexHull(region)
    corners = region[hull.vertices]
    for j in range(d + 1):
        apart |= (gradients[:, j] @ corners.T).max(axis=1) + offsets[:, j] <= tolerance
    for equation in hull.equations:
        apart |= (Z @ equation[:d]).min(axis=1) + equation[d] >= -tolerance
    return apart
