"""Polynomial LPV models in continuous time:

A(kappa) = A0 + A1 kappa + ... + Ad kappa^d, eq. (35), likewise B, C, D.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import control
import numpy as np

from pwaid.errors import InputError
from pwaid.hinfstruct.metrics import interpolation_fit
from pwaid.hinfstruct.simulate import simulate_lpv
from pwaid.hinfstruct.statespace import Matrices, as_matrices, to_control
from pwaid.hinfstruct.structured import StructuredModel

__all__ = ["LPVModel", "fit_polynomial"]

SCHEMA = "pwaid.lpv/1"


def fit_polynomial(kappas, values, degree: int) -> np.ndarray:
    """Least-squares polynomial coefficients, shape (degree + 1, ...), of values (k, ...) at kappas (k,).

    Raises
    ------
    InputError
        Fewer different kappa values than coefficients, or values that are not finite.
    """
    kappas, values = np.asarray(kappas, dtype=float), np.asarray(values, dtype=float)
    if kappas.ndim != 1 or len(values) != kappas.size or not (
        np.isfinite(kappas).all() and np.isfinite(values).all()
    ):
        raise InputError(
            f"kappas {kappas.shape} and values {values.shape}: expected finite arrays of the same length"
        )
    if degree < 0 or np.unique(kappas).size < degree + 1:
        raise InputError(
            f"degree = {degree} needs {degree + 1} different kappa values; {np.unique(kappas).size} were "
            "given"
        )
    basis = np.vander(kappas, degree + 1, increasing=True)
    solution = np.linalg.lstsq(basis, values.reshape(kappas.size, -1), rcond=None)[0]
    return solution.reshape(degree + 1, *values.shape[1:])


@dataclass(frozen=True)
class LPVModel:
    """A polynomial LPV state-space model.

    Attributes
    ----------
    A, B, C, D : arrays, shapes (d + 1, n, n), (d + 1, n, nu), (d + 1, ny, n), (d + 1, ny, nu)
        Coefficients in increasing powers of kappa.
    kappa_range : tuple of float
        Where the local models lay. Outside, `frozen` and `simulate` raise unless asked for, the nlsys holds the nearest
        end, and `matrices` and `stacked` follow the polynomials.
    scheduling : str
        Name of the scheduling variable.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    kappa_range: tuple[float, float] = (-np.inf, np.inf)
    scheduling: str = "kappa"

    def __post_init__(self):
        d = len(self.A)
        n, nu, ny = self.A.shape[-1], self.B.shape[-1], self.C.shape[1]
        shapes = {"A": (d, n, n), "B": (d, n, nu), "C": (d, ny, n), "D": (d, ny, nu)}
        for name, shape in shapes.items():
            block = np.array(getattr(self, name), dtype=float)
            if block.shape != shape or not np.isfinite(block).all():
                raise InputError(
                    f"LPV coefficients {name} have shape {block.shape}; expected finite numbers of shape "
                    f"{shape}"
                )
            block.flags.writeable = False
            object.__setattr__(self, name, block)
        if not self.kappa_range[0] < self.kappa_range[1]:
            raise InputError(f"kappa_range = {self.kappa_range}; expected (low, high) with low < high")

    @classmethod
    def from_models(cls, kappas, systems: Sequence, degree: int, *, scheduling: str = "kappa") -> LPVModel:
        """Interpolate local models with coherent states (restructured, analytic or aligned balanced) entry by
        entry.
        """
        models = [as_matrices(s, f"system {i}") for i, s in enumerate(systems)]
        if any(m.dt for m in models):
            raise InputError("the local models are discrete; convert them with d2c first")
        if len({(m.order, *m.D.shape) for m in models}) != 1:
            raise InputError("the local models differ in order, inputs or outputs and cannot be interpolated")
        parts = [fit_polynomial(kappas, np.stack([m[k] for m in models]), degree) for k in range(4)]
        return cls(*parts, (float(np.min(kappas)), float(np.max(kappas))), scheduling)

    @classmethod
    def from_parameters(
        cls,
        model: StructuredModel,
        coefficients,
        kappa_range: tuple[float, float],
        *,
        scheduling: str = "kappa",
    ) -> LPVModel:
        """From polynomial parameters theta(kappa) of an affine structured model.

        Coefficients (d + 1, size).
        """
        coefficients = np.asarray(coefficients, dtype=float)
        if not model.affine:
            raise InputError(
                "from_parameters needs an affine pattern model; use from_models on its local systems"
            )
        if coefficients.ndim != 2 or coefficients.shape[1] != model.size:
            raise InputError(
                f"coefficients have shape {coefficients.shape}; expected (degree + 1, {model.size})"
            )
        constant = model.evaluate(np.zeros(model.size))
        slopes = model.differentiate(np.zeros(model.size))
        parts = []
        for c, s in zip(constant, slopes, strict=True):
            block = np.tensordot(coefficients, s, 1)
            block[0] += c
            parts.append(block)
        return cls(*parts, kappa_range, scheduling)

    @property
    def degree(self) -> int:
        return len(self.A) - 1

    @property
    def order(self) -> int:
        return self.A.shape[1]

    def stacked(self, kappa) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A, B, C, D at an array of kappa (k,), stacked along axis 0, without a range check."""
        powers = np.vander(np.ravel(kappa), self.degree + 1, increasing=True)
        return tuple(np.tensordot(powers, block, 1) for block in (self.A, self.B, self.C, self.D))

    def check_range(self, kappa) -> None:
        low, high = self.kappa_range
        slack = 1e-9 * (high - low) if np.isfinite(high - low) else 0.0
        kappa = np.asarray(kappa, dtype=float)
        outside = int(np.sum((kappa < low - slack) | (kappa > high + slack)))
        if outside:
            raise InputError(
                f"{outside} of {kappa.size} values of {self.scheduling} lie outside [{low:.6g}, "
                f"{high:.6g}], where this model "
                "was identified; pass extrapolate=True to use the polynomials there"
            )

    def matrices(self, kappa: float) -> Matrices:
        return Matrices(*(block[0] for block in self.stacked([kappa])))

    def frozen(self, kappa: float, *, extrapolate: bool = False) -> control.StateSpace:
        """`control.StateSpace` at one kappa."""
        if not extrapolate:
            self.check_range(kappa)
        return to_control(self.matrices(float(kappa)))

    def fit(self, kappas, systems: Sequence) -> dict[str, float]:
        """FIT (36) of each matrix at local models, percent; None for a matrix that is zero throughout."""
        models = [as_matrices(s, f"system {i}") for i, s in enumerate(systems)]
        mine = self.stacked(kappas)
        out = {}
        for k, name in enumerate("ABCD"):
            local = np.stack([m[k] for m in models])
            out[name] = interpolation_fit(local, mine[k]) if local.any() else None
        return out

    def simulate(
        self, time, inputs, kappa, *, x0=None, substeps: int = 1, extrapolate: bool = False
    ) -> np.ndarray:
        """Outputs (N, ny) along a scheduling trajectory kappa (N,); see `simulate_lpv`."""
        if not extrapolate:
            self.check_range(kappa)
        return simulate_lpv(self.stacked, time, inputs, kappa, x0=x0, substeps=substeps)

    def to_nlsys(self, name: str = "lpv", *, extrapolate: bool = False) -> control.NonlinearIOSystem:
        """`control.nlsys` with inputs u1, ..., and the scheduling variable last.

        Outputs y1, ...; states x1, ... Outside the range of the scheduling variable its nearest end counts, unless
        the model is to `extrapolate`.
        """
        nu, ny = self.B.shape[2], self.C.shape[1]
        low, high = (-np.inf, np.inf) if extrapolate else self.kappa_range

        def update(t, x, u, params):
            m = self.matrices(float(np.clip(u[-1], low, high)))
            return m.A @ x + m.B @ u[:-1]

        def output(t, x, u, params):
            m = self.matrices(float(np.clip(u[-1], low, high)))
            return m.C @ x + m.D @ u[:-1]

        return control.nlsys(
            update,
            output,
            inputs=[*(f"u{i + 1}" for i in range(nu)), self.scheduling],
            outputs=[f"y{i + 1}" for i in range(ny)],
            states=[f"x{i + 1}" for i in range(self.order)],
            name=name,
        )

    def save(self, path) -> None:
        """Write the model as JSON; numbers round-trip exactly."""
        record = {
            "schema": SCHEMA,
            "scheduling": self.scheduling,
            "kappa_range": [repr(float(k)) for k in self.kappa_range],
            **{name: getattr(self, name).tolist() for name in "ABCD"},
        }
        Path(path).write_text(json.dumps(record, indent=1), encoding="utf-8")

    @classmethod
    def load(cls, path) -> LPVModel:
        """Read a model written by `save`.

        Raises
        ------
        InputError
            The file is missing or not such a model.
        """
        try:
            record = json.loads(Path(path).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(
                f"{path} cannot be read as an LPV model ({error}); expected a file written by LPVModel.save"
            ) from error
        if not isinstance(record, dict) or record.get("schema") != SCHEMA:
            raise InputError(
                f"{path} is no LPV model: its schema is not {SCHEMA!r}; expected a file written by "
                "LPVModel.save"
            )
        try:
            blocks = [np.array(record[name], dtype=float) for name in "ABCD"]
            low, high = (float(k) for k in record["kappa_range"])
            return cls(*blocks, (low, high), str(record["scheduling"]))
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            raise InputError(f"{path} is a damaged LPV model ({error}); save it again") from error
