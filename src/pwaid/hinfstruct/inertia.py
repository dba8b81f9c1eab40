"""Flexible arms with velocity loops: the physics-structured LPV model M(kappa) = M0 + kappa M1, kappa =
cos(angle).

    M(kappa) ddq + h(q, dq) + [0; K v] = [Lambda (reference - dtheta); 0],   q = (theta, v),   y = C1 dq

with states x = (v, dtheta, dv) as in Vizer et al. (2014), eq. (31) with its sign corrected. Frozen at one
kappa, h vanishes and the model is linear with free entries in one block, eq. (32). While the angle moves,
Lagrange's equations give h from M1 alone (alpha is the scheduling joint):

    h = -sin(angle) dalpha M1 dq + e_alpha (1/2) sin(angle) dq' M1 dq        (Coriolis and centrifugal torque)

so local experiments, which cannot show h, nevertheless identify everything it needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import control
import numba
import numpy as np

from pwaid.errors import InputError
from pwaid.hinfstruct.simulate import check_trajectory
from pwaid.hinfstruct.statespace import Matrices, freeze, initial_state, to_control
from pwaid.hinfstruct.structured import Parameter, StructuredModel

__all__ = ["InertiaLPV", "InertiaStructure"]


@dataclass(frozen=True)
class InertiaLPV:
    """Mass matrix M0 + kappa M1 with springs and velocity loops.

    Attributes
    ----------
    M0, M1 : arrays, shape (n, n), symmetric
        n = joints + springs; joints come first in q.
    stiffness : array, shape (springs,)
    gains : array, shape (joints,)
        Velocity-loop gains. Multiplying M0, M1, stiffness and gains by one number changes nothing but the
        torque unit.
    output : array, shape (outputs, n)
        C1 of y = C1 dq.
    joint : int
        Index of the scheduling joint in q, default 1.
    """

    M0: np.ndarray
    M1: np.ndarray
    stiffness: np.ndarray
    gains: np.ndarray
    output: np.ndarray
    joint: int = 1

    def __post_init__(self):
        for name in ("M0", "M1", "stiffness", "gains", "output"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=float))
            if not np.isfinite(getattr(self, name)).all():
                raise InputError(f"{name} contains NaN or infinite values; give finite numbers")
        freeze(self)
        n = self.gains.size + self.stiffness.size
        if self.M0.shape != (n, n) or self.M1.shape != (n, n) or self.output.shape[1:] != (n,):
            raise InputError(
                f"M0 {self.M0.shape}, M1 {self.M1.shape}, output {self.output.shape}: expected ({n}, {n}) "
                "twice and "
                f"(outputs, {n}) for {self.gains.size} joints and {self.stiffness.size} springs"
            )

    @property
    def order(self) -> int:
        return 2 * self.stiffness.size + self.gains.size

    def theta(self, kappa: float) -> np.ndarray:
        """The free entries of (32) at kappa, column by column: [-M^-1 [0; K], -M^-1 [Lambda; 0]]."""
        nv = self.stiffness.size
        return self.matrices(kappa).A[nv:, : self.gains.size + nv].ravel(order="F")

    def matrices(self, kappa: float) -> Matrices:
        """(A, B, C, D) frozen at kappa."""
        A, B, C, D = _assemble(self.M0 + kappa * self.M1, self.stiffness, self.gains, self.output)
        return Matrices(A, B, C, D)

    def stacked(self, kappa) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A, B, C, D stacked along axis 0 for an array of kappa."""
        parts = [self.matrices(k) for k in np.ravel(kappa)]
        return tuple(np.stack([p[i] for p in parts]) for i in range(4))

    def frozen(self, kappa: float) -> control.StateSpace:
        """`control.StateSpace` at kappa, with named states."""
        nj, nv = self.gains.size, self.stiffness.size
        states = [f"v{i + 1}" for i in range(nv)] + [
            f"dtheta{i + 1}" for i in range(nj)
        ] + [f"dv{i + 1}" for i in range(nv)]
        return to_control(self.matrices(kappa), states=states)

    def pattern(self) -> StructuredModel:
        """The structure (32): known zeros and ones, free entries th1, th2, ..., B tied to A, C known."""
        nj, nv = self.gains.size, self.stiffness.size
        n = nj + nv
        name = [[f"th{1 + i + j * n}" for j in range(n)] for i in range(n)]
        A = [[0.0] * n + [float(i == j) for j in range(nv)] for i in range(nv)]
        A += [name[i] + [0.0] * nv for i in range(n)]
        B = [[0.0] * nj for _ in range(nv)] + [[f"-{name[i][nv + j]}" for j in range(nj)] for i in range(n)]
        C = np.hstack([np.zeros((len(self.output), nv)), self.output]).tolist()
        return StructuredModel.from_pattern(
            A, B, C, parameters=[Parameter(f"th{k + 1}") for k in range(n * n)]
        )

    def simulate(self, time, inputs, angle, *, coriolis: bool = False, x0=None) -> np.ndarray:
        """Outputs (N, outputs) along a measured trajectory of the scheduling angle (rad), inputs held between
        samples.

        ``coriolis`` adds the velocity forces. Runge-Kutta 4 with the sampling step, the angle interpolated
        linearly.
        """
        time, inputs, angle = check_trajectory(time, inputs, angle, self.gains.size, "angle")
        dt = time[1] - time[0]
        fastest = max(
            np.abs(self.matrices(k).poles).max() for k in (np.cos(angle).min(), np.cos(angle).max())
        )
        if fastest * dt > 2.5:
            raise InputError(
                f"the step {dt:.3g} s is too long for a pole of {fastest:.3g} rad/s; "
                f"sample at {1.5 / fastest:.1e} s or faster"
            )
        x0 = initial_state(x0, self.order)
        fine = np.interp(np.arange(2 * time.size - 1) / 2, np.arange(time.size), angle)
        inverse = np.linalg.inv(self.M0 + np.cos(fine)[:, None, None] * self.M1)
        sine = np.sin(fine) if coriolis else np.zeros(fine.size)
        states = _simulate(inverse, self.M1, self.stiffness, self.gains, self.joint, inputs, sine, dt, x0)
        return states[:, self.stiffness.size :] @ self.output.T

    def to_nlsys(
        self, *, coriolis: bool = False, scheduling: str = "input", name: str = "inertia_lpv", **params
    ) -> control.NonlinearIOSystem:
        """`control.nlsys`: inputs dtheta1_ref, ... (and the angle, if scheduling="input"); outputs y1, ...

        scheduling="state" makes the angle the last state, integrated from its joint's rate.
        """
        if scheduling not in ("input", "state"):
            raise InputError(f"scheduling = {scheduling!r}; expected 'input' or 'state'")
        nj, nv, j = self.gains.size, self.stiffness.size, self.joint
        angle_name = f"theta{j + 1}"
        states = [f"v{i + 1}" for i in range(nv)] + [
            f"dtheta{i + 1}" for i in range(nj)
        ] + [f"dv{i + 1}" for i in range(nv)]
        inputs = [f"dtheta{i + 1}_ref" for i in range(nj)]
        (states if scheduling == "state" else inputs).append(angle_name)

        def update(t, x, u, params):
            angle = float(x[-1] if scheduling == "state" else u[-1])
            inverse = np.linalg.inv(self.M0 + np.cos(angle) * self.M1)
            sine = np.sin(angle) if coriolis else 0.0
            core, reference = np.array(x[: self.order], dtype=float), np.array(u[:nj], dtype=float)
            rate = np.empty(self.order)
            _rates(inverse, self.M1, self.stiffness, self.gains, j, core, reference, sine, rate)
            return np.append(rate, x[nv + j]) if scheduling == "state" else rate

        return control.nlsys(
            update,
            lambda t, x, u, params: self.output @ x[nv : self.order],
            inputs=inputs,
            states=states,
            outputs=[f"y{i + 1}" for i in range(len(self.output))],
            name=name,
            params=params,
        )


