"""Explain the mismatch between a simulator and recordings.

>>> from pwaid.mismatch import effects_table
>>> "coulomb_friction" in {row["id"] for row in effects_table()}
True
"""

from pwaid.mismatch.demo import demo_case_path
from pwaid.mismatch.effects import register
from pwaid.mismatch.effects import table as effects_table
from pwaid.mismatch.effects.base import Effect, Place, Quantity
from pwaid.mismatch.explain import explain, explain_case
from pwaid.mismatch.report import Report
from pwaid.mismatch.thresholds import Thresholds

__all__ = ["Effect", "Place", "Quantity", "Report", "Thresholds", "demo_case_path", "effects_table",
           "explain",
           "explain_case", "register"]
