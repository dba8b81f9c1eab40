"""A stand-in for the DC motor of Maruta and Sugie (2011), section V: its recordings are not public."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit

from pwaid.dynamics.cell import freeze
from pwaid.dynamics.dry_friction import Drive, DryFriction, advance, check_events, drive_tables
from pwaid.errors import InputError

__all__ = ["DCMotor", "MotorRecording", "maruta2011_dc_motor"]


@dataclass(frozen=True)
class MotorRecording:
    """What the experiment of section V yields.

    Attributes
    ----------
    time : ndarray (N,)
        s.
    current : ndarray (N,)
        i, A, held from each sample to the next.
    speed : ndarray (N,)
        ω, rad/s, as measured.
    acceleration : ndarray (N,)
        ω̇, rad/s², the forward difference of the measured speed: the current is constant over it.
    true_speed : ndarray (N,)
        rad/s.
    """

    time: np.ndarray
    current: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    true_speed: np.ndarray

    def __post_init__(self):
        freeze(self)


@dataclass(frozen=True)
class DCMotor:
    """A current-driven DC motor with a harmonic drive and an inertial load, seen at the motor shaft: ω̇ =
    f(i, ω).

        inertia · ω̇ = torque_constant · (i + disturbance) − viscous · ω − F(ω)

    with dry friction F of Coulomb and Stribeck type that stands still while the torque is at most static,
    and viscous losses that are larger in one direction (harmonic drives are; here by `asymmetry`, through a
    second slope).

    Magnitudes: chosen by reasoning, not measured and not from a data sheet. The paper gives the range
    reached in normal operation, ±1.5 A and ±35 rad/s, the hold of 0.1 s and the sampling of 0.01 s, and
    calls the system strongly nonlinear. A small DC motor has a torque constant near 0.04 N m/A; breakaway
    is put at 0.45 A, Coulomb friction at 0.30 A, and the viscous slope so that 1.5 A would end at 40 rad/s
    one way and 32 rad/s the other; the inertia gives a time constant near 0.15 s, so that 0.1 s steps cover
    the plane.

    Noise: the current is disturbed (new every sample), and the measured speed has white noise that stands
    for the rounding and differencing of the encoder; ω̇ inherits √2 of it divided by dt (4.2 rad/s² with
    the defaults).

    Attributes
    ----------
    inertia : float
        kg m², with the load, referred to the motor shaft.
    torque_constant : float
        N m/A.
    viscous : float
        N m s/rad.
    asymmetry : float
        N m s/rad, added to `viscous` for ω < 0.
    friction : DryFriction
        N m, rad/s.
    disturbance : float
        Standard deviation, A.
    speed_noise : float
        Standard deviation, rad/s.
    dt : float
        Sampling time, s.
    """

    inertia: float = 2.0e-4
    torque_constant: float = 0.04
    viscous: float = 1.2e-3
    asymmetry: float = 3e-4
    friction: DryFriction = field(default_factory=lambda: DryFriction(0.012, 0.018, 1.5, 1))
    disturbance: float = 0.01
    speed_noise: float = 0.03
    dt: float = 0.01

    def __post_init__(self):
        if min(self.inertia, self.torque_constant, self.dt) <= 0:
            raise InputError(f"{self}: expected inertia, torque_constant and dt above zero")
        if min(self.viscous, self.viscous + self.asymmetry, self.disturbance, self.speed_noise) < 0:
            raise InputError(f"{self}: expected viscous (in both directions), disturbance, speed_noise not "
                             "below zero")

    def replace(self, **changes) -> DCMotor:
        """A changed copy."""
        return replace(self, **changes)

    def acceleration(self, i, omega) -> np.ndarray:
        """The noise-free map f(i, ω), rad/s²; zero at rest while the torque is at most the static
        friction.
        """
        i, omega = np.broadcast_arrays(np.asarray(i, dtype=float), np.asarray(omega, dtype=float))
        slope = self.viscous + self.asymmetry * (omega < 0)
        torque = self.torque_constant * i - slope * omega - self.friction.torque(omega)
        broken = np.maximum(np.abs(torque) - self.friction.static, 0.0) * np.sign(torque)
        return np.where(omega == 0, broken, torque) / self.inertia

    def drive(self, step_scale: float = 1.0) -> Drive:
        """The motor with the state ω; the two directions are the two 'contacts' of
        `pwaid.dynamics.dry_friction`.
        """
        A = [[[-self.viscous / self.inertia]], [[-(self.viscous + self.asymmetry) / self.inertia]]]
        guards = [[((1.0,), 0.0, 1)], [((-1.0,), 0.0, 0)]]
        return drive_tables(A, [[0.0], [0.0]], [[self.torque_constant / self.inertia]], guards, (0,),
                            (self.inertia,), (self.friction,), step_scale)  # fmt: skip

    def respond(self, current, rng=None, step_scale: float = 1.0) -> MotorRecording:
        """Record the response, from rest, to currents (N,) in A that are held for one sample each."""
        current = np.array(current, dtype=float)
        if current.ndim != 1 or current.size < 1 or not np.isfinite(current).all():
            raise InputError(f"current has shape {current.shape}; expected finite values (N,), in ampere")
        rng = np.random.default_rng(rng)
        pushed = current + self.disturbance * rng.standard_normal(current.size)
        omega, lowest = _speeds(self.drive(step_scale), pushed, self.dt)
        check_events(lowest)
        measured = omega + self.speed_noise * rng.standard_normal(omega.size)
        time = self.dt * np.arange(current.size)
        return MotorRecording(time, current, measured[:-1], np.diff(measured) / self.dt, omega[:-1])

    def periodic_test(self, cycles: int = 100, rng=None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The validation of Fig. 9: one period of 20 s of current, repeated, with new noise in every cycle.

        The paper's input is not published; this one has a slow sine, a staircase with reversals, and a
        small fast sine around standstill. One cycle before the first is not returned.

        Returns
        -------
        t, i : ndarray (P,)
            One period: s, A.
        omega : ndarray (cycles, P)
            rad/s.
        """
        t = self.dt * np.arange(round(20.0 / self.dt))
        stairs = np.array([0.6, 1.2, 0.8, 0.4, -0.5, -1.0, -1.4, -0.7, 0.9, 0.0])
        i = np.where(t < 8, 1.3 * np.sin(2 * np.pi * t / 4), 0.7 * np.sin(2 * np.pi * t))
        middle = (t >= 8) & (t < 16)
        i[middle] = stairs[np.minimum(((t[middle] - 8) / 0.8).astype(int), 9)]
        run = self.respond(np.tile(i, cycles + 1), rng)
        return t, i, run.speed.reshape(cycles + 1, t.size)[1:]


