"""What the explain scripts on the papers' systems share: named friction as a curve, and the result keys."""

from __future__ import annotations

import numpy as np


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
    h, plant = report.best, report.problem.plant
    p = h.fit.model.parameters(h.fit.theta)
    laws = [(e, np.concatenate([values, e.place.constants])) for e, values in zip(h.located, h.values(), strict=True)
            if e.place.channel == channel and (e.effect.family == "dry_friction" or not dry)]

    def force(v: float) -> float:
        total, (nx, nu, _) = 0.0, plant.sizes
        for e, q in laws:
            ii, x, u, dx, column = np.array(e.place.ii), np.zeros(nx), np.zeros(nu), np.zeros(nx), np.zeros(nx)
            x[ii[4]], column[ii[4]] = v, np.sign(v)  # friction acts against the motion
            if e.effect.memory:
                total += q[0] * np.sign(v)  # the level that sliding reaches
            elif e.effect.proximal:
                e.effect.compiled()(5, 0.0, 0.0, x, column, u, p, dx, ii, q)
                total -= dx[ii[4]]
            else:
                for phase in (1, 2):
                    e.effect.compiled()(phase, 0.0, 0.0, x, x, u, p, dx, ii, q)
                total -= np.sum(u) + dx[ii[2]] / report.problem.structure.mobility[ii[4]]
        return total

    return np.vectorize(force, otypes=[float])


def outcome(report, test: str, output: str, case) -> dict:
    """The RESULT keys that every explain script prints; errors are held-out RMSE of one output."""
    fit = report.fit[test][output]
    return {
        "verdict": report.verdict, "effects": [e["id"] for e in report.effects],
        "channels": [where for _, where, _ in named_laws(report)],
        "error_nominal": fit["nominal"]["rmse"], "error_refitted": fit["refitted"]["rmse"],
        "error_repaired": fit["repaired"]["rmse"], "seconds": report.content["seconds"], "case": str(case),
    }
