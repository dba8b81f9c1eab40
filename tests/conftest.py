"""Shared fixtures: small meshes and samples of known truth."""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy: one test process a core, so its BLAS needs one thread

import numpy as np
import pytest

import pwaid


def pyramid(X):
    """2014 eq. 20 without noise."""
    return np.maximum(1.0 - np.abs(X).sum(axis=1), 0.0)


@pytest.fixture
def rng():
    return np.random.default_rng(1)


@pytest.fixture
def data_folder():
    """The folder of real recordings, or a skip that names what is missing."""

    def find(*names):
        root = os.environ.get("PWAID_DATA")
        path = Path(root or "PWAID_DATA", *names)
        if not root or not path.exists():
            pytest.skip(f"{path} is missing; set PWAID_DATA to the folder of recordings")
        return path

    return find


@pytest.fixture(scope="session")
def small():
    """A noisy pyramid on a small mesh: mesh, X, y, X_val, y_val."""
    rng = np.random.default_rng(0)
    mesh = pwaid.SimplexMesh.blue_noise([[-1.1, 1.1]] * 2, 500, rng)
    X, X_val = rng.uniform(-1.1, 1.1, (1000, 2)), rng.uniform(-1.1, 1.1, (1000, 2))
    y, y_val = (pyramid(Z) + 0.1 * rng.standard_normal(len(Z)) for Z in (X, X_val))
    return mesh, X, y, X_val, y_val
