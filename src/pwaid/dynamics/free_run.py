"""Compiled free-run simulation: a PWA map fed with its own past outputs.

    y(k) = Π(C φ(k)) + Θ φ(k)

φ(k) holds past *simulated* outputs and given inputs (`pwaid.dynamics.regressors`), C picks or combines the regressors
along which the map bends, Θ is the linear part. Each step looks for its simplex by walking from the simplex of the
step before: successive regressors are close, so that a walk takes one or two steps whatever the size of the mesh.

Rules when C φ leaves the mesh (`RULES`), each step that does is counted:

    "affine"  the affine law of the simplex behind the nearest boundary facet, as in `PWAMap`
    "clip"    the value at that simplex's barycentric coordinates cut at zero and rescaled: the map stays in the
              range of its vertex values
    "raise"   the run stops; the caller raises

A run whose output exceeds `limit` in magnitude is stopped there: what follows is NaN, never an overflow.
"""

from __future__ import annotations

from collections import namedtuple

import numba
import numpy as np

from pwaid import nearest, walk
from pwaid.delaunay import INSIDE_TOLERANCE, SimplexMesh

__all__ = ["COMPLETE", "DIVERGED", "LEFT", "RULES", "Tables", "run", "run_batch", "run_sensitivity", "tables"]

RULES = ("affine", "clip", "raise")
COMPLETE, DIVERGED, LEFT = 0, 1, 2

Tables = namedtuple(
    "Tables",
    "gradients origins neighbors simplices slopes intercepts lower upper convex "
    "points facets centres radii behind project shift theta",
)
Tables.__doc__ = """What the kernels read: mesh tables (normalised coordinates), affine laws, facets, C and Θ.

`slopes` (n_simplices, n_y, d) and `intercepts` (n_simplices, n_y), the values at the last vertex, give the map in
normalised coordinates z = `project` φ + `shift`; `theta` (n_y, size of φ) is Θ, with no columns when there is no
linear part.
"""


def tables(mesh: SimplexMesh, values: np.ndarray, select: np.ndarray, theta: np.ndarray) -> Tables:
    """Prepare the kernels' tables.

    Parameters
    ----------
    mesh : SimplexMesh
        In d dimensions.
    values : ndarray, shape (n_points, n_y)
        Vertex values of each output's map.
    select : ndarray, shape (d, size of φ)
        C.
    theta : ndarray, shape (n_y, size of φ)
        Θ.
    """
    gradients = mesh._barycentric[0]
    V = values[mesh.simplices]  # (n_simplices, d + 1, n_y)
    slopes = np.einsum("sjy,sjd->syd", V, gradients)
    s, j = mesh.boundary
    corners = np.stack([np.delete(mesh.simplices[i], k) for i, k in zip(s, j, strict=True)])
    facets = np.ascontiguousarray(mesh.normalised[corners])
    centres = facets.mean(axis=1)
    radii = np.linalg.norm(facets - centres[:, None], axis=2).max(axis=1)
    project = np.ascontiguousarray(mesh.scaling.matrix @ select)
    shift = -mesh.scaling.matrix @ mesh.scaling.offset
    linear = np.ascontiguousarray(theta if np.any(theta) else theta[:, :0])
    return Tables(
        gradients, np.ascontiguousarray(mesh._origins),
        np.asarray(mesh.neighbors, np.int64), np.asarray(mesh.simplices, np.int64),
        np.ascontiguousarray(slopes), np.ascontiguousarray(V[:, -1]), *mesh._boxes, mesh.convex,
        np.ascontiguousarray(mesh.normalised), facets, centres, radii, s.astype(np.int64), project, shift, linear,
    )  # fmt: skip


@numba.njit(cache=True, inline="always")
def _regressor(y, inputs, k, n_a, n_b, direct, phi):
    """φ(k), laid out as in `Lags`."""
    p = 0
    for c in range(y.shape[1]):
        for i in range(1, n_a + 1):
            phi[p] = y[k - i, c]
            p += 1
    for c in range(inputs.shape[1]):
        for i in range(0 if direct else 1, n_b + 1):
            phi[p] = inputs[k - i, c]
            p += 1


@numba.njit(cache=True)
def _outside(t, z, weights, rule):
    """The simplex in force for a z outside the mesh; `weights`, and z under "clip", follow the rule."""
    s = t.behind[nearest.nearest_facet(t.facets, t.centres, t.radii, z)]
    walk.barycentric(t.gradients, t.origins, s, z, weights)
    if rule == 1:
        weights[:] = np.maximum(weights, 0.0)
        weights /= weights.sum()
        z[:] = 0.0
        for j in range(weights.shape[0]):
            z += weights[j] * t.points[t.simplices[s, j]]
    return s


