"""Recordings: uniformly sampled inputs and outputs with names and units.

A `Recording` is data only: time along the first axis, read-only arrays, checked once when it is made.
Files of columns are read by `pwaid.tables`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pwaid.errors import InputError
from pwaid.tables import read_mat, read_table

__all__ = ["Recording", "check_finite", "check_samples"]

# A sample may lie this far from the uniform grid, as a fraction of the sample time, before it counts as wrong.
# 5 % is far above the rounding of printed times and far below a lost sample (100 %).
TIME_TOLERANCE = 0.05


def check_finite(array: np.ndarray, name: str) -> None:
    """Raise `InputError` naming the first NaN or infinite entry of `array`."""
    bad = ~np.isfinite(array)
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            f"{name} has {int(bad.sum())} entries that are NaN or infinite, the first at index {where}; "
            "expected finite numbers: drop or fill these samples first"
        )


def check_samples(
    X: Any, y: Any, *, dimension: int | None = None, part: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Samples of a map as float arrays X (N, d) and y (N,), or one clear `InputError`.

    Parameters
    ----------
    X : array_like, shape (N, d) or (N,)
        Inputs, one sample a row; a vector is taken as d = 1.
    y : array_like, shape (N,) or (N, 1)
        Outputs.
    dimension : int, optional
        The d that is expected.
    part : bool
        Whether they are some of all the samples, so that few will do.
    """
    X = _as_float(X, "X")
    y = _as_float(y, "y")
    if X.ndim == 1:
        X = X[:, None]
    if X.ndim != 2:
        raise InputError(f"X has shape {X.shape}; expected (N, d): one sample a row")
    if y.ndim == 2 and y.shape[1] == 1:
        y = y[:, 0]
    if y.ndim != 1:
        raise InputError(f"y has shape {y.shape}; expected (N,): fit one output at a time")
    if X.shape[0] != y.shape[0]:
        if X.shape[1] == y.shape[0]:
            raise InputError(f"X has shape {X.shape} for {y.shape[0]} outputs: it looks transposed; pass X.T")
        raise InputError(f"X has {X.shape[0]} samples and y has {y.shape[0]}; expected the same number")
    if dimension is not None and X.shape[1] != dimension:
        raise InputError(f"X has {X.shape[1]} columns; expected {dimension}, the dimension of the mesh")
    check_finite(X, "X")
    check_finite(y, "y")
    if X.shape[0] < X.shape[1] + 2 and not part:
        raise InputError(
            f"{X.shape[0]} samples came; an affine map of {X.shape[1]} inputs and a hinge need at least "
            f"{X.shape[1] + 2}: record more samples"
        )
    return X, y


def _as_float(array: Any, name: str) -> np.ndarray:
    try:
        given = np.asarray(array)
        if given.dtype.kind in "mMc" or np.ma.isMaskedArray(array):
            kind = "masked numbers" if np.ma.isMaskedArray(array) else f"{given.dtype} values"
            raise InputError(f"{name} holds {kind}; expected real numbers")
        return np.asarray(array, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} cannot be read as numbers ({error}); expected a numeric array") from error


def _seconds(time: Any) -> np.ndarray:
    """Time stamps as seconds; dates count from the first one."""
    stamps = np.asarray(time)
    if stamps.dtype.kind in "mM":
        if np.isnat(stamps).any():
            raise InputError("time has stamps that are no times (NaT); drop these samples first")
        start = stamps.ravel()[:1] if stamps.dtype.kind == "M" else np.timedelta64(0, "s")
        return (stamps - start) / np.timedelta64(1, "s")
    return _as_float(time, "time")


def _columns(array: Any, name: str, n_samples: int) -> np.ndarray:
    """A channel block as a read-only (N, k) array; a vector is one channel."""
    array = _as_float(array, name)
    if array.size == 0 and array.ndim < 2:
        array = np.zeros((n_samples, 0))
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2:
        raise InputError(f"{name} has shape {array.shape}; expected (N, channels): time along the first axis")
    if array.shape[0] != n_samples:
        hint = "; it looks transposed: pass its .T" if array.shape[1] == n_samples else ""
        raise InputError(f"{name} has {array.shape[0]} rows for {n_samples} time stamps; expected one a time{hint}")
    check_finite(array, name)
    array = array.copy()
    array.setflags(write=False)
    return array


