"""A NARX model with its map: one-step prediction and free-run simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pwaid.delaunay import SimplexMesh
from pwaid.dynamics import free_run
from pwaid.dynamics.fit_measures import fit_percent, rmse
from pwaid.dynamics.regressors import Lags
from pwaid.errors import InputError, OutsideMeshError
from pwaid.pwa_map import PWAMap
from pwaid.recording import Recording, check_finite

__all__ = ["FreeRun", "NARXModel"]


@dataclass(frozen=True, eq=False)
class FreeRun:
    """One simulated trajectory and what happened on the way.

    Attributes
    ----------
    outputs : ndarray, shape (N, n_outputs)
        The first `first` rows are the initial outputs that were given; NaN from `diverged_at` on.
    first : int
        Index of the first simulated sample.
    n_outside : int
        Steps whose regressor lay outside the mesh.
    diverged_at : int or None
        The sample at which an output exceeded the limit; None when the run is complete.
    rule : {"affine", "clip", "raise"}
        What was done outside the mesh.
    """

    outputs: np.ndarray
    first: int
    n_outside: int
    diverged_at: int | None
    rule: str

    def __post_init__(self) -> None:
        self.outputs.setflags(write=False)

    @property
    def n_steps(self) -> int:
        """How many samples were simulated."""
        return (len(self.outputs) if self.diverged_at is None else self.diverged_at) - self.first

    @property
    def fraction_outside(self) -> float:
        """Share of the steps whose regressor lay outside the mesh."""
        return self.n_outside / max(self.n_steps, 1)

    def rmse(self, measured: Any) -> float:
        """RMSE over the simulated samples; infinite after divergence."""
        return rmse(_like(measured, self.outputs)[self.first :], self.outputs[self.first :])

    def fit_percent(self, measured: Any) -> float:
        """100·(1 − ‖y − ŷ‖/‖y − mean y‖) over the simulated samples."""
        return fit_percent(_like(measured, self.outputs)[self.first :], self.outputs[self.first :])

    def __str__(self) -> str:
        end = "complete" if self.diverged_at is None else f"diverged at sample {self.diverged_at}"
        return f"{self.n_steps} steps, {end}; {self.n_outside} outside the mesh (rule {self.rule!r})"


def _like(measured: Any, outputs: np.ndarray) -> np.ndarray:
    measured = np.asarray(measured, dtype=float)
    if measured.ndim == 1:
        measured = measured[:, None]
    if measured.shape != outputs.shape:
        raise InputError(f"measured outputs have shape {measured.shape}, the free run {outputs.shape}")
    return measured


@dataclass(frozen=True, eq=False)
class NARXModel:
    """y(k) = Π(C φ(k)) + Θ φ(k).

    Made by `NARX.fit` or `NARX.wrap`. Several outputs share one mesh, each with its own vertex values.

    Attributes
    ----------
    lags : Lags
        The orders.
    mesh : SimplexMesh
        In d dimensions.
    values : ndarray, shape (n_points, n_outputs)
        Vertex values of the maps.
    select : ndarray, shape (d, size of φ)
        C: the regressors, or combinations, along which the map bends.
    theta : ndarray, shape (n_outputs, size of φ)
        Θ: the linear part; zero when every regressor is meshed.
    limit : float
        A free run that exceeds it in magnitude has diverged.
    """

    lags: Lags
    mesh: SimplexMesh
    values: np.ndarray
    select: np.ndarray
    theta: np.ndarray
    limit: float

    def __post_init__(self) -> None:
        for name in ("values", "select", "theta"):
            array = np.array(getattr(self, name), dtype=float)
            check_finite(array, name)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        d, size = self.select.shape
        n_y = self.values.shape[1] if self.values.ndim == 2 else -1
        fits = self.values.shape == (self.mesh.n_points, n_y) and self.theta.shape == (n_y, size)
        if d != self.mesh.dimension or not fits:
            raise InputError(
                f"values {self.values.shape}, select {self.select.shape} and theta {self.theta.shape} do not fit a "
                f"mesh of {self.mesh.n_points} points in {self.mesh.dimension} dimensions"
            )

    @property
    def n_outputs(self) -> int:
        """How many outputs."""
        return self.values.shape[1]

    @property
    def first(self) -> int:
        """Index of the first sample that can be predicted."""
        return self.lags.first

    @property
    def n_inputs(self) -> int:
        """How many inputs."""
        per_input = self.lags.inputs + self.lags.direct
        return (self.select.shape[1] - self.n_outputs * self.lags.outputs) // per_input if per_input else 0

    @cached_property
    def maps(self) -> tuple[PWAMap, ...]:
        """The map of each output, over C φ."""
        return tuple(PWAMap(self.mesh, column) for column in self.values.T)

    @cached_property
    def tables(self) -> free_run.Tables:
        """What the compiled kernels read."""
        return free_run.tables(self.mesh, self.values, self.select, self.theta)

    def predict(self, recording: Recording, outside: str = "affine") -> np.ndarray:
        """One-step prediction from measured outputs, shape (N, n_outputs).

        The first `first` rows cannot be predicted and repeat the measured outputs.
        """
        phi, _ = self.lags.build(recording)
        self._check_size(phi.shape[1])
        X = phi @ self.select.T
        ahead = np.column_stack([pwa(X, outside=outside) for pwa in self.maps]) + phi @ self.theta.T
        return np.vstack([recording.outputs[: self.first], ahead])

    def simulate(self, recording: Recording, *, outside: str = "affine", limit: float | None = None) -> FreeRun:
        """Free run over a recording's inputs, started from its first `first` measured outputs."""
        if len(recording) <= self.first:
            raise InputError(f"{recording.name} has {len(recording)} samples; a free run needs over {self.first}")
        inputs = recording.inputs if self.n_inputs else recording.inputs[:, :0]  # a model of outputs alone takes none
        return self.free_run(inputs, recording.outputs[: self.first], outside=outside, limit=limit)

    def free_run(
        self, inputs: Any, initial: Any, *, outside: str = "affine", limit: float | None = None
    ) -> FreeRun | list[FreeRun]:
        """Free run from given initial outputs.

        Parameters
        ----------
        inputs : array_like, shape (N, n_inputs), (N,) for one input, or (B, N, n_inputs) for B trajectories
        initial : array_like, shape (first, n_outputs), or (B, first, n_outputs)
            The outputs at samples 0 … first − 1; a batch may share one.
        outside : {"affine", "clip", "raise"}
            The rule when the regressor leaves the mesh.
        limit : float, optional
            Magnitude at which a run counts as diverged; the model's `limit` by default.

        Returns
        -------
        FreeRun, or a list of B of them

        Raises
        ------
        OutsideMeshError
            The regressor left the mesh under the rule ``"raise"``.
        """
        if outside not in free_run.RULES:
            raise InputError(f"outside is {outside!r}; expected one of {', '.join(map(repr, free_run.RULES))}")
        u = np.asarray(inputs, dtype=float)
        u = u[:, None] if u.ndim == 1 else u
        batch = u.ndim == 3
        u = u if batch else u[None]
        if u.ndim != 3 or u.shape[2] != self.n_inputs:
            raise InputError(
                f"inputs have shape {np.shape(inputs)}; expected (N, {self.n_inputs}) or (B, N, {self.n_inputs})"
            )
        start = np.asarray(initial, dtype=float)
        if start.ndim == 1 and self.n_outputs == 1:
            start = start[:, None]
        start = start if start.ndim == 3 else start[None]
        if start.shape[1:] != (self.first, self.n_outputs) or start.shape[0] not in (1, len(u)):
            raise InputError(
                f"initial outputs have shape {np.shape(initial)}; expected ({self.first}, {self.n_outputs}), one row "
                "for each of the first samples"
            )
        if u.shape[1] <= self.first:
            raise InputError(f"{u.shape[1]} input samples came; lags of {self.first} need at least {self.first + 1}")
        check_finite(u, "inputs")
        check_finite(start, "initial")
        y = np.zeros((len(u), u.shape[1], self.n_outputs))
        y[:, : self.first] = start
        return self._run(y, u, outside, self.limit if limit is None else float(limit), batch)

    def _run(self, y, u, outside, limit, batch):
        state, end, n_outside = np.empty((3, len(u)), np.int64)
        lags = (self.lags.outputs, self.lags.inputs, int(self.lags.direct))
        rule = free_run.RULES.index(outside)
        free_run.run_batch(self.tables, y, np.ascontiguousarray(u), lags, rule, limit, state, end, n_outside)
        left = np.flatnonzero(state == free_run.LEFT)
        if left.size:
            b = int(left[0])
            raise OutsideMeshError(
                f"the free run left the mesh at sample {end[b]}{f' of trajectory {b}' if batch else ''}; use a "
                'larger mesh, or name a rule (outside="affine" or "clip")'
            )
        runs = [
            FreeRun(y[b], self.first, int(n_outside[b]), int(stop) if state[b] == free_run.DIVERGED else None, outside)
            for b, stop in enumerate(end)
        ]
        return runs if batch else runs[0]

    def _check_size(self, size: int) -> None:
        if size != self.select.shape[1]:
            raise InputError(
                f"the recording gives {size} regressors, the model has {self.select.shape[1]}; "
                "expected the channels it was fitted with"
            )

    def free_run_rmse(self, recordings: Sequence[Recording], outside: str = "affine") -> float:
        """RMSE of free runs over several recordings, all outputs together; infinite when one diverges."""
        runs = [self.simulate(r, outside=outside) for r in recordings]
        measured = np.concatenate([r.outputs[self.first :].ravel() for r in recordings])
        return rmse(measured, np.concatenate([run.outputs[self.first :].ravel() for run in runs]))
