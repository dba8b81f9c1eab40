"""The sampled controllers of the backlash bench, the plant as a user would simulate it, and a loop around
any plant.

The controllers are those of Yamada, Ruderman and Fujimoto, equations 20-23, discretised by Tustin's rule
(section IV). How ω_M and ω_L are obtained is not published; here they are backward differences of the two
angle readings.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import control
import numpy as np
from numba import njit

from pwaid.errors import InputError
from pwaid.systems.yamada2018 import DAMPINGS, K_B, PDGains, TwoInertia, pd_gains

__all__ = ["LoopController", "control_step", "nominal_simulator", "read_encoder", "run_loop"]

STATES = ("theta_M", "omega_M", "theta_L", "omega_L")


@dataclass(frozen=True)
class LoopController:
    """The sampled controller: filtered reference, PD on θ_L, and damping; Tustin at `rate`.

    Attributes
    ----------
    kind : {"none", "linear", "switched"}
    gains : PDGains
    gain : float
        K_B, N m s/rad.
    rate : float
        Samples per second.
    reference_cutoff_hz : float
        Low-pass filter of the reference.
    """

    kind: str = "switched"
    gains: PDGains = field(default_factory=pd_gains)
    gain: float = K_B
    rate: float = 2500.0
    reference_cutoff_hz: float = 20.0

    def __post_init__(self):
        if self.kind not in DAMPINGS:
            raise InputError(f"damping kind {self.kind!r}; expected one of {DAMPINGS}")
        if self.rate <= 0 or self.reference_cutoff_hz <= 0:
            raise InputError(f"rate {self.rate} and cut-off {self.reference_cutoff_hz} must be positive, in "
                             "Hz")

    def start(self, theta_M: float = 0.0, theta_L: float = 0.0) -> np.ndarray:
        """State of the controller at rest: filtered reference, its input, PD filter, error, last angles."""
        return np.array([theta_L, theta_L, 0.0, 0.0, theta_M, theta_L])

    def coefficients(self) -> np.ndarray:
        """What `control_step` needs: Tustin coefficients of both filters, gains, kind, rate."""
        h, w, tau = 1 / self.rate, 2 * np.pi * self.reference_cutoff_hz, self.gains.tau_D
        return np.array([
            (2 - w * h) / (2 + w * h), w * h / (2 + w * h), (2 * tau - h) / (2 * tau + h), h / (2 * tau + h),
            self.gains.K_P, self.gains.K_D / tau, 0.0 if self.kind == "none" else self.gain,
            float(self.kind == "switched"), self.rate,
        ])  # fmt: skip

    def step(self, state, reference: float, theta_M: float, theta_L: float) -> tuple[np.ndarray, float]:
        """One sample: new state and the torque to hold until the next."""
        state = np.array(state, dtype=float)
        torque = control_step(state, self.coefficients(), reference, theta_M, theta_L)
        return state, torque


@njit(cache=True)
def control_step(state, k, reference, theta_M, theta_L):
    """Motor torque of one sample; `state` is changed in place."""
    state[0] = k[0] * state[0] + k[1] * (reference + state[1])
    state[1] = reference
    error = state[0] - theta_L
    state[2] = k[2] * state[2] + k[3] * (error + state[3])
    state[3] = error
    omega_M, omega_L = (theta_M - state[4]) * k[8], (theta_L - state[5]) * k[8]
    state[4], state[5] = theta_M, theta_L
    omega_B = omega_M - omega_L
    gain = k[6]
    if k[7] > 0 and omega_B * omega_L < 0:
        gain = 0.0
    return k[4] * error + k[5] * (error - state[2]) + gain * omega_B


def read_encoder(angle, quantum: float):
    """Angle(s) rounded down to a multiple of the quantum (rad); as they are when it is 0."""
    return angle.copy() if quantum == 0 else np.floor(angle / quantum) * quantum


def nominal_simulator(parameters: TwoInertia | None = None, name: str = "drive_without_friction"):
    """The drive without dry friction as a user would write it: T_M → theta_M, theta_L, T_s.

    Returns
    -------
    control.NonlinearIOSystem
        States theta_M, omega_M, theta_L, omega_L; ``params`` holds J_M, D_M, K, D_B, J_L, D_L, beta.
    """
    defaults = asdict(TwoInertia() if parameters is None else parameters)

    def joint(x, p):
        twist = x[0] - x[2]
        if abs(twist) < p["beta"]:
            return 0.0
        return p["D_B"] * (x[1] - x[3]) + p["K"] * (twist - np.copysign(p["beta"], twist))

    def update(t, x, u, params):
        p = {**defaults, **params}
        T_s = joint(x, p)
        return np.array([x[1], (np.ravel(u)[0] - T_s - p["D_M"] * x[1]) / p["J_M"],
                         x[3], (T_s - p["D_L"] * x[3]) / p["J_L"]])  # fmt: skip

    def output(t, x, u, params):
        return np.array([x[0], x[2], joint(x, {**defaults, **params})])

    return control.nlsys(update, output, states=list(STATES), inputs=["T_M"],
                         outputs=["theta_M", "theta_L", "T_s"],
                         params=defaults, name=name)  # fmt: skip


def run_loop(plant, controller: LoopController, reference, x0=None, *, substeps: int = 20,
             quantum: float = 0.0,
             params: dict | None = None):  # fmt: skip
    """Close the bench's loop around any plant; fixed-step Runge–Kutta of order 4 between control samples.

    Parameters
    ----------
    plant : control.NonlinearIOSystem or (rhs, output)
        Input T_M; the first two outputs are theta_M and theta_L. Functions are ``rhs(t, x, u)`` and
        ``output(t, x, u)`` with u of shape (1,); continuous-time.
    controller : LoopController
    reference : array_like (N,)
        rad, one value per control sample.
    x0 : array_like (n,), optional
    substeps : int
        Steps per control sample.
    quantum : float
        Encoder resolution of the controller's readings, rad; 0 for none.
    params : dict, optional
        For a python-control plant.

    Returns
    -------
    time, T_M, outputs : ndarray (N,), (N,), (N, p)
    """
    if isinstance(plant, control.NonlinearIOSystem):
        rhs = lambda t, x, u: plant.dynamics(t, x, u, params)  # noqa: E731
        output = lambda t, x, u: plant.output(t, x, u, params)  # noqa: E731
        n = plant.nstates
    else:
        rhs, output = plant
        n = None
    if x0 is None and n is None:
        raise InputError("a plant given as functions needs x0, one value per state")
    x = np.zeros(n) if x0 is None else np.array(x0, dtype=float)
    reference = np.asarray(reference, dtype=float)
    if reference.ndim != 1 or not np.isfinite(reference).all():
        raise InputError(f"reference has shape {reference.shape}; expected finite values (N,), one per "
                         "control sample")
    h, u = 1.0 / (controller.rate * substeps), np.zeros(1)
    first = np.ravel(output(0.0, x, u))
    state, torques, outputs = controller.start(first[0], first[1]), [], []
    for k, r in enumerate(reference):
        t, y = k / controller.rate, np.ravel(output(k / controller.rate, x, u))
        state, torque = controller.step(state, r, *read_encoder(y[:2], quantum))
        u = np.array([torque])
        torques.append(torque)
        outputs.append(np.ravel(output(t, x, u)))
        for j in range(substeps):
            x = _runge_kutta(rhs, t + j * h, x, u, h)
        if not np.isfinite(x).all() or np.abs(x).max() > 1e9:
            raise InputError(f"the loop diverged at t = {t:.4g} s; check the plant's signs, or raise "
                             "substeps")
    return np.arange(reference.size) / controller.rate, np.array(torques), np.array(outputs)


def _runge_kutta(rhs, t, x, u, h):
    k1 = np.ravel(rhs(t, x, u))
    k2 = np.ravel(rhs(t + h / 2, x + h / 2 * k1, u))
    k3 = np.ravel(rhs(t + h / 2, x + h / 2 * k2, u))
    k4 = np.ravel(rhs(t + h, x + h * k3, u))
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
