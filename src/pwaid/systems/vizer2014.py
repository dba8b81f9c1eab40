"""Planar two-link flexible arm with inner joint-velocity loops (Vizer, Mercère, Prot & Laroche 2014, section
3).

The paper's parameters are in an unpublished report; `FlexibleArmParameters` holds a set of the same kind (a
light 0.35 m + 0.35 m arm whose flexible modes limit the bandwidth). Inputs are joint velocity references,
outputs the joint velocities of the rigid arm of the same geometry. `vizer2014_flexible_arm` simulates the
nonlinear arm, `vizer2014_flexible_arm_linear` is its exact linearisation (31), corrected, and
`vizer2014_flexible_arm_model` the LPV model frozen in kappa = cos(theta2), with or without the Coriolis and
centrifugal torque that freezing leaves out.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import control
import numpy as np

from pwaid.errors import InputError
from pwaid.hinfstruct.inertia import InertiaLPV
from pwaid.hinfstruct.statespace import freeze
from pwaid.systems.vizer2014_dynamics import integrate, joint_rates, mass_and_forces

__all__ = [
    "OPERATING_POINTS",
    "ArmRecording",
    "FlexibleArmParameters",
    "prbs",
    "vizer2014_flexible_arm",
    "vizer2014_flexible_arm_experiment",
    "vizer2014_flexible_arm_linear",
    "vizer2014_flexible_arm_lpv",
    "vizer2014_flexible_arm_model",
    "vizer2014_flexible_arm_structure",
    "vizer2014_flexible_arm_sweep",
]

OPERATING_POINTS = np.pi / 8 * np.arange(1, 8)  # theta2 of the seven local experiments, rad


@dataclass(frozen=True)
class FlexibleArmParameters:
    """Physical parameters, SI units.

    Attributes
    ----------
    l1, l2 : float
        Link lengths, m.
    rho1, rho2 : float
        Mass per length, kg/m.
    m_elbow, j_elbow, m_tip, j_tip : float
        Masses (kg) and rotary inertias (kg m2) at the end of link 1 and at the tip.
    jr1, jr2 : float
        Reflected rotor inertias, kg m2.
    ei1, ei2 : float
        Bending stiffness, N m2; the generalised springs are 4 EI l.
    gain1, gain2 : float
        Velocity-loop gains Lambda of (29), N m s/rad.
    """

    l1: float = 0.35
    l2: float = 0.35
    rho1: float = 3.0
    rho2: float = 1.6
    m_elbow: float = 1.0
    j_elbow: float = 2e-3
    m_tip: float = 0.5
    j_tip: float = 2e-4
    jr1: float = 0.05
    jr2: float = 0.02
    ei1: float = 700.0
    ei2: float = 250.0
    gain1: float = 20.0
    gain2: float = 5.0

    def __post_init__(self):
        for name, value in self.__dict__.items():
            if not (np.isfinite(value) and (value > 0 or (value == 0 and name[0] in "mj"))):
                raise InputError(
                    f"flexible arm: {name} = {value}; expected a finite positive number in SI units"
                )

    @property
    def packed(self) -> np.ndarray:
        """The parameters in the order of the compiled equations."""
        return np.array(astuple(self), dtype=float)


@dataclass(frozen=True)
class ArmRecording:
    """One simulated experiment, all arrays along time.

    Attributes
    ----------
    time : (N,), s
    inputs : (N, 2), joint velocity references, rad/s, held between samples
    outputs : (N, 2), rad/s, noise-free
    q, dq : (N, 4), coordinates (theta1, theta2, v1, v2) and their rates
    """

    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    q: np.ndarray
    dq: np.ndarray

    def __post_init__(self):
        freeze(self)

    @property
    def dt(self) -> float:
        return float(self.time[1] - self.time[0])

    @property
    def theta2(self) -> np.ndarray:
        return self.q[:, 1]

    @property
    def kappa(self) -> np.ndarray:
        """The scheduling variable cos(theta2)."""
        return np.cos(self.q[:, 1])

    def decimate(self, factor: int) -> ArmRecording:
        """Every ``factor``-th sample, unfiltered, as in section 3.3.1."""
        return ArmRecording(*(x[::factor] for x in (self.time, self.inputs, self.outputs, self.q, self.dq)))

    def noisy(self, snr_db: float, rng) -> np.ndarray:
        """Outputs with white Gaussian noise at the given signal-to-noise ratio (footnote 5), shape (N, 2)."""
        rng = np.random.default_rng(rng)
        level = self.outputs.std(axis=0) * 10 ** (-snr_db / 20)
        return self.outputs + level * rng.standard_normal(self.outputs.shape)


def vizer2014_flexible_arm(
    references,
    dt: float,
    theta2: float,
    *,
    parameters: FlexibleArmParameters | None = None,
    outputs: str = "inverse_kinematics",
    substeps: int = 1,
) -> ArmRecording:
    """Simulate the nonlinear arm (26) with its velocity loop (29), starting at rest and undeformed.

    Parameters
    ----------
    references : array, shape (N, 2)
        Joint velocity references, rad/s, held over each step.
    dt : float
        Step, seconds. Runge-Kutta 4 with ``substeps`` steps inside; 1e-4 s and one substep suit the default
        arm.
    theta2 : float
        Initial elbow angle, rad.
    parameters : FlexibleArmParameters, optional
    outputs : "inverse_kinematics" or "linear"
        "inverse_kinematics": joint velocities of the rigid arm with the same tip motion, as measured in the
        paper. "linear": y = C1 dq with the matrix of (31c). Both agree to first order in the deformation.

    Raises
    ------
    InputError
        Bad shapes or numbers, an unknown option, or a simulation that diverged (too large a step).
    """
    p = FlexibleArmParameters() if parameters is None else parameters
    references = np.ascontiguousarray(references, dtype=float)
    if references.ndim != 2 or references.shape[1] != 2 or len(references) < 2:
        raise InputError(
            f"references have shape {references.shape}; expected (N, 2) joint velocities in rad/s, N >= 2"
        )
    if not np.isfinite(references).all() or not np.isfinite(theta2):
        raise InputError("references or theta2 contain NaN or infinite values")
    if not dt > 0 or substeps < 1:
        raise InputError(
            f"dt = {dt}, substeps = {substeps}; expected a positive step in seconds and at least one substep"
        )
    start = np.array([0.0, float(theta2), 0.0, 0.0])
    q, dq = integrate(references, float(dt), int(substeps), start, np.zeros(4), p.packed)
    if not np.isfinite(q).all():
        raise InputError(f"the simulation diverged at dt = {dt} s; take a shorter step or more substeps")
    if outputs == "linear":
        y = dq @ output_matrix(p).T
    elif outputs == "inverse_kinematics":
        y = joint_rates(q, dq, (p.l1, p.l2))
    else:
        raise InputError(f"outputs = {outputs!r}; expected 'linear' or 'inverse_kinematics'")
    return ArmRecording(dt * np.arange(len(q)), references, y, q, dq)


def output_matrix(p: FlexibleArmParameters) -> np.ndarray:
    """C1 of (31c), shape (2, 4)."""
    return np.array([[1.0, 0.0, p.l1, 0.0], [0.0, 1.0, p.l1, p.l2]])


def prbs(
    samples: int, *, hold: int = 1, channels: int = 2, amplitude: float = 1.0, register: int = 11, rng=None
) -> np.ndarray:
    """Pseudo-random binary sequences (maximum length, 2^register - 1 clocks), shape (samples, channels).

    Channels are the same sequence at random, well-separated phases. ``hold``: samples per clock.
    """
    taps = {7: (7, 6), 9: (9, 5), 10: (10, 7), 11: (11, 9), 15: (15, 14)}
    if register not in taps:
        raise InputError(f"register = {register}; expected one of {sorted(taps)}")
    rng = np.random.default_rng(rng)
    state = np.ones(register, dtype=int)
    bits = np.empty(2**register - 1)
    for k in range(bits.size):
        bits[k] = state[-1]
        new = state[taps[register][0] - 1] ^ state[taps[register][1] - 1]
        state = np.concatenate([[new], state[:-1]])
    first = rng.integers(bits.size)
    phases = first + (np.arange(channels) * bits.size) // channels
    clocks = -(-samples // hold)
    index = (phases + np.arange(clocks)[:, None]) % bits.size
    return np.repeat(amplitude * (2 * bits[index] - 1), hold, axis=0)[:samples]


def vizer2014_flexible_arm_experiment(
    theta2: float,
    *,
    rng=None,
    amplitude: float = 0.2,
    samples: int = 30_000,
    dt: float = 1e-4,
    clock: float = 1e-3,
    decimation: int = 10,
    parameters: FlexibleArmParameters | None = None,
    outputs: str = "inverse_kinematics",
) -> ArmRecording:
    """One noise-free local PRBS experiment of section 3.3.1, decimated; add noise with ``.noisy(30, rng)``.

    Parameters
    ----------
    theta2 : float
        Operating point, rad (the arm moves little around it).
    amplitude : float
        Of the velocity references, rad/s.
    samples, dt, decimation : int, float (s), int
        30 000 samples at 0.1 ms, every tenth kept.
    clock : float
        PRBS clock, s: a multiple of ``dt * decimation`` keeps the decimated input held between its samples.
    """
    hold = round(clock / dt)
    if hold % decimation:
        raise InputError(
            f"clock = {clock} s is no multiple of the decimated step {dt * decimation} s: the input is not "
            "held"
        )
    references = prbs(samples, hold=hold, amplitude=amplitude, rng=rng)
    run = vizer2014_flexible_arm(references, dt, theta2, parameters=parameters, outputs=outputs)
    return run.decimate(decimation)


def vizer2014_flexible_arm_sweep(
    duration: float = 3.0,
    *,
    amplitude: float = 0.3,
    rng=None,
    dt: float = 1e-4,
    clock: float = 2e-3,
    decimation: int = 1,
    start: float = np.pi / 8,
    stop: float = 7 * np.pi / 8,
    parameters: FlexibleArmParameters | None = None,
    outputs: str = "inverse_kinematics",
) -> ArmRecording:
    """A sweep of theta2 over the whole range (section 3.3.3): a half-sine velocity reference on joint 2 plus
    PRBS on both.

    Parameters
    ----------
    duration : float
        Of the sweep, s: 3 s is the paper's, 1.5 s brings out the Coriolis torque.
    amplitude : float
        Of the PRBS, rad/s.
    """
    if not duration > 0:
        raise InputError(f"duration = {duration}; expected a positive time in seconds")
    n = round(duration / dt)
    references = prbs(n, hold=round(clock / dt), amplitude=amplitude, rng=rng)
    held = np.floor(np.arange(n) * dt / clock + 1e-9) * clock
    references[:, 1] += (stop - start) * np.pi / (2 * duration) * np.sin(np.pi * held / duration)
    run = vizer2014_flexible_arm(references, dt, start, parameters=parameters, outputs=outputs)
    return run.decimate(decimation)


def vizer2014_flexible_arm_lpv(parameters: FlexibleArmParameters | None = None) -> InertiaLPV:
    """The arm's true M0, M1, K, Lambda: M(q) at v = 0 is exactly M0 + cos(theta2) M1."""
    p = FlexibleArmParameters() if parameters is None else parameters
    mass = {}
    for sign, angle in ((1, 0.0), (-1, np.pi)):
        M, h = np.empty((4, 4)), np.empty(4)
        mass_and_forces(np.array([0.0, angle, 0.0, 0.0]), np.zeros(4), p.packed, M, h)
        mass[sign] = M
    return InertiaLPV(
        M0=0.5 * (mass[1] + mass[-1]),
        M1=0.5 * (mass[1] - mass[-1]),
        stiffness=np.array([4 * p.ei1 * p.l1, 4 * p.ei2 * p.l2]),
        gains=np.array([p.gain1, p.gain2]),
        output=output_matrix(p),
    )