def _sample_time(time: np.ndarray) -> float:
    """The sample time of a uniform clock, or an `InputError` that says where it is not uniform."""
    if time.size < 2:
        raise InputError(f"{time.size} samples came; a recording needs at least 2")
    check_finite(time, "time")
    steps = np.diff(time)
    back = np.flatnonzero(steps <= 0)
    if back.size:
        k = int(back[0])
        raise InputError(
            f"time goes backwards or stands still at sample {k + 1} ({time[k]:g} s, then {time[k + 1]:g} s); "
            "expected strictly increasing seconds: sort the rows, or split the file into recordings"
        )
    sample_time = float((time[-1] - time[0]) / (time.size - 1))
    off = np.abs(time - (time[0] + sample_time * np.arange(time.size))) / sample_time
    worst = int(np.argmax(np.abs(steps - np.median(steps))))
    if off.max() > TIME_TOLERANCE and abs(steps[worst] / np.median(steps) - 1.0) > 0.01:
        raise InputError(
            f"time is not uniformly sampled: the step after sample {worst} ({time[worst]:g} s) is "
            f"{steps[worst]:g} s, the usual step {np.median(steps):g} s; resample to a uniform clock, "
            "split at the gap, or pass sample_time= if the stamps are only rounded"
        )
    return sample_time


