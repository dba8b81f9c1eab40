"""The papers' two matrices: A interpolates at the samples, F extrapolates across the hinges.

A[k] holds the barycentric weights of sample x_k (2014 eq. 4 and Remark 3). Row i of F belongs to hinge i, the facet
shared by simplices s and s′ with opposite vertices p′ (of s) and p (of s′). The extrapolation error (2014 eq. 6)

    e = ŷ_p − Lerp(x̂_p; s) = g · h

is the jump g of the gradient's normal component times the distance h of p from the facet; seen from the other side
it is g · h′ in magnitude. So one row a hinge, with a weight, says all:

    "pairs"  |g| (h + h′)         the sum over all neighbouring simplex–vertex pairs (2011 eq. 9; 2014 eq. 7, 10)
    "hinge"  |g| min(h, h′)       the error seen from the taller simplex, one term a hinge (2014 eq. 11)
    "htv"    |g| · facet measure  the Hessian total variation, which does not depend on the mesh

h, h′ and the measure are taken in the mesh's normalised coordinates, where `"pairs"` and `"hinge"` do not change
and `"htv"` has a meaning at all.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from pwaid.delaunay import SimplexMesh
from pwaid.errors import InputError

__all__ = ["WEIGHTINGS", "barycentric_rows", "extrapolation_error", "hinge_matrix", "interpolation_matrix"]

WEIGHTINGS = ("pairs", "hinge", "htv")


def barycentric_rows(mesh: SimplexMesh, simplex: np.ndarray, weights: np.ndarray) -> sparse.csr_matrix:
    """A sparse (N, n_points) matrix with row k holding `weights[k]` at the vertices of `simplex[k]`."""
    n, k = weights.shape
    indptr = np.arange(0, n * k + 1, k)
    return sparse.csr_matrix((weights.ravel(), mesh.simplices[simplex].ravel(), indptr), (n, mesh.n_points))


def interpolation_matrix(mesh: SimplexMesh, X: Any) -> sparse.csr_matrix:
    """The matrix A with A ŷ = Π(X) (2014 eq. 4, Remark 3).

    Parameters
    ----------
    mesh : SimplexMesh
        With n_points vertices in R^d.
    X : array_like, shape (N, d)
        Samples in physical units, all inside the mesh.

    Returns
    -------
    A : scipy.sparse.csr_matrix, shape (N, n_points)
        d + 1 entries a row; rows sum to 1.

    Raises
    ------
    OutsideMeshError
        Samples lie outside the mesh; drop them with ``mesh.contains(X)`` or use a larger mesh.
    InputError
        X has the wrong shape or holds NaN.
    """
    X = mesh.check_points(X)
    simplex, weights = mesh.locate(X)
    mesh.require_inside(simplex, X)
    return barycentric_rows(mesh, simplex, weights)


def hinge_matrix(mesh: SimplexMesh, weighting: str = "pairs") -> sparse.csr_matrix:
    """The matrix F of weighted extrapolation errors, one row a hinge (2014 eq. 6, 11, Remark 4).

    Parameters
    ----------
    mesh : SimplexMesh
        The mesh.
    weighting : {"pairs", "hinge", "htv"}
        What |F ŷ| measures; see the head of `pwaid.lerp`.

    Returns
    -------
    F : scipy.sparse.csr_matrix, shape (n_hinges, n_points)
        d + 2 entries a row, in the order of ``mesh.facets``; F annihilates every affine function.

    Raises
    ------
    InputError
        Unknown weighting.
    """
    if weighting not in WEIGHTINGS:
        raise InputError(f"weighting is {weighting!r}; expected one of {', '.join(map(repr, WEIGHTINGS))}")
    facets = mesh.facets
    left_height = mesh.heights[facets.left, facets.left_apex]
    right_height = mesh.heights[facets.right, facets.right_apex]
    # Extrapolating from the taller simplex keeps every coefficient of the row of order one, also beside a sliver.
    taller = left_height >= right_height
    s = np.where(taller, facets.left, facets.right)
    apex = np.where(taller, facets.left_apex, facets.right_apex)
    other = np.where(taller, facets.right, facets.left)
    other_apex = np.where(taller, facets.right_apex, facets.left_apex)
    h = np.minimum(left_height, right_height)
    coefficients = _extrapolation(mesh, s, apex, mesh.simplices[other, other_apex])
    weight = {
        "hinge": lambda: np.ones_like(h),
        "pairs": lambda: (left_height + right_height) / h,
        "htv": lambda: _facet_measures(mesh, s, apex) / h,
    }[weighting]()
    n, d = len(facets), mesh.dimension
    values = np.column_stack([-coefficients, np.ones(n)]) * weight[:, None]
    columns = np.column_stack([mesh.simplices[s], mesh.simplices[other, other_apex]])
    F = sparse.csr_matrix((values.ravel(), columns.ravel(), np.arange(0, n * (d + 2) + 1, d + 2)), (n, mesh.n_points))
    F.sort_indices()
    return F


def extrapolation_error(mesh: SimplexMesh, values: Any) -> np.ndarray:
    """Each simplex's contribution to the complexity (2011 eq. 17), shape (n_simplices,).

    The sum over its neighbouring vertices p of |ŷ_p − Lerp(x̂_p; S)|, in the unit of the values.
    """
    values = np.asarray(values, dtype=float)
    facets = mesh.facets
    total = np.zeros(mesh.n_simplices)
    for s, apex, other, other_apex in (
        (facets.left, facets.left_apex, facets.right, facets.right_apex),
        (facets.right, facets.right_apex, facets.left, facets.left_apex),
    ):
        p = mesh.simplices[other, other_apex]
        error = values[p] - np.einsum("kj,kj->k", _extrapolation(mesh, s, apex, p), values[mesh.simplices[s]])
        total += np.bincount(s, np.abs(error), mesh.n_simplices)
    return total


def _extrapolation(mesh: SimplexMesh, s: np.ndarray, apex: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Barycentric coordinates of vertex p in simplex s, accurate to rounding, shape (n, d + 1).

    They are taken relative to a vertex of the shared facet, so that short differences are not lost in large
    coordinates, and summed to one.
    """
    gradients = mesh._barycentric[0]
    Z = mesh.normalised
    base = np.where(apex == 0, 1, 0)
    offset = Z[p] - Z[mesh.simplices[s, base]]
    b = np.einsum("kjd,kd->kj", gradients[s], offset)
    rows = np.arange(len(s))
    b[rows, base] = 0.0
    b[rows, base] = 1.0 - b.sum(axis=1)
    return b


def _facet_measures(mesh: SimplexMesh, s: np.ndarray, apex: np.ndarray) -> np.ndarray:
    """The (d − 1)-dimensional measure of the facet opposite `apex` of s, normalised; 1 in d = 1."""
    return mesh.volumes[s] * mesh.dimension / mesh.heights[s, apex] if mesh.dimension > 1 else np.ones(len(s))