def vizer2014_flexible_arm_linear(
    theta2: float, parameters: FlexibleArmParameters | None = None
) -> control.StateSpace:
    """The linearisation at a fixed elbow angle, order 6, states (v1, v2, dtheta1, dtheta2, dv1, dv2):

    The "analytic" model.
    """
    return vizer2014_flexible_arm_lpv(parameters).frozen(np.cos(theta2))


def vizer2014_flexible_arm_structure(parameters: FlexibleArmParameters | None = None):
    """The structure (32) with 16 free parameters th1..th16 (rows 3-6, columns 1-4 of A, column by column) and
    known C.
    """
    return vizer2014_flexible_arm_lpv(parameters).pattern()


def vizer2014_flexible_arm_model(
    parameters: FlexibleArmParameters | None = None,
    *,
    coriolis: bool = False,
    scheduling: str = "state",
    theta2: float = np.pi / 8,
) -> control.NonlinearIOSystem:
    """The LPV model frozen in theta2 as `control.nlsys`, and with ``coriolis=True`` the model with the
    missing torque.

    Parameters
    ----------
    coriolis : bool
        Add the velocity forces of M0 + cos(theta2) M1.
    scheduling : "state" or "input"
        "state": theta2 is the seventh state, integrated from dtheta2 (its initial value is ``theta2`` below,
        to be passed in the initial state). "input": theta2 is a third, measured input.
    theta2 : float
        Nominal initial elbow angle, rad; kept in ``params["theta2_start"]`` for the caller.
    """
    return vizer2014_flexible_arm_lpv(parameters).to_nlsys(
        coriolis=coriolis, scheduling=scheduling, name="vizer2014_flexible_arm", theta2_start=theta2
    )