@dataclass(frozen=True, eq=False)
class Recording:
    """One uniformly sampled recording of a machine.

    Parameters
    ----------
    time : array_like, shape (N,)
        Time stamps in seconds, strictly increasing and uniform; dates count from the first one.
    inputs : array_like, shape (N, n_inputs) or (N,)
        What drives the machine.
    outputs : array_like, shape (N, n_outputs) or (N,)
        What is measured.
    input_names, output_names : sequence of str, optional
        Channel names; ``u0, u1, …`` and ``y0, y1, …`` by default.
    units : mapping of name to unit, optional
        E.g. ``{"u": "N m", "theta": "rad"}``; channels without an entry have the unit ``""``.
    name : str
        What the recording is called in reports.

    Raises
    ------
    InputError
        Non-finite entries, wrong shapes, repeated names, or a clock that is not uniform.
    """

    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    input_names: tuple[str, ...] | None = None
    output_names: tuple[str, ...] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    name: str = "recording"

    def __post_init__(self) -> None:
        time = _seconds(self.time)
        if time.ndim != 1:
            raise InputError(f"time has shape {time.shape}; expected a vector of seconds")
        object.__setattr__(self, "_sample_time", _sample_time(time))
        time = time.copy()
        time.setflags(write=False)
        object.__setattr__(self, "time", time)
        for block, letter in (("inputs", "u"), ("outputs", "y")):
            array = _columns(getattr(self, block), block, time.size)
            object.__setattr__(self, block, array)
            key = block[:-1] + "_names"
            names = getattr(self, key)
            if names is None:
                names = tuple(f"{letter}{i}" for i in range(array.shape[1]))
            names = (names,) if isinstance(names, str) else tuple(str(n) for n in names)
            if len(names) != array.shape[1]:
                raise InputError(f"{len(names)} {key} came for {array.shape[1]} {block}; expected one a channel")
            object.__setattr__(self, key, names)
        every = self.input_names + self.output_names
        repeated = sorted({n for n in every if every.count(n) > 1})
        if repeated:
            raise InputError(f"channel names {repeated} are used twice; expected different names")
        unknown = sorted(set(self.units) - set(every))
        if unknown:
            raise InputError(f"units were given for {unknown}, which are not channels; the channels are {list(every)}")
        object.__setattr__(self, "units", {n: str(self.units.get(n, "")) for n in every})

    # -- reading ---------------------------------------------------------------------------------------------

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        inputs: Sequence[str],
        outputs: Sequence[str],
        *,
        units: Mapping[str, str] | None = None,
        **clock: Any,
    ) -> Recording:
        """Read a CSV file with a header line ``name``, ``name [unit]`` or ``name (unit)`` a column.

        `units` go before those of the header; `clock` is `time` or `sample_time`, as in `from_columns`.
        """
        columns, found = read_table(path)
        units = {**found, **(units or {})}
        return cls.from_columns(columns, inputs, outputs, units=units, name=Path(path).name, **clock)

    @classmethod
    def from_mat(cls, path: str | Path, inputs: Sequence[str], outputs: Sequence[str], **options: Any) -> Recording:
        """Read vectors of a MATLAB file (up to version 7.2), named as in the file.

        `options` are `time`, `sample_time` and `units`, as in `from_columns`.
        """
        return cls.from_columns(read_mat(path), inputs, outputs, name=Path(path).name, **options)

    @classmethod
    def from_frame(
        cls,
        frame: Any,
        inputs: Sequence[str],
        outputs: Sequence[str],
        *,
        time: str | None = "t",
        sample_time: float | None = None,
        units: Mapping[str, str] | None = None,
        name: str = "frame",
    ) -> Recording:
        """From a pandas frame; the index serves as time when `time` is None and no `sample_time` is given."""
        columns = {str(c): np.asarray(frame[c]) for c in frame.columns}
        if time is None and sample_time is None:
            time = "index"
            columns[time] = _seconds(frame.index)
        return cls.from_columns(
            columns, inputs, outputs, time=time, sample_time=sample_time, units=units, name=name
        )

    @classmethod
    def from_columns(
        cls,
        columns: Mapping[str, Any],
        inputs: Sequence[str],
        outputs: Sequence[str],
        *,
        time: str | None = "t",
        sample_time: float | None = None,
        units: Mapping[str, str] | None = None,
        name: str = "recording",
    ) -> Recording:
        """From a mapping of column name to vector.

        Parameters
        ----------
        columns : mapping of str to array_like, shape (N,)
        inputs, outputs : sequence of str
            Which columns drive the machine and which are measured; one name may stand alone.
        time : str, optional
            The column of time stamps in seconds.
        sample_time : float, optional
            Seconds between samples; the time column is then ignored, e.g. because its stamps are rounded.
        units : mapping of name to unit, optional
            Entries for columns that are not used are left out.
        name : str
            What the recording is called in reports.

        Raises
        ------
        InputError
            A missing column, no clock, columns of different lengths, or what `Recording` itself refuses.
        """
        inputs = [inputs] if isinstance(inputs, str) else list(inputs)
        outputs = [outputs] if isinstance(outputs, str) else list(outputs)
        wanted = [*inputs, *outputs] + ([time] if sample_time is None and time is not None else [])
        missing = [c for c in wanted if c not in columns]
        if missing:
            raise InputError(f"{name} has no column {missing[0]!r}; its columns are {sorted(columns)}")
        n_samples = len(columns[wanted[0]]) if wanted else 0
        if sample_time is not None:
            if not (np.isfinite(sample_time) and sample_time > 0):
                raise InputError(f"sample_time is {sample_time}; expected positive seconds")
            clock = sample_time * np.arange(n_samples)
        elif time is not None:
            clock = columns[time]
        else:
            raise InputError("neither a time column nor sample_time= was given; name one of them")

        def block(names: list[str], what: str) -> np.ndarray:
            rows = [_as_float(columns[c], f"column {c!r}") for c in names]
            lengths = {r.shape for r in rows}
            if len(lengths) > 1:
                raise InputError(f"{what} of {name} have different lengths {sorted(lengths)}; expected the same")
            return np.column_stack(rows) if rows else np.zeros((n_samples, 0))

        used = {k: v for k, v in (units or {}).items() if k in (*inputs, *outputs)}
        return cls(clock, block(inputs, "inputs"), block(outputs, "outputs"), tuple(inputs), tuple(outputs), used, name)

    # -- looking ---------------------------------------------------------------------------------------------

    def __len__(self) -> int:
        return self.time.size

    @property
    def sample_time(self) -> float:
        """Seconds between samples."""
        return self._sample_time  # type: ignore[attr-defined]

    @property
    def names(self) -> tuple[str, ...]:
        """Input names, then output names."""
        return self.input_names + self.output_names  # type: ignore[operator]

    def __getitem__(self, key: str | slice) -> Any:
        """A channel by name, shape (N,), or a slice of samples as a new recording."""
        if isinstance(key, slice):
            return self.replace(time=self.time[key], inputs=self.inputs[key], outputs=self.outputs[key])
        for names, block in ((self.input_names, self.inputs), (self.output_names, self.outputs)):
            if key in names:
                return block[:, names.index(key)]
        raise InputError(f"{self.name} has no channel {key!r}; its channels are {list(self.names)}")

    # -- changing (copies) -----------------------------------------------------------------------------------

    def replace(self, **changes: Any) -> Recording:
        """A copy with some fields changed."""
        from dataclasses import replace

        return replace(self, **changes)

    def between(self, start: float, stop: float) -> Recording:
        """The samples with ``start <= time < stop``, in seconds."""
        keep = np.flatnonzero((self.time >= start) & (self.time < stop))
        if keep.size < 2:
            raise InputError(
                f"{keep.size} samples lie in [{start:g}, {stop:g}) s; the recording spans "
                f"[{self.time[0]:g}, {self.time[-1]:g}] s"
            )
        return self[keep[0] : keep[-1] + 1]

    def split(self, fraction: float = 0.5) -> tuple[Recording, Recording]:
        """Estimation and validation part: the first `fraction` of the samples and the rest, not shuffled."""
        if not 0.0 < fraction < 1.0:
            raise InputError(f"fraction is {fraction}; expected a number between 0 and 1")
        cut = round(fraction * len(self))
        if cut < 2 or len(self) - cut < 2:
            raise InputError(f"a split at {fraction} of {len(self)} samples leaves a part of fewer than 2")
        return self[:cut], self[cut:]

    def decimate(self, factor: int) -> Recording:
        """Every `factor`-th sample, without filtering: apply an anti-alias filter first where it matters."""
        if factor < 1 or int(factor) != factor:
            raise InputError(f"factor is {factor}; expected a whole number of at least 1")
        return self[:: int(factor)]
