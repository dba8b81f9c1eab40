"""The numbers a verdict depends on, set on calibration cases and frozen (docs/mismatch.md says how)."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Thresholds"]


@dataclass(frozen=True)
class Thresholds:
    """The numbers a verdict depends on."""

    material: float = 2.0  # mean square of the null, relative to the floor's, that counts: as much as noise;
    # a second law must remove as much again
    trifle: float = 2e-3  # of an output's standard deviation: an error below it is never a mismatch
    small: float = 0.15  # of an output's standard deviation: a residual below it may be a mere disturbance ...
    predicted: float = 0.15  # ... when past inputs predict less than this share of it
    share: float = 0.5  # of the explainable held-out error, with a trusted floor
    share_tentative: float = 0.45  # without one
    inner: float = 0.9  # of either is enough for a law inside one that passes
    pair_share: float = 0.9  # by two laws together, which bend to much;
    pair_share_quiet: float = 0.7  # where noise is small beside what they leave (see `quiet`), or where no single law
    # passes and maps find nothing in it
    second_share: float = 0.35  # of what the single effect left
    nested_gain: float = 0.1  # error the larger of two nested laws must remove beyond the smaller
    nested_share: float = 0.002  # ... and its share of the error without either of them,
    nested_floor: float = 0.05  # ... and of the floor's mean square, or of what it leaves itself; in training too
    rival: float = 1.15  # error ratio within which a rival of another law is not excluded
    wins: float = 0.8  # share of block bootstraps the winner must win
    evidence: float = 50.0  # the held-out log-likelihood, residuals white, must rise by this much with every law
    found: float = 0.1  # maps on top of the effect may find this share of the rise that they and it make together;
    found_quiet: float = 0.5  # where noise is small beside what is left (see `quiet`), as much as a single law itself;
    unfound: float = 0.01  # below it they find nothing, and what they seem to remove does not count
    near: float = 1.3  # held-out mean square after an effect, relative to the floor's, that needs no excuse; beyond it
    mapped: float = 0.3  # maps may remove no more than this share of the excess, held out,
    validated: float = 0.15  # (where they explain at least this share in blocks of training time left out,)
    certain: float = 0.5  # nor explain more than this share there, whatever they do on held-out recordings,
    residue: float = 0.002  # (unless it is less than this share of the null's error,)
    quiet: float = 100.0  # (or noise is so small beside what is left that no simulator would do);
    left: float = 2.0  # beyond this multiple of the floor, moreover,
    left_predicted: float = 0.3  # no more of it than this may follow from the inputs,
    trace: float = 0.05  # (unless that is less than this share of what there was to explain; the same for what maps
    # explain to `certain` where likelihoods see nothing in it,)
    reach: float = 2.9  # no nominal parameter may have moved by more than this many tolerances,
    outgrown: float = 4.0  # and held-out recordings may not leave this many times more than training,
    outgrowing: float = 2.0  # (above the floor this many times that, and this many times what the null's error grows;)
    outdone: float = 0.5  # no law refused so may leave less than this share of what the effect leaves
    moved: float = 0.02  # a parameter that moved by this share of its value counts as wrong