@njit(cache=True)
def _speeds(drive, current, dt):
    """Speed at every sample and after the last, from rest; and the least that `advance` returned."""
    x, mode, held = np.zeros(1), np.zeros(1 + drive.inertia.size, dtype=np.int64), np.empty(1)
    omega, lowest = np.zeros(current.size + 1), 0
    for k in range(current.size):
        held[0] = current[k]
        lowest = min(lowest, advance(drive, mode, x, held, dt))
        omega[k + 1] = x[0]
    return omega, lowest


def maruta2011_dc_motor(n: int = 511_996, rng=None, motor: DCMotor | None = None, hold: int = 10,
                        limit: float = 1.5,
                        step_scale: float = 1.0) -> MotorRecording:  # fmt: skip
    """The experiment of section V on the stand-in `DCMotor`: current changed at random every 0.1 s, sampled
    at 0.01 s.

    Parameters
    ----------
    n : int
        Samples; 511 996 in the paper.
    rng : numpy.random.Generator or int, optional
    motor : DCMotor, optional
    hold : int
        Samples for which a current is held.
    limit : float
        The current is uniform in ±limit, A (the paper says only "changed randomly").
    """
    if n < 1 or hold < 1 or limit <= 0:
        raise InputError(f"n = {n}, hold = {hold}, limit = {limit}; expected n, hold >= 1 and a positive "
                         "limit")
    rng = np.random.default_rng(rng)
    current = np.repeat(rng.uniform(-limit, limit, -(-n // hold)), hold)[:n]
    return (DCMotor() if motor is None else motor).respond(current, rng, step_scale)
