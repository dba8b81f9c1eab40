"""Regressors of a NARX model: what the next output is predicted from.

    φ(k) = [y_1(k−1) … y_1(k−n_a), y_2(k−1) …,  u_1(k) u_1(k−1) … u_1(k−n_b), u_2(k) …]

with n_a output lags and n_b input lags; u(k) is there when the model has a direct term. The first predicted sample
is max(n_a, n_b), so a row never reaches across the start of a recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pwaid.errors import InputError
from pwaid.recording import Recording

__all__ = ["Lags", "as_recordings"]


@dataclass(frozen=True)
class Lags:
    """Orders of a NARX model.

    Attributes
    ----------
    outputs : int
        n_a ≥ 0: past outputs y(k−1) … y(k−n_a).
    inputs : int
        n_b ≥ 0: past inputs u(k−1) … u(k−n_b).
    direct : bool
        Whether u(k) is a regressor too.
    """

    outputs: int
    inputs: int
    direct: bool

    def __post_init__(self) -> None:
        for name in ("outputs", "inputs"):
            lag = getattr(self, name)
            if isinstance(lag, bool) or int(lag) != lag or lag < 0:
                raise InputError(f"{name[:-1]}_lags is {lag!r}; expected a whole number of at least 0")
            object.__setattr__(self, name, int(lag))
        if self.outputs == 0 and self.inputs == 0 and not self.direct:
            raise InputError("output_lags and input_lags are 0 and direct is False: the model has no regressors")

    @property
    def first(self) -> int:
        """Index of the first sample that can be predicted: how many initial samples a free run needs."""
        return max(self.outputs, self.inputs)

    def names(self, output_names: Sequence[str], input_names: Sequence[str]) -> tuple[str, ...]:
        """Names of the regressors, e.g. ``("y(k-1)", "y(k-2)", "u(k)")``."""
        past = [f"{n}(k-{i})" for n in output_names for i in range(1, self.outputs + 1)]
        for n in input_names:
            past += [f"{n}(k)"] * self.direct + [f"{n}(k-{i})" for i in range(1, self.inputs + 1)]
        return tuple(past)

    def size(self, n_outputs: int, n_inputs: int) -> int:
        """How many regressors."""
        return n_outputs * self.outputs + n_inputs * (self.inputs + self.direct)

    def matrix(self, outputs: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Φ, shape (N − first, size), of one recording's outputs (N, n_y) and inputs (N, n_u)."""
        n, first = len(outputs), self.first
        columns = [outputs[first - i : n - i, c] for c in range(outputs.shape[1]) for i in range(1, self.outputs + 1)]
        for c in range(inputs.shape[1]):
            columns += [inputs[first - i : n - i, c] for i in range(0 if self.direct else 1, self.inputs + 1)]
        return np.column_stack(columns)

    def build(self, recordings: Recording | Sequence[Recording]) -> tuple[np.ndarray, np.ndarray]:
        """Φ and the outputs they predict, of all recordings one after the other.

        Returns
        -------
        phi : ndarray, shape (N, size)
        y : ndarray, shape (N, n_outputs)

        Raises
        ------
        InputError
            No recordings, recordings that do not match, or one too short for the lags.
        """
        recordings = as_recordings(recordings)
        for r in recordings:
            if len(r) <= self.first:
                raise InputError(
                    f"{r.name} has {len(r)} samples; lags of {self.first} need at least {self.first + 1}: "
                    "use a longer recording or fewer lags"
                )
        if recordings[0].inputs.shape[1] == 0 and self.outputs == 0:
            raise InputError("the recording has no inputs and output_lags is 0: the model has no regressors")
        phi = np.vstack([self.matrix(r.outputs, r.inputs) for r in recordings])
        return phi, np.vstack([r.outputs[self.first :] for r in recordings])


def as_recordings(recordings: Recording | Sequence[Recording]) -> tuple[Recording, ...]:
    """One or several recordings as a tuple of at least one; all with the same channels and sample time."""
    several = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
    if not several or not all(isinstance(r, Recording) for r in several):
        raise InputError("expected a Recording or a non-empty list of them")
    head = several[0]
    for r in several[1:]:
        if r.input_names != head.input_names or r.output_names != head.output_names:
            raise InputError(
                f"{r.name} has the channels {r.input_names + r.output_names}, {head.name} has "
                f"{head.input_names + head.output_names}; expected the same channels in every recording"
            )
        if abs(r.sample_time / head.sample_time - 1.0) > 1e-3:
            raise InputError(
                f"{r.name} is sampled every {r.sample_time:g} s, {head.name} every {head.sample_time:g} s; "
                "expected one sample time: resample first"
            )
    return several