@dataclass(frozen=True)
class InertiaStructure:
    """The parameters of an `InertiaLPV` to be identified jointly from all operating points.

    Free: the upper triangle of M0, the entries of M1 that ``coupling`` allows, the stiffnesses, and all gains
    but the first, which sets the torque unit (20 numbers for the two-link arm, against 16 per operating
    point).

    Attributes
    ----------
    coupling : bool array, shape (n, n), symmetric
        Where M1 may be non-zero.
    output : array, shape (outputs, n)
    joints : int
    first_gain : float
        The known or assumed first velocity gain.
    joint : int
        Scheduling joint.
    """

    coupling: np.ndarray
    output: np.ndarray
    joints: int
    first_gain: float = 1.0
    joint: int = 1

    @property
    def size(self) -> int:
        return self._basis()[0].shape[0]

    def _basis(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Linear maps from p to M0, M1, stiffness, gains (without the fixed first gain), parameter along axis
        0.
        """
        n = self.output.shape[1]
        upper = list(zip(*np.triu_indices(n), strict=True))
        coupled = [(i, j) for i, j in upper if self.coupling[i, j]]
        springs = n - self.joints
        total = len(upper) + len(coupled) + springs + self.joints - 1
        M0, M1 = np.zeros((total, n, n)), np.zeros((total, n, n))
        k = 0
        for matrix, entries in ((M0, upper), (M1, coupled)):
            for i, j in entries:
                matrix[k, i, j] = matrix[k, j, i] = 1.0
                k += 1
        stiffness, gains = np.zeros((total, springs)), np.zeros((total, self.joints))
        stiffness[k + np.arange(springs), np.arange(springs)] = 1.0
        gains[k + springs + np.arange(self.joints - 1), 1 + np.arange(self.joints - 1)] = 1.0
        return M0, M1, stiffness, gains

    @property
    def names(self) -> tuple[str, ...]:
        n = self.output.shape[1]
        upper = list(zip(*np.triu_indices(n), strict=True))
        return (
            *(f"M0_{i + 1}{j + 1}" for i, j in upper),
            *(f"M1_{i + 1}{j + 1}" for i, j in upper if self.coupling[i, j]),
            *(f"k{i + 1}" for i in range(n - self.joints)),
            *(f"gain{i + 1}" for i in range(1, self.joints)),
        )

    def pack(self, model: InertiaLPV) -> np.ndarray:
        """Parameter vector of a model, in the torque unit of ``first_gain``."""
        unit = self.first_gain / model.gains[0]
        upper = np.triu_indices(self.output.shape[1])
        coupled = self.coupling[upper]
        return unit * np.concatenate(
            [model.M0[upper], model.M1[upper][coupled], model.stiffness, model.gains[1:]]
        )

    def unpack(self, p) -> InertiaLPV:
        """The model with parameter vector p."""
        M0, M1, stiffness, gains = (np.tensordot(np.asarray(p, dtype=float), b, 1) for b in self._basis())
        gains[0] = self.first_gain
        return InertiaLPV(M0, M1, stiffness, gains, self.output, self.joint)

    def structured(self, kappa: float) -> StructuredModel:
        """The structured model at one kappa; models of several kappa share the parameter vector."""
        dM0, dM1, dK, dL = self._basis()
        dM = dM0 + kappa * dM1

        def evaluate(p):
            model = self.unpack(p)
            return _assemble(model.M0 + kappa * model.M1, model.stiffness, model.gains, self.output)

        def differentiate(p):
            model = self.unpack(p)
            nv, nj = model.stiffness.size, self.joints
            inverse = np.linalg.inv(model.M0 + kappa * model.M1)
            T = np.hstack([-inverse[:, nj:] * model.stiffness, -inverse[:, :nj] * model.gains])
            dT = -inverse @ dM @ T
            dT[:, :, :nv] -= inverse[:, nj:] * dK[:, None, :]
            dT[:, :, nv:] -= inverse[:, :nj] * dL[:, None, :]
            return _spread(dT, nv, nj, len(self.output))

        return StructuredModel(tuple(Parameter(name) for name in self.names), evaluate, differentiate)

    def start(self, kappas: Sequence[float], thetas: Sequence[np.ndarray]) -> np.ndarray:
        """Parameters from local theta vectors of (32), in closed form.

        M(kappa_i) T_i + [[0, Lambda], [K, 0]] = 0 is linear in all unknowns once the first gain is fixed.

        Raises
        ------
        InputError
            Too few operating points for the number of unknowns (two kappa values at least), or shapes that do
            not fit.
        """
        n, nj = self.output.shape[1], self.joints
        nv = n - nj
        if len(kappas) != len(thetas) or len(set(np.round(kappas, 12))) < 2:
            raise InputError("start needs one theta per kappa, and at least two different kappa values")
        dM0, dM1, dK, dL = self._basis()
        rows, right = [], []
        columns = np.mean([np.linalg.norm(np.reshape(t, (n, n), order="F"), axis=0) for t in thetas], axis=0)
        for kappa, theta in zip(kappas, thetas, strict=True):
            T = np.reshape(np.asarray(theta, dtype=float), (n, n), order="F")
            block = (dM0 + kappa * dM1) @ T
            block[:, nj + np.arange(nv), np.arange(nv)] += dK
            block[:, np.arange(nj), nv + np.arange(nj)] += dL
            constant = np.zeros((n, n))
            constant[0, nv] = self.first_gain
            rows.append((block / columns).reshape(self.size, -1).T)
            right.append(-(constant / columns).ravel())
        return np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]


def _assemble(M, stiffness, gains, output):
    nj, nv = gains.size, stiffness.size
    inverse = np.linalg.inv(M)
    T = np.hstack([-inverse[:, nj:] * stiffness, -inverse[:, :nj] * gains])
    A, B, C, D = (block[0] for block in _spread(T[None], nv, nj, len(output)))
    A[:nv, nj + nv :] = np.eye(nv)
    C[:, nv:] = output
    return A, B, C, D


def _spread(T, nv, nj, ny):
    """Place blocks T (k, n, n) into A and B of (32); C and D are zero."""
    k, n, _ = T.shape
    A, B = np.zeros((k, n + nv, n + nv)), np.zeros((k, n + nv, nj))
    A[:, nv:, :n] = T
    B[:, nv:] = -T[:, :, nv:]
    return A, B, np.zeros((k, ny, n + nv)), np.zeros((k, ny, nj))


@numba.njit(cache=True)
def _rates(inverse, M1, stiffness, gains, joint, x, reference, sine, out):
    """dx/dt of x = (v, dtheta, dv) into ``out``; ``sine`` is sin(angle), or 0 for the frozen model."""
    nv, nj = stiffness.size, gains.size
    n = nv + nj
    energy = 0.0
    for i in range(n):
        momentum = 0.0
        for j in range(n):
            momentum += M1[i, j] * x[nv + j]
        energy += x[nv + i] * momentum
        force = sine * x[nv + joint] * momentum
        if i < nj:
            force += gains[i] * (reference[i] - x[nv + i])
        else:
            force -= stiffness[i - nj] * x[i - nj]
        out[nv + i] = force
    out[nv + joint] -= 0.5 * sine * energy
    force = out[nv:].copy()
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += inverse[i, j] * force[j]
        out[nv + i] = total
    for i in range(nv):
        out[i] = x[nv + nj + i]


@numba.njit(cache=True)
def _simulate(inverse, M1, stiffness, gains, joint, inputs, sine, dt, x0):
    """States (N, n); ``inverse`` and ``sine`` are given at the samples and half-way between them."""
    n, size = inputs.shape[0], x0.size
    states = np.empty((n, size))
    slopes = np.empty((4, size))
    x, mid = x0.copy(), np.empty(size)
    reach = (0.5, 0.5, 1.0)
    at = (0, 1, 1, 2)
    for k in range(n):
        for i in range(size):
            states[k, i] = x[i]
            mid[i] = x[i]
        if k == n - 1:
            break
        for stage in range(4):
            t = 2 * k + at[stage]
            _rates(inverse[t], M1, stiffness, gains, joint, mid, inputs[k], sine[t], slopes[stage])
            if stage < 3:
                for i in range(size):
                    mid[i] = x[i] + reach[stage] * dt * slopes[stage, i]
        for i in range(size):
            x[i] += dt / 6.0 * (slopes[0, i] + 2.0 * slopes[1, i] + 2.0 * slopes[2, i] + slopes[3, i])
    return states
