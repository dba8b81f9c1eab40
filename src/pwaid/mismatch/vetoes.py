"""Physics vetoes: a fitted effect that cannot be what its name says."""

from __future__ import annotations

import numpy as np

from pwaid.mismatch.hypotheses import Hypothesis

__all__ = ["at_bound", "veto"]


def at_bound(h: Hypothesis, tolerance: float = 1e-6) -> list[str]:
    """Names of effect parameters that ended at a bound."""
    low, high = h.fit.model.bounds(1.0)
    found, k = [], h.fit.model.np
    for e in h.located:
        for q in e.effect.quantities:
            if q.name not in ("stiffness", "contact_frequency") and (
                    abs(h.fit.theta[k] - high[k]) < tolerance or abs(h.fit.theta[k] - low[k]) < tolerance):
                found.append(q.name)
            k += 1
    return found


def veto(h: Hypothesis) -> str:
    """Why this hypothesis cannot stand, or an empty text."""
    k = h.fit.model.np
    for e in h.located:
        z = h.fit.theta[k:k + e.size]
        k += e.size
        values = e.physical(z)
        if not np.all(np.isfinite(values)):
            return "its parameters are not finite"
        first = e.effect.quantities[0] if e.effect.quantities else None
        if first is not None and first.log and z[0] <= np.log(first.low) + 1e-6:
            return f"{first.name} went to zero"
        if e.effect.id == "end_stop" and abs(z[1]) >= 0.9999:
            return "the stop lies outside the travelled range"
        if e.effect.id in ("sensor_saturation", "actuator_saturation", "overflow"):
            top = z[0] if not first.log else np.exp(z[0])
            if top >= 0.9995 and first.high <= 1.0:
                return "the limit lies outside the visited range"
    return ""
