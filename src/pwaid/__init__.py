"""pwaid: piecewise-affine identification, and what a simulator leaves out of its machine.

From samples to a map, with the useful range of λ known in advance:

>>> import numpy as np, pwaid
>>> rng = np.random.default_rng(0)
>>> X = rng.uniform(-1, 1, (400, 2))
>>> y = np.maximum(X[:, 0], 0.0) + 0.01 * rng.standard_normal(400)
>>> mesh = pwaid.SimplexMesh.blue_noise([[-1, 1], [-1, 1]], 200, rng)
>>> problem = pwaid.HingeProblem.from_data(mesh, X, y, weighting="htv")
>>> path = pwaid.solve_path(problem, X_val=X[::2], y_val=y[::2], mesh=mesh, n_lambdas=10)
>>> f = path.best.map
>>> bool(path.best.gap <= 1e-4 and abs(f([[0.5, 0.0]])[0] - 0.5) < 0.02)
True
"""

from typing import Any

from pwaid import _kernel_cache  # noqa: F401 - first, before any module loads what it compiled earlier
from pwaid._version import __version__
from pwaid.delaunay import MeshQuality, SimplexMesh
from pwaid.dynamics import NARX, PWASystem
from pwaid.errors import InputError, MissingExtraError, OutsideMeshError, PwaidError, SolverError
from pwaid.estimator import PWARegressor
from pwaid.lambda_max import lambda_max
from pwaid.lerp import hinge_matrix, interpolation_matrix
from pwaid.noise_free import solve_noise_free
from pwaid.path import cross_validate, solve_path
from pwaid.problem import HingeProblem
from pwaid.pwa_map import PWAMap
from pwaid.recording import Recording
from pwaid.scaling import Scaling
from pwaid.solution import Path, Solution, Status
from pwaid.solve import solve
from pwaid.sqrt_loss import solve_sqrt


def __getattr__(name: str) -> Any:
    """`pwaid.explain` and `pwaid.mismatch`, loaded when first used: they compile a simulation engine."""
    if name in ("explain", "mismatch"):
        import pwaid.mismatch as loaded

        return loaded if name == "mismatch" else loaded.explain
    raise AttributeError(f"module 'pwaid' has no attribute {name!r}")


__all__ = [
    "NARX",
    "HingeProblem",
    "InputError",
    "MeshQuality",
    "MissingExtraError",
    "OutsideMeshError",
    "PWAMap",
    "PWARegressor",
    "PWASystem",
    "Path",
    "PwaidError",
    "Recording",
    "Scaling",
    "SimplexMesh",
    "Solution",
    "SolverError",
    "Status",
    "__version__",
    "cross_validate",
    "explain",
    "hinge_matrix",
    "interpolation_matrix",
    "lambda_max",
    "solve",
    "solve_noise_free",
    "solve_path",
    "solve_sqrt",
]
