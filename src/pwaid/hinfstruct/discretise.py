"""Discrete to continuous time and back.

Subspace identification of held-input data gives a *hold-equivalent* discrete model. Its continuous model is
the inverse of the zero-order hold, the matrix logarithm of [[A, B], [0, I]]. The bilinear (Tustin) inverse
used in Vizer et al. (2014), section 3.3.1, leaves the half-sample delay of the hold in the continuous model:
an error of about ``omega dt / 2`` relative, whatever the noise.
"""

from __future__ import annotations

import control
import numpy as np
import scipy.linalg

from pwaid.errors import InputError
from pwaid.hinfstruct.statespace import Matrices, as_matrices, to_control

__all__ = ["c2d", "d2c"]


def d2c(
    system, *, method: str = "zoh", dt: float | None = None, negative_poles: str = "raise"
) -> control.StateSpace:
    """Continuous model of a discrete one.

    Parameters
    ----------
    system : control.StateSpace (discrete) or tuple (A, B, C, D) with ``dt``
    method : "zoh" or "tustin"
        "zoh": exact inverse of the zero-order hold. "tustin": s = (2/dt)(z - 1)/(z + 1), which keeps the
        H-infinity norm.
    dt : float, optional
        Sampling time of a plain tuple, seconds.
    negative_poles : "raise" or "static"
        Over-ordered models have spurious modes near the Nyquist frequency, often on the negative real axis.
        "static" replaces such modes by their static gain (zoh only), which lowers the order; "raise" refuses.

    Raises
    ------
    InputError
        No sampling time; a pole on the negative real axis or at zero, which no hold-equivalent continuous
        model of the same order has (zoh); a pole at -1 (tustin); a pole so near the negative axis that its
        frequency is the Nyquist frequency to rounding.
    """
    m = as_matrices(system, "system", dt)
    if m.dt <= 0:
        raise InputError(
            "d2c needs a discrete system with a sampling time; pass dt= in seconds with plain matrices"
        )
    if negative_poles not in ("raise", "static"):
        raise InputError(f"negative_poles = {negative_poles!r}; expected 'raise' or 'static'")
    if method == "zoh":
        return to_control(_inverse_hold(_without_negative_modes(m) if negative_poles == "static" else m))
    if method == "tustin":
        return to_control(_inverse_tustin(m))
    raise InputError(f"method = {method!r}; expected 'zoh' or 'tustin'")


def c2d(system, dt: float) -> control.StateSpace:
    """Zero-order-hold equivalent of a continuous system at the sampling time ``dt``, seconds."""
    m = as_matrices(system)
    if m.dt:
        raise InputError(f"the system is discrete already (dt = {m.dt} s)")
    if not dt > 0:
        raise InputError(f"dt = {dt}; expected a positive sampling time in seconds")
    block = scipy.linalg.expm(_hold_block(m.A, m.B) * dt)
    n = m.order
    return to_control(Matrices(block[:n, :n], block[:n, n:], m.C, m.D, float(dt)))


def _hold_block(A, B):
    n, nu = B.shape
    return np.block([[A, B], [np.zeros((nu, n + nu))]])


def _inverse_hold(m: Matrices) -> Matrices:
    if not m.order:
        return Matrices(m.A, m.B, m.C, m.D)
    poles = m.poles
    size = np.abs(poles)
    advice = (
        "; pass negative_poles='static', reduce the order (balance(..., order=)), identify with another "
        "order or a "
        "shorter sampling time, or use tustin"
    )
    if size.min() < 1e-10 * max(1.0, size.max()):
        raise InputError(
            f"a pole at zero ({size.min():.1e}) is a pure delay and has no continuous counterpart" + advice
        )
    angle = np.abs(np.angle(poles))
    if np.any(angle > np.pi - 1e-6):
        worst = poles[np.argmax(angle)]
        raise InputError(
            f"the pole {worst:.6g} lies on the negative real axis, at the Nyquist frequency: the hold has "
            "no real inverse" + advice
        )
    n, nu = m.B.shape
    block = np.block([[m.A, m.B], [np.zeros((nu, n)), np.eye(nu)]])
    log = scipy.linalg.logm(block)
    if np.abs(np.imag(log)).max() > 1e-8 * np.abs(log).max():
        raise InputError("the matrix logarithm of the model is not real" + advice)
    log = np.real(log) / m.dt
    back = scipy.linalg.expm(log * m.dt)
    if np.abs(back - block).max() > 1e-6 * max(1.0, np.abs(block).max()):
        raise InputError(
            "the matrix logarithm of the model is inaccurate: the model is too ill-conditioned" + advice
        )
    return Matrices(log[:n, :n], log[:n, n:], m.C, m.D)


def _without_negative_modes(m: Matrices) -> Matrices:
    """The model without its modes on the negative real axis, their static gain moved into D."""

    def on_axis(real, imag=0.0):
        return bool(real < 0 and abs(imag) <= 1e-6 * abs(real))

    T, Z, kept = scipy.linalg.schur(
        m.A, sort=lambda x, y=0.0: not on_axis(np.real(x), np.imag(x) + np.real(y))
    )
    if kept == m.order:
        return m
    # Decouple the two blocks: T11 X - X T22 = -T12, then the modes are the rows after ``kept``.
    X = scipy.linalg.solve_sylvester(T[:kept, :kept], -T[kept:, kept:], -T[:kept, kept:])
    B, C = Z.T @ m.B, m.C @ Z
    lost_a, lost_b, lost_c = T[kept:, kept:], B[kept:], C[:, kept:] + C[:, :kept] @ X
    D = m.D + lost_c @ np.linalg.solve(np.eye(len(lost_a)) - lost_a, lost_b)
    return Matrices(T[:kept, :kept], B[:kept] - X @ lost_b, C[:, :kept], D, m.dt)


def _inverse_tustin(m: Matrices) -> Matrices:
    plus = m.A + np.eye(m.order)
    if m.order and np.linalg.cond(plus) > 1e12:
        raise InputError("a pole at -1 maps to infinity under Tustin; reduce the order of the model first")
    inverse = np.linalg.inv(plus)
    factor = 2.0 / np.sqrt(m.dt)
    return Matrices(
        2.0 / m.dt * inverse @ (m.A - np.eye(m.order)),
        factor * inverse @ m.B,
        factor * m.C @ inverse,
        m.D - m.C @ inverse @ m.B,
    )
