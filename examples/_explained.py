"""What the explain scripts on the papers' systems share: named friction as a curve, and the result keys."""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.lawcurve import law_over


def named_laws(report) -> list[tuple]:
    """(effect id, channel, parameters by name) of every effect of the repaired simulator."""
    h = report.best
    return [(e.effect.id, e.place.channel,
             dict(zip([q.name for q in e.effect.quantities], map(float, v), strict=False)))
            for e, v in zip(h.located, h.values(), strict=True)]


def friction(report, channel: str, dry: bool = True):
    """The named laws at the speed of a channel as a force against the motion, over speed; zero where none was named.

    With ``dry`` only dry friction counts; otherwise every law there (drag, one-sided viscous friction, offsets).
    """
    h, names = report.best, report.problem.plant.state_names
    laws = [(i, e, values) for i, (e, values) in enumerate(zip(h.located, h.values(), strict=True))
            if e.place.channel == channel and (e.effect.family == "dry_friction" or not dry)]

    def force(speed):
        v, total = np.atleast_1d(np.asarray(speed, float)), np.zeros(np.size(speed))
        for i, e, values in laws:
            if e.effect.memory:
                total += values[0] * np.sign(v)  # the level that sliding reaches
            else:
                total -= law_over(report.problem, h, names[e.place.ii[4]], v, i)
        return total.reshape(np.shape(speed))

    return force


def outcome(report, test: str, output: str, case) -> dict:
    """The RESULT keys that every explain script prints; errors are held-out RMSE of one output."""
    fit = report.fit[test][output]
    return {
        "verdict": report.verdict, "effects": [e["id"] for e in report.effects],
        "channels": [where for _, where, _ in named_laws(report)],
        "error_nominal": fit["nominal"]["rmse"], "error_refitted": fit["refitted"]["rmse"],
        "error_repaired": fit["repaired"]["rmse"], "seconds": report.content["seconds"], "case": str(case),
    }
