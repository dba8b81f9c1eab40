"""Equations of motion of a planar arm with two flexible links, compiled: mass matrix, velocity forces,
outputs.

Vizer, Mercère, Prot & Laroche (2014), section 3.2: each link bends in one assumed shape, delta_k(x, t) = x²
v_k(t), with the foreshortening (2/3) x³ v_k² (the printed (28) has v³, a misprint). With complex numbers for
the plane,

    p(x) = e^{i theta1} (a + e^{i phi} b(x)),   a = l1 - (2/3) l1³ v1² + i l1² v1,
    b(x) = x - (2/3) x³ v2² + i x² v2,          phi = theta2 + 2 l1 v1,

and every mass point contributes Re(J* J) to the mass matrix and Re(J* a_v) to the velocity forces, where J
holds the partial derivatives of p and a_v is the part of its acceleration that is quadratic in the velocities
(Coriolis and centrifugal). The integrals over the links are polynomials of degree six in x, so four Gauss
points are exact.

Coordinates: q = (theta1, theta2, v1, v2). The packed parameter vector ``p`` holds
(l1, l2, rho1, rho2, m_elbow, J_elbow, m_tip, J_tip, Jr1, Jr2, EI1, EI2, gain1, gain2).
"""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["integrate", "joint_rates", "mass_and_forces"]

_GAUSS_X, _GAUSS_W = np.polynomial.legendre.leggauss(4)
GAUSS_X = 0.5 * (_GAUSS_X + 1.0)  # nodes and weights on [0, 1]
GAUSS_W = 0.5 * _GAUSS_W


@numba.njit(cache=True)
def _add_point(mass, columns, bias, M, h):
    """Add one mass point: M += m Re(J* J), h += m Re(J* a_v)."""
    for i in range(4):
        h[i] += mass * (columns[i].conjugate() * bias).real
        for j in range(4):
            M[i, j] += mass * (columns[i].conjugate() * columns[j]).real


@numba.njit(cache=True)
def mass_and_forces(q, dq, p, M, h):
    """Fill the mass matrix M (4, 4) and the velocity forces h (4,) of M ddq + h = generalised forces."""
    l1, l2 = p[0], p[1]
    rho1, rho2, m_elbow, j_elbow, m_tip, j_tip, jr1, jr2 = p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9]
    v1, v2, w1, dv1, dv2 = q[2], q[3], dq[0], dq[2], dq[3]
    M[:, :] = 0.0
    h[:] = 0.0
    columns = np.zeros(4, dtype=np.complex128)

    # Link 1 and the elbow body: points a(x) in the frame of joint 1.
    for k in range(5):
        x = l1 * GAUSS_X[k] if k < 4 else l1
        mass = rho1 * l1 * GAUSS_W[k] if k < 4 else m_elbow
        a = complex(x - 2.0 / 3.0 * x**3 * v1 * v1, x * x * v1)
        da = complex(-4.0 / 3.0 * x**3 * v1, x * x)
        dda = complex(-4.0 / 3.0 * x**3, 0.0)
        columns[0], columns[1], columns[2], columns[3] = 1j * a, 0.0, da, 0.0
        _add_point(mass, columns, 2j * w1 * da * dv1 + dda * dv1 * dv1 - w1 * w1 * a, M, h)

    # Link 2 and the tip body: a(l1) + e^{i phi} b(x).
    a = complex(l1 - 2.0 / 3.0 * l1**3 * v1 * v1, l1 * l1 * v1)
    da = complex(-4.0 / 3.0 * l1**3 * v1, l1 * l1)
    dda = complex(-4.0 / 3.0 * l1**3, 0.0)
    phi = q[1] + 2.0 * l1 * v1
    turn = complex(np.cos(phi), np.sin(phi))
    wp = w1 + dq[1] + 2.0 * l1 * dv1
    base_bias = 2j * w1 * da * dv1 + dda * dv1 * dv1 - w1 * w1 * a
    for k in range(5):
        x = l2 * GAUSS_X[k] if k < 4 else l2
        mass = rho2 * l2 * GAUSS_W[k] if k < 4 else m_tip
        b = turn * complex(x - 2.0 / 3.0 * x**3 * v2 * v2, x * x * v2)
        db = turn * complex(-4.0 / 3.0 * x**3 * v2, x * x)
        ddb = turn * complex(-4.0 / 3.0 * x**3, 0.0)
        columns[0], columns[1], columns[2], columns[3] = 1j * (a + b), 1j * b, da + 2j * l1 * b, db
        _add_point(mass, columns, base_bias + 2j * wp * db * dv2 + ddb * dv2 * dv2 - wp * wp * b, M, h)

    # Rotary inertias: their angles are linear in q, so they bring no velocity forces.
    elbow = (1.0, 0.0, 2.0 * l1, 0.0)
    tip = (1.0, 1.0, 2.0 * l1, 2.0 * l2)
    for i in range(4):
        for j in range(4):
            M[i, j] += j_elbow * elbow[i] * elbow[j] + j_tip * tip[i] * tip[j]
    M[0, 0] += jr1
    M[1, 1] += jr2


