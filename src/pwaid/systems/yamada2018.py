"""A two-inertia drive with backlash and its controllers (Yamada, Ruderman and Fujimoto, Table II, equations
1-23).

Assumptions of the paper: a dead zone with a linear spring and damper in contact (5), inertias and viscous
damping on both sides, the load-side angle fed back. All in SI units. Misprints that were corrected: a_0 has
four entries, (17) reads g_2 = g_1, and β is the *half* width of the gap. As printed, (5) is discontinuous
at the border of contact when ω_B ≠ 0 (the torque jumps by D_B ω_B), and the contact pulls a little before
it opens; both are kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pwaid.dynamics.cell import Cell
from pwaid.dynamics.pwa_feedback import close_loop
from pwaid.dynamics.pwa_system import PWASystem
from pwaid.errors import InputError

__all__ = ["PDGains", "TwoInertia", "closed_loop", "damping", "pd_gains", "position_loop",
           "yamada2018_two_inertia"]

DAMPINGS = ("none", "linear", "switched")
K_B = -0.80  # N m s/rad, III-B


@dataclass(frozen=True)
class TwoInertia:
    """Parameters of the drive; the defaults are Table II.

    Attributes
    ----------
    J_M, J_L : float
        Inertias of motor and load side, kg m².
    D_M, D_L : float
        Viscous friction, N m s/rad.
    K : float
        Torsional stiffness in contact, N m/rad.
    D_B : float
        Torsional damping in contact, N m s/rad.
    beta : float
        Half width of the gap, rad.
    """

    J_M: float = 8.78e-4
    D_M: float = 9.30e-2
    K: float = 3.00e2
    D_B: float = 1.00e-1
    J_L: float = 8.78e-4
    D_L: float = 3.60e-2
    beta: float = 7.80e-3

    def __post_init__(self):
        for name, value in vars(self).items():
            lowest = 0.0 if name[0] == "D" else np.finfo(float).tiny
            if not (np.isfinite(value) and value >= lowest):
                sign = "zero or more" if name[0] == "D" else "positive"
                raise InputError(f"{name} = {value}; expected a finite number, {sign}, in SI units")

    def replace(self, **changes) -> TwoInertia:
        """A changed copy."""
        return replace(self, **changes)


@dataclass(frozen=True)
class PDGains:
    """The load-side position controller K_P + K_D s / (1 + τ_D s), equation (21); N m/rad, N m s/rad, s."""

    K_P: float
    K_D: float
    tau_D: float


def yamada2018_two_inertia(parameters: TwoInertia | None = None) -> PWASystem:
    """The plant as a PWA system with three cells: gap, positive contact, negative contact (equations 9-19).

    States ω_L, ω_B, θ_L, θ_B; inputs T_M (motor torque, N m) and d_L (load-side disturbance, N m); outputs
    theta_M, theta_L, omega_M, omega_L, theta_B, omega_B (rad, rad/s) and T_s (joint torque, N m).
    """
    p = TwoInertia() if parameters is None else parameters
    B = [[0, 1 / p.J_L], [1 / p.J_M, -1 / p.J_L], [0, 0], [0, 0]]
    motion = np.array([[0, 0, 1, 1], [0, 0, 1, 0], [1, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1], [0, 1, 0, 0]],
                      dtype=float)
    free = np.array([[-p.D_L / p.J_L, 0, 0, 0], [-p.D_M / p.J_M + p.D_L / p.J_L, -p.D_M / p.J_M, 0, 0],
                     [1, 0, 0, 0], [0, 1, 0, 0]])  # fmt: skip
    torque = np.array([0, p.D_B, 0, p.K])
    push = np.array([1 / p.J_L, -1 / p.J_M - 1 / p.J_L, 0, 0])

    def contact(side: float, name: str) -> Cell:
        return Cell(
            A=free + np.outer(push, torque), a=-side * p.K * p.beta * push, B=B,
            G=[[0, 0, 0, side]], g=[-p.beta], C=np.vstack([motion, torque]),
            c=[*np.zeros(6), -side * p.K * p.beta],
            F=np.zeros((1, 4)), f=[side * p.beta], name=name,
        )  # fmt: skip

    gap = Cell(A=free, B=B, G=[[0, 0, 0, -1], [0, 0, 0, 1]], g=[p.beta, p.beta],
               C=np.vstack([motion, np.zeros(4)]),
               F=[[0, 0, 0, 1]], f=[0.0], name="gap")  # fmt: skip
    return PWASystem(
        (gap, contact(1.0, "positive contact"), contact(-1.0, "negative contact")),
        states=("omega_L", "omega_B", "theta_L", "theta_B"), inputs=("T_M", "d_L"),
        outputs=("theta_M", "theta_L", "omega_M", "omega_L", "theta_B", "omega_B",
                 "T_s"), name="two-inertia drive",
    )  # fmt: skip


def pd_gains(parameters: TwoInertia | None = None, *, omega_1=2 * np.pi * 18, omega_2=2 * np.pi * 15,
             zeta=0.70,
             viscous: float | None = None) -> PDGains:  # fmt: skip
    """PD gains that place the poles (s + ω_1)(s² + 2 ζ ω_2 s + ω_2²) on the rigid drive J s² + D s (III-B).

    The closed loop has order three, so the filter time τ_D is placed too: 1/τ_D = ω_1 + 2 ζ ω_2 − D/J.

    Parameters
    ----------
    viscous : float, optional
        D of the rigid drive; D_M + D_L when not given. The paper's reduction of 44 % results with D_M alone.
    """
    p = TwoInertia() if parameters is None else parameters
    J, D = p.J_M + p.J_L, p.D_M + p.D_L if viscous is None else viscous
    rate = omega_1 + 2 * zeta * omega_2 - D / J
    if rate <= 0:
        raise InputError(f"these poles need 1/tau_D = {rate:.4g} 1/s, which is not positive; place the "
                         "poles faster")
    tau_D = 1.0 / rate
    K_P = J * tau_D * omega_1 * omega_2**2
    K_D = J * tau_D * (omega_2**2 + 2 * zeta * omega_2 * omega_1) - D - K_P * tau_D
    return PDGains(K_P, K_D, tau_D)


def damping(kind: str = "switched", gain: float = K_B) -> PWASystem:
    """The damping T_B = K_B ω_B of (22): none, linear, or switched by the signs of ω_L and ω_B as in (23).

    Parameters
    ----------
    kind : {"none", "linear", "switched"}
    gain : float
        K_B, N m s/rad; negative adds damping.

    Returns
    -------
    PWASystem
        Without states, inputs omega_L and omega_B, output T_B.
    """
    if kind not in DAMPINGS:
        raise InputError(f"damping kind {kind!r}; expected one of {DAMPINGS}")
    nothing = np.zeros((0, 0))

    def cell(value: float, H, name: str) -> Cell:
        rows = np.asarray(H, dtype=float).reshape(-1, 2)
        return Cell(A=nothing, B=np.zeros((0, 2)), G=np.zeros((len(rows), 0)), g=np.zeros(len(rows)), H=rows,
                    C=np.zeros((1, 0)), D=[[0.0, value]], name=name)  # fmt: skip

    if kind == "switched":
        quadrants = [(1, 1), (-1, -1), (1, -1), (-1, 1)]
        cells = [cell(gain if a * b > 0 else 0.0, [[a, 0], [0, b]], f"w_L {a:+d} w_B {b:+d}") for a,
                 b in quadrants]
    else:
        cells = [cell(gain if kind == "linear" else 0.0, np.zeros((0, 2)), kind)]
    return PWASystem(tuple(cells), (), ("omega_L", "omega_B"), ("T_B",), f"{kind} damping")


def position_loop(gains: PDGains, inner: PWASystem, reference_cutoff_hz: float | None = 20.0) -> PWASystem:
    """PD control of θ_L and the damping `inner` as one controller with output T_M (equation 20).

    Inputs reference (rad), theta_L, omega_L, omega_B; outputs T_M, T_PD, T_B. States: the PD's filter, and
    the first-order low-pass filter of the reference (20 Hz in III-B; None leaves it out).
    """
    filtered = reference_cutoff_hz is not None
    k, lead, tau = int(filtered), gains.K_P + gains.K_D / gains.tau_D, gains.tau_D
    w = 2 * np.pi * reference_cutoff_hz if filtered else 0.0
    # e = r - theta_L; z' = (e - z)/tau; T_PD = K_P e + (K_D/tau)(e - z)
    error_x = np.array([0.0, 1.0][: 1 + k])
    error_u = np.array([0.0 if filtered else 1.0, -1.0, 0.0, 0.0])
    A, B = np.zeros((1 + k, 1 + k)), np.zeros((1 + k, 4))
    A[0], B[0] = error_x / tau, error_u / tau
    A[0, 0] -= 1 / tau
    if filtered:
        A[1, 1], B[1, 0] = -w, w
    pd_x, pd_u = lead * error_x, lead * error_u
    pd_x[0] -= gains.K_D / tau
    cells = []
    for part in inner.cells:
        T_B = np.concatenate([[0.0, 0.0], part.D[0]])
        H = np.hstack([np.zeros((len(part.g), 2)), part.H])
        cells.append(Cell(
            A=A, B=B, G=np.zeros((len(part.g), 1 + k)), g=part.g, H=H,
            C=[pd_x, pd_x, np.zeros(1 + k)], D=[pd_u + T_B, pd_u, T_B], name=part.name,
        ))  # fmt: skip
    states = ("z_D", "reference_filtered")[: 1 + k]
    return PWASystem(tuple(cells), states, ("reference", "theta_L", "omega_L", "omega_B"),
                     ("T_M", "T_PD", "T_B"),
                     f"PD with {inner.name}")  # fmt: skip


def closed_loop(kind: str = "switched", parameters: TwoInertia | None = None, gains: PDGains | None = None,
                gain: float = K_B, reference_cutoff_hz: float | None = 20.0) -> PWASystem:  # fmt: skip
    """Drive and controller as one PWA system; inputs reference (rad) and d_L (N m).

    With switched damping it has 12 cells (III-C.3), with none or linear damping 3.
    """
    gains = pd_gains(parameters) if gains is None else gains
    controller = position_loop(gains, damping(kind, gain), reference_cutoff_hz)
    return close_loop(yamada2018_two_inertia(parameters), controller, f"{kind} damping")
