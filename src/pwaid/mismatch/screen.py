"""The signature screen: which effects could explain the residual, before any of them is fitted.

A candidate is injected at a few physically sized magnitudes; the change it makes in the simulated
outputs is its signature. What nominal parameters and start states could have absorbed is projected
out of signature and residual; the squared correlation of what is left is the score. This is a
Lagrange-multiplier test with a finite step, so thresholds whose derivative at zero vanishes are
seen too, and it costs two or three simulations per candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from pwaid.mismatch.effects.base import Effect
from pwaid.mismatch.fit import Fit
from pwaid.mismatch.model import Located
from pwaid.mismatch.nullfit import Problem
from pwaid.mismatch.signatures import Signature, Signatures, mirrored, one_signed
from pwaid.mismatch.structure import Structure

__all__ = ["Screened", "locate_effects", "other_laws", "overlooked", "run_jobs", "screen", "shortlist"]

ABSORBED = 1e-5  # a small signature of which less than this share is left is a nominal parameter in disguise
STARTS = 4  # of a candidate that are kept
APART = 2.0  # over the reach of the position: wavenumbers closer than that are one start
AGAINST = 0.3  # factor on the score of a law that would have to act against its sign: the null may be bent far


@dataclass(frozen=True)
class Screened:
    """A candidate with its score, its best starts on the fitted axis, and the share of it that parameters absorb."""

    located: Located
    score: float
    starts: tuple[np.ndarray, ...]
    visible: float


def locate_effects(effects: Sequence[Effect], structure: Structure,
                   without: Sequence[str] = ()) -> list[Located]:
    """Every effect at every place where this simulator lets it in."""
    return [Located(e, place) for e in effects if e.id not in without for place in e.places(structure)]


def run_jobs(function, items, jobs: int):
    """Map over threads: the compiled loop releases the interpreter lock."""
    items = list(items)
    if jobs <= 1 or len(items) < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(function, items))


def screen(problem: Problem, fit: Fit, located: Sequence[Located], jobs: int = 1) -> list[Screened]:
    """Score every candidate on top of `fit` (the null, or a hypothesis already accepted), best first.

    `fit` is a fit to `problem.coarse`.
    """
    signatures = Signatures(problem, fit)

    def one(candidate: Located) -> Screened:
        """Score one candidate by its best probe."""
        scored, visible = [], 0.0
        probed = signatures.of(candidate)
        for s in probed:
            visible = max(visible, s.share)
            if s.seen:
                against = s.dot < 0 and one_signed(candidate)
                score = (AGAINST if against else 1.0) * s.dot * s.dot / signatures.power
                scored.append((score, tuple(s.start if s.dot > 0 or against else mirrored(s.start))))
        scored.sort(key=lambda item: -item[0])
        best = scored[0][0] if scored else 0.0
        if best > 0 and visible < 0.02 and signatures.share_of_small(candidate, scored[0][1]) < ABSORBED:
            best = 0.0
        starts = _ripple_starts(probed) if candidate.effect.id == "position_ripple" else [z for _, z in scored[:STARTS]]
        return Screened(candidate, best, tuple(np.array(z) for z in starts), visible)

    found = run_jobs(one, located, jobs)
    return sorted(found, key=lambda s: -s.score)


def _ripple_starts(signatures: Sequence[Signature]) -> list[np.ndarray]:
    """Starts of a ripple at the wavenumbers, well apart, at which a sine and a cosine together tell most, with the
    phase that they give."""
    pairs: dict[float, list[Signature]] = {}
    for s in signatures:
        pairs.setdefault(float(s.start[1]), []).append(s)
    ranked = []
    for pair in (p for p in pairs.values() if len(p) == 2 and all(s.seen for s in p)):
        sine, cosine = sorted(pair, key=lambda s: s.start[2])
        dots, alike = np.array([sine.dot, cosine.dot]), float(sine.direction @ cosine.direction)
        weights = np.linalg.lstsq(np.array([[1.0, alike], [alike, 1.0]]), dots, rcond=1e-6)[0]
        phase = float(np.arctan2(weights[1], weights[0]))
        ranked.append((float(weights @ dots), np.array([*sine.start[:2], phase])))
    chosen: list[np.ndarray] = []
    for _, z in sorted(ranked, key=lambda r: -r[0]):
        if len(chosen) < STARTS and all(abs(np.exp(z[1]) - np.exp(c[1])) > APART for c in chosen):
            chosen.append(z)
    return chosen


def shortlist(screened: Sequence[Screened], top: int = 8, per_family: float = 0.3,
              limit: int = 14) -> list[Screened]:
    """The best few, the best of each family within reach of the winner, one place per law unless it scores alike."""
    alive = [s for s in screened if s.score > 0]
    if not alive:
        return []
    best = alive[0].score
    chosen = [s for s in screened if not s.located.effect.quantities]  # no size to probe: the fit must tell
    seen: dict[tuple, int] = {}
    for s in alive:
        key = (s.located.effect.id, s.located.effect.law)
        if s in chosen:
            continue
        if len(chosen) < top and seen.get(key, 0) < 2 and (s.score > 0.12 * best or len(chosen) < 3):
            chosen.append(s)
            seen[key] = seen.get(key, 0) + 1
    for s in alive:  # a law inside a chosen law is always fitted beside it
        inside = any(s.located.effect.id in c.located.effect.contains
                     and s.located.place.signal == c.located.place.signal for c in chosen)
        if inside and s not in chosen:
            chosen.append(s)
    chosen += other_laws(chosen, alive)  # and so is another law of the same effect, at its best place
    ids = {s.located.effect.id for s in chosen}
    families = {s.located.effect.family for s in chosen}
    for s in alive:
        effect = s.located.effect
        if len(chosen) >= limit:
            break
        fresh = effect.family not in families and s.score > per_family * best
        nested = effect.id not in ids and bool(set(effect.contains) & ids)
        parent = effect.id not in ids and any(effect.id in c.located.effect.contains for c in chosen[:4])
        if fresh or nested or parent:
            chosen.append(s)
            families.add(effect.family)
            ids.add(effect.id)
    return chosen


def other_laws(chosen: Sequence, ranked: Sequence, located=lambda s: s.located) -> list:
    """The first in `ranked` of every law that effects among the chosen have besides the chosen ones."""
    ids = {located(s).effect.id for s in chosen}
    laws, found = {(located(s).effect.id, located(s).effect.law) for s in chosen}, []
    for s in ranked:
        law = located(s).effect.id, located(s).effect.law
        if law[0] in ids and law not in laws:
            laws.add(law)
            found.append(s)
    return found


def overlooked(screened: Sequence[Screened], chosen: Sequence[Screened]) -> list[Screened]:
    """The best place of every effect that is not among the chosen.

    A threshold that the null has absorbed with bent parameters, such as a small backlash, has no signature there.
    """
    ids, found = {s.located.effect.id for s in chosen}, []
    for s in screened:
        if s.score > 0 and s.located.effect.id not in ids:
            ids.add(s.located.effect.id)
            found.append(s)
    return found
