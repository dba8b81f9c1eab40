"""The registry: the built-in catalogue and what users add.

A new effect takes ten lines::

    from pwaid.mismatch.effects import register
    from pwaid.mismatch.effects.base import Effect, Quantity, push

    def kernel(phase, t, h, x, xs, u, p, dx, ii, q):
        push(phase, -q[0] * x[ii[4]] ** 5, ii, u, p, dx)

    register(Effect("quintic_damping", "smooth_damping", "F = c * v^5",
                    (Quantity("c", "force/speed^5", 1e-4, 10.0, (0.1, 0.4)),), kernel,
                    lambda structure: structure.moving(), cached=False))
"""

from __future__ import annotations

from pwaid.errors import InputError
from pwaid.mismatch.effects import (
    actuator,
    between,
    coriolis,
    damping,
    friction,
    position,
    sensor,
    stores,
    time_effects,
    transmission,
)
from pwaid.mismatch.effects.base import Effect

__all__ = ["CATALOGUE", "effect_by_id", "register", "table"]

CATALOGUE: list[Effect] = [
    effect
    for group in (friction, damping, position, between, transmission, coriolis, actuator, sensor, stores, time_effects)
    for effect in group.EFFECTS
]


def register(effect: Effect) -> Effect:
    """Add an effect to the catalogue; the same id may appear with several laws."""
    if not isinstance(effect, Effect):
        raise InputError(f"register got a {type(effect).__name__}; expected an Effect")
    CATALOGUE.append(effect)
    return effect


def effect_by_id(name: str) -> list[Effect]:
    """Every law registered under an id.

    Raises
    ------
    InputError
        For an id that is not in the catalogue.
    """
    found = [e for e in CATALOGUE if e.id == name]
    if not found:
        raise InputError(f"unknown effect {name!r}; expected one of: {', '.join(sorted({e.id for e in CATALOGUE}))}")
    return found


def table() -> list[dict]:
    """One row per id: family, law, parameters, confused_with, separated_by."""
    rows: dict[str, dict] = {}
    for e in CATALOGUE:
        row = rows.setdefault(e.id, {
            "id": e.id, "family": e.family, "law": e.law, "parameters": [q.name for q in e.quantities],
            "confused_with": list(e.confused_with), "separated_by": e.separated_by})
        row["parameters"] += [q.name for q in e.quantities if q.name not in row["parameters"]]
    return list(rows.values())
