"""What the explain scripts on the papers' systems share: named dry friction as a curve, and the result keys."""

from __future__ import annotations

import numpy as np


def named_laws(report) -> list[tuple]:
    """(effect id, channel, parameters by name) of every effect of the repaired simulator."""
    h = report.best
    return [(e.effect.id, e.place.channel,
             dict(zip([q.name for q in e.effect.quantities], map(float, v), strict=False)))
            for e, v in zip(h.located, h.values(), strict=True)]


def dry_friction(report, channel: str):
    """The named dry friction at a channel as a function of speed; zero where none was named."""
    laws = [(name, q) for name, where, q in named_laws(report) if where == channel]

    def level(v):
        v = np.asarray(v, dtype=float)
        total = np.zeros_like(v)
        for name, q in laws:
            if name in ("coulomb_friction", "presliding_friction", "load_dependent_friction"):
                total += q["level"] * np.sign(v)
            elif name == "asymmetric_coulomb_friction":
                total += np.where(v > 0, q["level_positive"], -q["level_negative"])
            elif name == "stribeck_friction":
                total += (q["level"] + q["excess"] * np.exp(-((v / q["stribeck_speed"]) ** 2))) * np.sign(v)
        return total

    return level


def outcome(report, test: str, output: str, case) -> dict:
    """The RESULT keys that every explain script prints; errors are held-out RMSE of one output."""
    fit = report.fit[test][output]
    return {
        "verdict": report.verdict, "effects": [e["id"] for e in report.effects],
        "channels": [where for _, where, _ in named_laws(report)],
        "error_nominal": fit["nominal"]["rmse"], "error_refitted": fit["refitted"]["rmse"],
        "error_repaired": fit["repaired"]["rmse"], "seconds": report.content["seconds"], "case": str(case),
    }
