"""Recordings laid end to end, cut into segments that each start from their own free state."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pwaid.errors import InputError
from pwaid.recording import Recording

__all__ = ["Dataset"]


def _end_to_end(lengths) -> np.ndarray:
    """Segments (n, 4) of recordings of these lengths, each one segment."""
    bounds = np.cumsum([0, *lengths])
    return np.array([(a, b, a, b) for a, b in itertools.pairwise(bounds)], dtype=np.int64)


@dataclass(frozen=True)
class Dataset:
    """Inputs U (N, nu) and outputs Y (N, ny) of several recordings.

    `segments` (n_segments, 4 or 5) holds first and last+1 sample of each segment, then of its recording;
    the latter give delayed inputs their history. A fifth column counts the samples that ran before what is held of the
    recording, for laws bound to the clock. `before` holds inputs (n, nu) that precede each recording,
    for simulators that can only start at rest; empty where there are none.
    """

    names: tuple[str, ...]
    U: np.ndarray
    Y: np.ndarray
    segments: np.ndarray
    sample_time: float
    before: tuple[np.ndarray, ...] = ()

    @classmethod
    def from_recordings(cls, recordings: Sequence[Recording]) -> Dataset:
        """One segment per recording.

        Raises
        ------
        InputError
            When there is none, or the recordings differ in sampling or channels.
        """
        if not recordings:
            raise InputError("no recording came; expected at least one")
        first = recordings[0]
        for r in recordings[1:]:
            if abs(r.sample_time / first.sample_time - 1) > 1e-3:
                raise InputError(f"{r.name} is sampled every {r.sample_time:g} s and {first.name} every "
                                 f"{first.sample_time:g} s; resample them to one clock")
            if r.input_names != first.input_names or r.output_names != first.output_names:
                raise InputError(f"{r.name} has the channels {r.names} and {first.name} {first.names}; "
                                 "expected the same channels in the same order")
        return cls(tuple(r.name for r in recordings),
                   np.ascontiguousarray(np.vstack([r.inputs for r in recordings])),
                   np.ascontiguousarray(np.vstack([r.outputs for r in recordings])),
                   _end_to_end([len(r.time) for r in recordings]), float(first.sample_time))

    @property
    def recordings(self) -> np.ndarray:
        """(n_recordings, 2) first and last+1 sample of each recording."""
        return np.unique(self.segments[:, 2:4], axis=0)

    def cut(self, samples: int) -> Dataset:
        """Segments of about `samples` samples instead of whole recordings."""
        rows = []
        for recording in np.unique(self.segments[:, 2:], axis=0):
            a, b = recording[:2]
            pieces = max(1, round((b - a) / samples))
            edges = np.linspace(a, b, pieces + 1).astype(np.int64)
            rows += [(i, j, *recording) for i, j in itertools.pairwise(edges)]
        return replace(self, segments=np.array(rows, dtype=np.int64))

    def windows(self, spans) -> tuple[Dataset, np.ndarray]:
        """Stretches of samples (first, last+1), each a recording of its own that is cut where segments are and keeps
        its clock; and the index of their samples here."""
        keep, rows, names, new = [], [], [], 0
        firsts, recordings = self.segments[:, 0], self.recordings
        for a, b in spans:
            own = int(np.searchsorted(recordings[:, 0], a, side="right")) - 1
            ran = a - recordings[own, 0] + self._ran(recordings[own, 0])
            edges = [a, *firsts[(firsts > a) & (firsts < b)], b]
            rows += [(i - a + new, j - a + new, new, new + b - a, ran) for i, j in itertools.pairwise(edges)]
            names.append(self.names[own])
            keep.append(np.arange(a, b))
            new += b - a
        index = np.concatenate(keep)
        return Dataset(tuple(names), np.ascontiguousarray(self.U[index]), np.ascontiguousarray(self.Y[index]),
                       np.array(rows, dtype=np.int64), self.sample_time), index

    def _ran(self, begin) -> int:
        """Samples that ran before what is held of the recording that begins here."""
        own = self.segments[self.segments[:, 2] == begin]
        return int(own[0, 4]) if self.segments.shape[1] > 4 else 0

    def openings(self, samples: int) -> Dataset:
        """The first samples of every segment, each as a recording of its own."""
        return self.windows([(a, min(a + samples, b)) for a, b in self.segments[:, :2]])[0]

    def heads(self, longer: Dataset) -> np.ndarray:
        """Which segments are the first of those of `longer`, the same samples in longer segments."""
        return np.searchsorted(self.segments[:, 0], longer.segments[:, 0])

    def after(self, samples: int) -> Dataset:
        """The same recordings, before which so many samples of each have run."""
        if not samples:
            return self
        clock = np.full((len(self.segments), 1), samples)
        return replace(self, segments=np.hstack([self.segments[:, :4], clock]))

    def and_also(self, other: Dataset) -> Dataset:
        """This data set and another of the same channels and sampling, as one."""
        width = max(self.segments.shape[1], other.segments.shape[1])
        rows, behind = (np.pad(d.segments, ((0, 0), (0, width - d.segments.shape[1]))) for d in (self, other))
        behind[:, :4] += len(self.U)
        return Dataset(self.names + other.names, np.vstack([self.U, other.U]), np.vstack([self.Y, other.Y]),
                       np.vstack([rows, behind]), self.sample_time, self.before + other.before)

    def without_start(self, samples: int) -> Dataset:
        """The first samples of every recording left out of the comparison; their inputs are kept as `before`."""
        rec = self.recordings
        keep = np.concatenate([np.arange(a + samples, b) for a, b in rec])
        return replace(self, U=np.ascontiguousarray(self.U[keep]), Y=np.ascontiguousarray(self.Y[keep]),
                       segments=_end_to_end([b - a - samples for a, b in rec]),
                       before=tuple(self.U[a:a + samples] for a, _ in rec))
