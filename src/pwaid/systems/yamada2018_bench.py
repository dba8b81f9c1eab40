"""The experiment of Yamada, Ruderman and Fujimoto, section IV, as a simulated bench with sampled controllers.

The plant of Table II moves exactly between the samples (matrix series, located contacts and standstills).
Both angles are read by 20-bit encoders, the joint torque by a sensor; the controllers are discretised by
Tustin's rule at 2.5 kHz. The bench can differ from the nominal drive: other parameters, and dry friction on
either side with a true standstill. The recordings of the real bench are not public, so this is a stand-in
wherever it goes beyond the paper's equations: the friction levels, the torque sensor's noise, and how ω_M
and ω_L are obtained (here: backward differences of the encoders) are assumptions. The paper names
unmodelled friction and parameter errors as the difference it saw.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace

import numpy as np
from numba import njit

from pwaid.dynamics.cell import freeze
from pwaid.dynamics.dry_friction import Drive, DryFriction, advance, check_events, drive_tables
from pwaid.errors import InputError
from pwaid.systems.yamada2018 import TwoInertia
from pwaid.systems.yamada2018_loop import STATES, LoopController, control_step, read_encoder

__all__ = ["Bench", "BenchRun", "LoopController", "half_gap", "identification_run", "joint_motion",
           "slow_sine", "step_reference"]  # fmt: skip

UNITS = {"t": "s", "reference": "rad", "T_M": "N m", "theta_M": "rad", "theta_L": "rad", "T_s": "N m"}


@dataclass(frozen=True)
class BenchRun:
    """One recording of the bench.

    Attributes
    ----------
    time : ndarray (N,)
        s, uniform; `oversample` samples per control sample.
    reference : ndarray (N,)
        Load-side reference before its filter, rad (zeros in open loop).
    T_M : ndarray (N,)
        Torque command, N m, held between control samples.
    theta_M, theta_L : ndarray (N,)
        Encoder readings, rad.
    T_s : ndarray (N,)
        Torque sensor, N m.
    states : ndarray (N, 4)
        The truth: θ_M, ω_M, θ_L, ω_L.
    joint_torque : ndarray (N,)
        The truth of T_s.
    contact : ndarray of int (N,)
        0 gap, 1 positive, 2 negative contact.
    at_rest : ndarray of bool (N, 2)
        Motor or load side held by dry friction.
    description : dict
        What was simulated, in words and numbers that need no pwaid to be read.
    """

    time: np.ndarray
    reference: np.ndarray
    T_M: np.ndarray
    theta_M: np.ndarray
    theta_L: np.ndarray
    T_s: np.ndarray
    states: np.ndarray
    joint_torque: np.ndarray
    contact: np.ndarray
    at_rest: np.ndarray
    description: dict

    def __post_init__(self):
        freeze(self)

    def columns(self) -> dict[str, np.ndarray]:
        """What the bench would store: t, reference, T_M, theta_M, theta_L, T_s; units in
        ``description['units']``.
        """
        return {"t": self.time, "reference": self.reference, "T_M": self.T_M, "theta_M": self.theta_M,
                "theta_L": self.theta_L, "T_s": self.T_s}  # fmt: skip


@dataclass(frozen=True)
class Bench:
    """The bench: plant, friction, sensors. Defaults: the nominal plant without dry friction, with 20-bit
    encoders.

    Attributes
    ----------
    plant : TwoInertia
    motor_friction, load_friction : DryFriction
        N m; zero by default. 0.08 N m on the motor side ends the limit cycle of the undamped loop.
    encoder_bits : int or None
        Of both encoders, per revolution, rounded down; None reads the true angles.
    torque_noise : float
        Standard deviation of the torque sensor, N m, new every sample.
    rate : float
        Control samples per second.
    """

    plant: TwoInertia = field(default_factory=TwoInertia)
    motor_friction: DryFriction = field(default_factory=DryFriction)
    load_friction: DryFriction = field(default_factory=DryFriction)
    encoder_bits: int | None = 20
    torque_noise: float = 0.0
    rate: float = 2500.0

    def __post_init__(self):
        if self.encoder_bits is not None and not 1 <= self.encoder_bits <= 40:
            raise InputError(f"encoder_bits = {self.encoder_bits}; expected 1 to 40, or None for no "
                             "quantisation")
        if self.torque_noise < 0 or self.rate <= 0:
            raise InputError(f"torque_noise = {self.torque_noise}, rate = {self.rate}; expected >= 0 and > 0")

    def replace(self, **changes) -> Bench:
        """A changed copy."""
        return replace(self, **changes)

    @property
    def quantum(self) -> float:
        """Encoder resolution, rad; 0 for none."""
        return 0.0 if self.encoder_bits is None else 2 * np.pi / 2**self.encoder_bits

    def drive(self, step_scale: float = 1.0) -> Drive:
        """The plant with states θ_M, ω_M, θ_L, ω_L and input T_M for `pwaid.dynamics.dry_friction`."""
        p = self.plant
        free = np.array([[0, 1, 0, 0], [0, -p.D_M / p.J_M, 0, 0], [0, 0, 0, 1], [0, 0, 0, -p.D_L / p.J_L]])
        torque = np.array([p.K, p.D_B, -p.K, -p.D_B])
        push = np.array([0, -1 / p.J_M, 0, 1 / p.J_L])
        closed = free + np.outer(push, torque)
        twist = np.array([1.0, 0, -1.0, 0])
        guards = [[(-twist, p.beta, 1), (twist, p.beta, 2)], [(twist, -p.beta, 0)], [(-twist, -p.beta, 0)]]
        bias = p.K * p.beta * push
        frictions = (self.motor_friction, self.load_friction)
        return drive_tables([free, closed, closed], [np.zeros(4), -bias, bias], [[0], [1 / p.J_M], [0], [0]],
                            guards, (1, 3), (p.J_M, p.J_L), frictions, step_scale)  # fmt: skip

    def closed_loop(self, reference, controller: LoopController | None = None, *, x0=None,
                    oversample: int = 1,
                    rng=None, step_scale: float = 1.0) -> BenchRun:  # fmt: skip
        """Record the loop.

        Parameters
        ----------
        reference : array_like (N,)
            rad, one value per control sample; see `step_reference`.
        controller : LoopController, optional
            Switched damping with the paper's gains when not given; its rate must be the bench's.
        x0 : array_like (4,), optional
            θ_M, ω_M, θ_L, ω_L; at rest in the middle of the gap when not given.
        oversample : int
            Recorded samples per control sample.
        rng : numpy.random.Generator or int, optional
            For the torque sensor's noise.
        step_scale : float
            Multiplies the internal step, for refinement studies.
        """
        controller = LoopController(rate=self.rate) if controller is None else controller
        if controller.rate != self.rate:
            raise InputError(f"controller at {controller.rate} Hz on a bench at {self.rate} Hz; give both "
                             "the same rate")
        told = {"loop": "closed", "controller": asdict(controller)}
        return self._record(reference, controller, x0, oversample, rng, step_scale, told)

    def open_loop(self, torque, *, x0=None, oversample: int = 1, rng=None,
                  step_scale: float = 1.0) -> BenchRun:
        """Record the plant under the motor torque (N,), N m, one value per control sample."""
        return self._record(torque, None, x0, oversample, rng, step_scale, {"loop": "open"})

    def _record(self, signal, controller, x0, oversample, rng, step_scale, told) -> BenchRun:
        signal = np.array(signal, dtype=float)
        x = np.zeros(4) if x0 is None else np.array(x0, dtype=float)
        if signal.ndim != 1 or signal.size < 2 or not np.isfinite(signal).all():
            raise InputError(f"the signal has shape {signal.shape}; expected at least 2 finite values, one "
                             "per control sample")
        if x.shape != (4,) or not np.isfinite(x).all() or oversample < 1:
            raise InputError(f"x0 = {x}, oversample = {oversample}; expected 4 finite states {STATES} and "
                             "at least 1")
        coefficients = np.zeros(9) if controller is None else controller.coefficients()
        state = np.zeros(6) if controller is None else controller.start(x[0], x[2])
        states, T_M, mode, lowest = _loop(self.drive(step_scale), signal, controller is None, coefficients,
                                          state, x, self.quantum, 1 / self.rate, oversample)  # fmt: skip
        check_events(lowest)
        if not np.isfinite(states).all() or np.abs(states).max() > 1e9:
            raise InputError("the loop diverged; check the signs and sizes of the controller's gains")
        contact = mode[:, 0]
        twist, speed = states[:, 0] - states[:, 2], states[:, 1] - states[:, 3]
        side = np.array([0.0, 1.0, -1.0])[contact]
        joint = (contact > 0) * (self.plant.K * (twist - side * self.plant.beta) + self.plant.D_B * speed)
        noise = np.random.default_rng(rng).standard_normal(len(joint)) * self.torque_noise
        at_rest = np.zeros((len(joint), 2), dtype=bool)
        used = [k for k, f in enumerate((self.motor_friction, self.load_friction)) if f.static > 0]
        at_rest[:, used] = mode[:, 1 : 1 + len(used)] == 0
        reference = np.zeros_like(signal) if controller is None else signal
        return BenchRun(
            time=np.arange(len(joint)) / (self.rate * oversample),
            reference=np.repeat(reference, oversample), T_M=T_M,
            theta_M=read_encoder(states[:, 0], self.quantum),
            theta_L=read_encoder(states[:, 2], self.quantum), T_s=joint + noise,
            states=states, joint_torque=joint, contact=contact, at_rest=at_rest,
            description=self.describe(told),
        )  # fmt: skip

    def describe(self, told: dict | None = None) -> dict:
        """Equations, parameters and units as plain text and numbers (JSON)."""
        return {
            "system": "two-inertia drive with backlash, Yamada/Ruderman/Fujimoto, section IV (simulated)",
            "equations": [
                "J_M domega_M/dt = T_M - T_s - D_M omega_M - friction_M(omega_M)",
                "J_L domega_L/dt = T_s - D_L omega_L - friction_L(omega_L)",
                "T_s = 0 for |theta_M - theta_L| < beta, "
                "else D_B (omega_M - omega_L) + K (theta_M - theta_L -+ beta)",
                "friction(omega) = sign(omega) (coulomb + (static - coulomb) "
                "exp(-|omega/velocity|^exponent)); standstill while the torque is at most static",
            ],
            "parameters": asdict(self.plant),
            "motor_friction": asdict(self.motor_friction),
            "load_friction": asdict(self.load_friction),
            "encoder_bits": self.encoder_bits,
            "torque_noise": self.torque_noise,
            "control_rate_hz": self.rate,
            "units": UNITS,
            **(told or {}),
        }


@njit(cache=True)
def _loop(drive, signal, is_open, coefficients, state, x, quantum, period, oversample):
    """States, torque and mode at every recorded sample; and the least that `advance` returned."""
    lowest = 0
    N = signal.size * oversample
    states, T_M = np.empty((N, 4)), np.empty(N)
    mode = np.zeros(1 + drive.inertia.size, dtype=np.int64)
    modes = np.empty((N, mode.size), dtype=np.int64)
    held = np.empty(1)
    for k in range(signal.size):
        theta_M, theta_L = x[0], x[2]
        if quantum > 0:
            theta_M, theta_L = np.floor(theta_M / quantum) * quantum, np.floor(theta_L / quantum) * quantum
        held[0] = signal[k] if is_open else control_step(state, coefficients, signal[k], theta_M, theta_L)
        for j in range(oversample):
            advance(drive, mode, x, held, 0.0)
            row = k * oversample + j
            states[row], T_M[row], modes[row] = x, held[0], mode
            lowest = min(lowest, advance(drive, mode, x, held, period / oversample))
    return states, T_M, modes, lowest


def step_reference(duration: float, rate: float = 2500.0, size: float = 0.30,
                   at: float = 0.010) -> np.ndarray:
    """The reference of Figs. 3 and 9: a step of 0.30 rad at 0.010 s, one value per control sample."""
    t = np.arange(round(duration * rate)) / rate
    return np.where(t >= at - 1e-12, size, 0.0)


def slow_sine(bench: Bench | None = None, amplitude: float = 0.04, frequency: float = 0.5, periods: int = 3,
              **options) -> BenchRun:  # fmt: skip
    """The measurement of Fig. 2: the motor driven by a small, slow sinusoidal torque, both encoders read.

    Amplitude (N m) and frequency (Hz) are not published; the defaults keep the joint's own twist below 0.5
    % of the gap.
    """
    bench = Bench() if bench is None else bench
    t = np.arange(round(periods / frequency * bench.rate)) / bench.rate
    return bench.open_loop(amplitude * np.sin(2 * np.pi * frequency * t), **options)


def identification_run(bench: Bench | None = None, duration: float = 4.0, torque: float = 0.8,
                       hold: float = 0.02, rng=None, oversample: int = 8, **options) -> BenchRun:  # fmt: skip
    """A recording from which the joint torque can be learned as a map of (θ_B, ω_B): open loop, random
    motor torque.

    Parameters
    ----------
    bench : Bench, optional
        With 20-bit encoders when not given; ``Bench(encoder_bits=None)`` records the true angles.
    duration : float
        s.
    torque, hold : float
        The motor torque is uniform in ±torque (N m) and new every `hold` seconds, so that the gap is
        crossed both ways at many speeds.
    rng : numpy.random.Generator or int, optional
    oversample : int
        Recorded samples per control sample; 8 gives 20 kHz, 150 samples per period of the contact's
        vibration, so that differences of the encoders are true speeds (see `joint_motion`).
    **options
        Passed to `Bench.open_loop`.
    """
    bench = Bench() if bench is None else bench
    if duration <= 0 or torque <= 0 or hold * bench.rate < 1:
        raise InputError(f"duration = {duration}, torque = {torque}, hold = {hold}; expected positive values")
    rng = np.random.default_rng(rng)
    each = round(hold * bench.rate)
    count = round(duration * bench.rate)
    signal = np.repeat(rng.uniform(-torque, torque, -(-count // each)), each)[:count]
    return bench.open_loop(signal, rng=rng, oversample=oversample, **options)


def joint_motion(run: BenchRun) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """θ_B (rad), ω_B (rad/s, central difference of the encoders) and T_s (N m); the first and last sample
    are lost.
    """
    twist = run.theta_M - run.theta_L
    return twist[1:-1], (twist[2:] - twist[:-2]) / (run.time[2:] - run.time[:-2]), run.T_s[1:-1]


def half_gap(theta_M, theta_L, T_s=None, K: float = TwoInertia.K) -> float:
    """Half the backlash, read from both encoders: half the distance of the two plateaus of θ_M − θ_L, rad.

    A plateau is the median of the upper (lower) part, beyond 90 % of the way from the middle to the
    extreme. Where the joint torque T_s was recorded too, the joint's own twist T_s / K is taken off first.

    Raises
    ------
    InputError
        Too few samples, or samples on one plateau only (the motor never crossed the gap).
    """
    twist = np.asarray(theta_M, dtype=float) - np.asarray(theta_L, dtype=float)
    if T_s is not None:
        twist = twist - np.asarray(T_s, dtype=float) / K
    if twist.ndim != 1 or twist.size < 10 or not np.isfinite(twist).all():
        raise InputError(f"angles of shape {twist.shape}; expected two finite recordings of at least 10 "
                         "samples")
    middle, reach = (twist.max() + twist.min()) / 2, (twist.max() - twist.min()) / 2
    upper, lower = twist[twist > middle + 0.9 * reach], twist[twist < middle - 0.9 * reach]
    if reach == 0 or min(upper.size, lower.size) < 3:
        raise InputError("the twist does not rest on two plateaus; drive the motor slowly through the gap "
                         "both ways")
    return float((np.median(upper) - np.median(lower)) / 2)
