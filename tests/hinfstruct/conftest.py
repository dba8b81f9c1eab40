"""Shared systems: second-order resonances, random stable systems, and the flexible arm at one point."""

import numpy as np
import pytest

from pwaid.systems.vizer2014 import vizer2014_flexible_arm_lpv


def resonance(omega, zeta):
    """Unit-gain second-order system; its norm is 1/(2 zeta sqrt(1 - zeta²)) for zeta < 0.7."""
    return (
        np.array([[0.0, 1.0], [-(omega**2), -2 * zeta * omega]]),
        np.array([[0.0], [omega**2]]),
        np.array([[1.0, 0.0]]),
        np.zeros((1, 1)),
    )


def random_stable(n, rng, inputs=2, outputs=2, margin=0.3):
    rng = np.random.default_rng(rng)
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + margin) * np.eye(n)
    shapes = (n, inputs), (outputs, n), (outputs, inputs)
    return A, *(rng.standard_normal(shape) for shape in shapes)


@pytest.fixture(scope="session")
def arm():
    return vizer2014_flexible_arm_lpv()


def disguised(m, rng):
    """The same transfer function in other, well-conditioned coordinates."""
    n = m.A.shape[0]
    Q, _ = np.linalg.qr(np.random.default_rng(rng).standard_normal((n, n)))
    return Q.T @ m.A @ Q, Q.T @ m.B, m.C @ Q, m.D