@numba.njit(cache=True)
def _search(t, z, weights):
    """Look through every simplex, for meshes that are not convex and walks that rounding stopped."""
    simplex = np.full(1, -1)
    walk.locate_exhaustively(
        t.gradients, t.origins, t.lower, t.upper, z.reshape(1, -1), INSIDE_TOLERANCE, simplex, weights.reshape(1, -1)
    )
    return simplex[0]


@numba.njit(cache=True)
def _simulate(t, y, inputs, lags, rule, limit, complement, S):
    """`run`, and `run_sensitivity` where S has rows.

    One loop: a step in a function of its own would hold and release every table at each call, which took longer than
    the step itself.
    """
    d = t.project.shape[0]
    phi, z, weights = np.empty(t.project.shape[1]), np.empty(d), np.empty(d + 1)
    s, n_outside = 0, 0
    for k in range(max(lags[0], lags[1]), y.shape[0]):
        _regressor(y, inputs, k, lags[0], lags[1], lags[2] == 1, phi)
        for i in range(d):
            z[i] = t.shift[i]
            for p in range(phi.shape[0]):
                z[i] += t.project[i, p] * phi[p]
        found = walk.walk(t.gradients, t.origins, t.neighbors, z, s, INSIDE_TOLERANCE, weights)
        if found < 0 and (not t.convex or found < -t.neighbors.shape[0]):
            found = _search(t, z, weights)
        if found < 0:
            n_outside += 1
            if rule == 2:
                y[k:] = np.nan
                return LEFT, k, n_outside
            found = _outside(t, z, weights, rule)
        s = found
        for c in range(y.shape[1]):
            value = t.intercepts[s, c]
            for i in range(d):
                value += t.slopes[s, c, i] * (z[i] - t.origins[s, i])
            for p in range(t.theta.shape[1]):
                value += t.theta[c, p] * phi[p]
            y[k, c] = value
        for c in range(y.shape[1]):
            if not abs(y[k, c]) <= limit:
                y[k:] = np.nan
                return DIVERGED, k, n_outside
        if S.shape[0] > 0:
            _differentiate(t, k, s, phi, weights, lags[0], complement, S)
    return COMPLETE, y.shape[0], n_outside


@numba.njit(cache=True)
def _differentiate(t, k, s, phi, weights, n_a, complement, S):
    """Fill row k of S from the rows before it."""
    n_points, d = t.points.shape[0], t.project.shape[0]
    for j in range(d + 1):
        S[k, t.simplices[s, j]] += weights[j]
    for w in range(complement.shape[1]):
        for p in range(phi.shape[0]):
            S[k, n_points + w] += complement[p, w] * phi[p]
    for i in range(n_a):
        g = 0.0
        for q in range(d):
            g += t.slopes[s, 0, q] * t.project[q, i]
        if t.theta.shape[1] > 0:
            g += t.theta[0, i]
        S[k] += g * S[k - 1 - i]


@numba.njit(cache=True)
def run(t, y, inputs, lags, rule, limit):
    """Fill y, shape (N, n_y), from row max(lags) on; the rows before hold the initial outputs.

    Returns
    -------
    state : int
        `COMPLETE`, `DIVERGED` or `LEFT` (rule "raise").
    end : int
        The first sample that was not simulated; N when complete.
    n_outside : int
        Steps with C φ outside the mesh.
    """
    nothing = np.empty((0, 0))
    return _simulate(t, y, inputs, lags, rule, limit, nothing, nothing)


@numba.njit(cache=True)
def run_batch(t, y, inputs, lags, rule, limit, state, end, n_outside):
    """`run` for each of B trajectories: y (B, N, n_y), inputs (B, N, n_u)."""
    for b in range(y.shape[0]):
        state[b], end[b], n_outside[b] = run(t, y[b], inputs[b], lags, rule, limit)


@numba.njit(cache=True)
def run_sensitivity(t, y, inputs, lags, rule, limit, complement, S):
    """`run` for one output, with the derivative of y with respect to the vertex values and the linear part.

    With g_i = ∂y(k)/∂y(k−i) the derivative of a free run obeys S(k) = [A(k), Wᵀφ(k)] + Σ g_i S(k−i), where A(k)
    holds the barycentric weights at step k.

    Parameters
    ----------
    complement : ndarray, shape (size of φ, n_w)
        W: Θ = (W w)ᵀ with the free parameters w.
    S : ndarray, shape (N, n_points + n_w)
        Zero on entry; filled. Rows of the initial samples stay zero.
    """
    return _simulate(t, y, inputs, lags, rule, limit, complement, S)
