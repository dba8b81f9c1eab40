"""The catalogue of left-out physics: one file per family, one registry."""

from pwaid.mismatch.effects.registry import CATALOGUE, effect_by_id, register, table

__all__ = ["CATALOGUE", "effect_by_id", "register", "table"]