@numba.njit(cache=True, error_model="numpy")
def _acceleration(q, dq, reference, p, M, h, out):
    """ddq under the inner velocity loop (29): torque = gain (reference - dtheta); springs 4 EI l on v.

    Solved by a Cholesky factorisation in place; a state that diverged gives NaN.
    """
    mass_and_forces(q, dq, p, M, h)
    for i in range(4):
        out[i] = -h[i]
    out[0] += p[12] * (reference[0] - dq[0])
    out[1] += p[13] * (reference[1] - dq[1])
    out[2] -= 4.0 * p[10] * p[0] * q[2]
    out[3] -= 4.0 * p[11] * p[1] * q[3]
    for j in range(4):
        for k in range(j):
            M[j, j] -= M[j, k] * M[j, k]
        M[j, j] = np.sqrt(M[j, j])
        for i in range(j + 1, 4):
            for k in range(j):
                M[i, j] -= M[i, k] * M[j, k]
            M[i, j] /= M[j, j]
    for i in range(4):
        for k in range(i):
            out[i] -= M[i, k] * out[k]
        out[i] /= M[i, i]
    for i in range(3, -1, -1):
        for k in range(i + 1, 4):
            out[i] -= M[k, i] * out[k]
        out[i] /= M[i, i]


@numba.njit(cache=True, error_model="numpy")
def integrate(references, dt, substeps, q0, dq0, p):
    """Runge-Kutta 4 with held references (N, 2); returns q and dq at the N sample times, each (N, 4)."""
    n = references.shape[0]
    q_out = np.empty((n, 4))
    dq_out = np.empty((n, 4))
    q, dq = q0.copy(), dq0.copy()
    q_mid, dq_mid = np.empty(4), np.empty(4)
    M, h = np.empty((4, 4)), np.empty(4)
    slopes, speeds = np.empty((4, 4)), np.empty((4, 4))  # ddq and dq of the four stages
    reach = (0.5, 0.5, 1.0)
    step = dt / substeps
    for k in range(n):
        for i in range(4):
            q_out[k, i], dq_out[k, i] = q[i], dq[i]
        for _ in range(substeps):
            for i in range(4):
                q_mid[i], dq_mid[i] = q[i], dq[i]
            for stage in range(4):
                _acceleration(q_mid, dq_mid, references[k], p, M, h, slopes[stage])
                for i in range(4):
                    speeds[stage, i] = dq_mid[i]
                if stage < 3:
                    for i in range(4):
                        q_mid[i] = q[i] + reach[stage] * step * speeds[stage, i]
                        dq_mid[i] = dq[i] + reach[stage] * step * slopes[stage, i]
            for i in range(4):
                q[i] += step / 6.0 * (speeds[0, i] + 2.0 * speeds[1, i] + 2.0 * speeds[2, i] + speeds[3, i])
                dq[i] += step / 6.0 * (slopes[0, i] + 2.0 * slopes[1, i] + 2.0 * slopes[2, i] + slopes[3, i])
    return q_out, dq_out


def joint_rates(q: np.ndarray, dq: np.ndarray, lengths: tuple[float, float]) -> np.ndarray:
    """Joint velocities (N, 2) of the rigid arm with the same tip position and velocity (inverse kinematics).

    The elbow bends towards the side of ``theta2``; at theta2 = 0 or pi the rigid arm is singular and the
    rates diverge.
    """
    l1, l2 = lengths
    v1, v2 = q[:, 2], q[:, 3]
    phi = q[:, 1] + 2 * l1 * v1
    turn = np.exp(1j * phi)
    a = l1 - 2 / 3 * l1**3 * v1**2 + 1j * l1**2 * v1
    da = -4 / 3 * l1**3 * v1 + 1j * l1**2
    b = turn * (l2 - 2 / 3 * l2**3 * v2**2 + 1j * l2**2 * v2)
    db = turn * (-4 / 3 * l2**3 * v2 + 1j * l2**2)
    tip = a + b
    rate = 1j * dq[:, 0] * a + da * dq[:, 2] + 1j * (
        dq[:, 0] + dq[:, 1] + 2 * l1 * dq[:, 2]
    ) * b + db * dq[:, 3]
    # Angles measured in the frame of joint 1 (it only adds dtheta1, already in ``rate``).
    cos_beta = np.clip((np.abs(tip) ** 2 - l1**2 - l2**2) / (2 * l1 * l2), -1.0, 1.0)
    beta = np.copysign(np.arccos(cos_beta), np.sin(q[:, 1]))
    alpha = np.angle(tip) - np.angle(l1 + l2 * np.exp(1j * beta))
    e1, e12 = 1j * l1 * np.exp(1j * alpha), 1j * l2 * np.exp(1j * (alpha + beta))
    # rate = alpha_dot (e1 + e12) + beta_dot e12, two real equations for the two rates.
    c1 = e1 + e12
    det = c1.real * e12.imag - c1.imag * e12.real
    return np.column_stack(
        [
            (rate.real * e12.imag - rate.imag * e12.real) / det,
            (c1.real * rate.imag - c1.imag * rate.real) / det,
        ]
    )
