"""Systems of Maruta and Ohlsson (2014), section 7: the pyramid of Example 1, and a stand-in for Example 2's
actuator.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit

from pwaid.dynamics.dry_friction import Drive, DryFriction, advance, check_events, drive_tables
from pwaid.errors import InputError

__all__ = ["RotaryActuator", "maruta2014_pyramid", "maruta2014_rotary_actuator", "pyramid"]


def pyramid(X) -> np.ndarray:
    """max(1 − ‖x‖₁, 0), equation (20) without noise; X (…, d) → (…)."""
    return np.maximum(1.0 - np.abs(np.asarray(X, dtype=float)).sum(axis=-1), 0.0)


def maruta2014_pyramid(n: int, rng=None, noise: float = 0.1,
                       bound: float = 1.1) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Samples of the pyramid of Example 1 (2014, equation 20): y = max(1 − ‖x‖₁, 0) + η, dimensionless.

    Parameters
    ----------
    n : int
        Number of samples; 2000 in the paper.
    rng : numpy.random.Generator or int, optional
    noise : float
        Standard deviation of η.
    bound : float
        x is uniform in ‖x‖∞ < bound.

    Returns
    -------
    X, y : ndarray (n, 2), (n,)
    """
    if n < 1 or noise < 0 or bound <= 0:
        raise InputError(f"n = {n}, noise = {noise}, bound = {bound}; expected n >= 1, noise >= 0, bound > 0")
    rng = np.random.default_rng(rng)
    X = rng.uniform(-bound, bound, (n, 2))
    return X, pyramid(X) + noise * rng.standard_normal(n)


@dataclass(frozen=True)
class RotaryActuator:
    """A stand-in for the rotary actuator of Example 2 (FHA-17C-100-E250): its recordings are not public.

    A servo amplifier turns the command u (V) into motor torque through a first-order lag, and the torque
    moves the inertia against viscous and dry friction with a strong Stribeck effect that does not depend on
    position:

        lag · ṁ = u + disturbance − m,    inertia · ω̇ = m − viscous · ω − F(ω),    θ̇ = ω,

    with torque m counted in volts of command, and a true standstill while |m| ≤ static. The output is the
    backward difference of the encoder's angle, ω_k = (θ_k − θ_{k−1}) / dt, and u_k is the command held from
    t_{k−1} to t_k, so that ω_k = Π(ω_{k−1}, ω_{k−2}, u_k) as in (21).

    Magnitudes: chosen by reasoning, not measured and not from a data sheet. The output RMS is the paper's
    8.4 rad/s for commands of N(0, 1 V) held for 0.1 s; the paper says that harmonic drives have strong
    nonlinear friction (it cites Taghirad and Bélanger 1998), so Coulomb friction is 40 % and breakaway 80 %
    of the command's standard deviation, and the drive stands still a third of the time; the lag is that of
    a current loop with a filter.

    Attributes
    ----------
    inertia : float
        V s²/rad.
    viscous : float
        V s/rad.
    lag : float
        s.
    friction : DryFriction
        Levels in V, Stribeck velocity in rad/s.
    disturbance : float
        Standard deviation, V, of a torque disturbance that is new every sample (process noise); 0 for none.
    counts : int or None
        Encoder counts per revolution (the measurement noise is its rounding); None for no encoder.
    dt : float
        Sampling time, s.
    """

    inertia: float = 4.6e-3
    viscous: float = 4.7e-2
    lag: float = 4e-3
    friction: DryFriction = field(default_factory=lambda: DryFriction(0.40, 0.80, 2.0, 1))
    disturbance: float = 0.03
    counts: int | None = 400_000
    dt: float = 0.01

    def __post_init__(self):
        if min(self.inertia, self.lag, self.dt) <= 0 or min(self.viscous, self.disturbance) < 0:
            raise InputError(f"{self}: expected inertia, lag, dt > 0 and viscous, disturbance >= 0")
        if self.counts is not None and self.counts < 1:
            raise InputError(f"counts = {self.counts}; expected a positive number of encoder counts, or None")

    def replace(self, **changes) -> RotaryActuator:
        """A changed copy."""
        return replace(self, **changes)

    def drive(self, step_scale: float = 1.0) -> Drive:
        """The actuator with states m, ω, θ for `pwaid.dynamics.dry_friction`."""
        A = [[[-1 / self.lag, 0, 0], [1 / self.inertia, -self.viscous / self.inertia, 0], [0, 1, 0]]]
        return drive_tables(A, [[0, 0, 0]], [[1 / self.lag], [0], [0]], [[]], (1,), (self.inertia,),
                            (self.friction,), step_scale)  # fmt: skip

    def respond(self, u, rng=None, step_scale: float = 1.0) -> np.ndarray:
        """Output ω (N,), rad/s, for the command u (N,), V, from rest; u_k acts from t_{k−1} to t_k."""
        u = np.array(u, dtype=float)
        if u.ndim != 1 or not np.isfinite(u).all():
            raise InputError(f"u has shape {u.shape}; expected finite commands of shape (N,), in volts")
        rng = np.random.default_rng(rng)
        pushed = u + self.disturbance * rng.standard_normal(u.size)
        theta, lowest = _angles(self.drive(step_scale), pushed, self.dt)
        check_events(lowest)
        if self.counts is not None:
            count = 2 * np.pi / self.counts
            theta = np.floor(theta / count + 0.5) * count
        return np.diff(theta, prepend=0.0) / self.dt

    def cyclic_test(self, cycles: int = 200, rng=None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The test of Fig. 10: one cyclic command, repeated; the disturbance is new in every cycle.

        The command of the paper is not published; this one rises and falls in steps of 0.2 s and ends in a
        slow sine of small amplitude that keeps crossing the standstill. One cycle before the first is not
        returned.

        Returns
        -------
        t, u : ndarray (400,)
            One cycle of 4 s: seconds, V.
        omega : ndarray (cycles, 400)
            rad/s.
        """
        steps = np.repeat([0.0, 0.5, 1.0, 1.6, 1.0, 0.4, -0.4, -1.0, -1.6, -0.8], 20)
        t = self.dt * np.arange(400)
        u = np.concatenate([steps, 1.1 * np.sin(2 * np.pi * 1.0 * t[:200])])
        omega = self.respond(np.tile(u, cycles + 1), rng)
        return t, u, omega.reshape(cycles + 1, u.size)[1:]


@njit(cache=True)
def _angles(drive, u, dt):
    """Angle at the end of each interval of length dt, from rest; and the least that `advance` returned."""
    lowest = 0
    x, mode = np.zeros(3), np.zeros(2, dtype=np.int64)
    theta = np.empty(u.size)
    held = np.empty(1)
    for k in range(u.size):
        held[0] = u[k]
        lowest = min(lowest, advance(drive, mode, x, held, dt))
        theta[k] = x[2]
    return theta, lowest


def maruta2014_rotary_actuator(n: int = 512_000, rng=None, system: RotaryActuator | None = None,
                               hold: int = 10,
                               step_scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Recordings of Example 2's experiment on the stand-in `RotaryActuator`.

    Parameters
    ----------
    n : int
        Samples at 10 ms; 512 000 in the paper, of which 300 001–400 000 train and 400 001–500 000 validate.
    rng : numpy.random.Generator or int, optional
    system : RotaryActuator, optional
    hold : int
        Samples for which a command is held; 10 (0.1 s) in the paper.

    Returns
    -------
    u, omega : ndarray (n,), (n,)
        Command N(0, 1 V), V; speed, rad/s.
    """
    if n < 1 or hold < 1:
        raise InputError(f"n = {n}, hold = {hold}; expected both at least 1")
    rng = np.random.default_rng(rng)
    u = np.repeat(rng.standard_normal(-(-n // hold)), hold)[:n]
    return u, (RotaryActuator() if system is None else system).respond(u, rng, step_scale)
