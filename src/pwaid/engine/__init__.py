"""The fast certified engine: an interior point method on the N̂ × N̂ reduced system, warm-started along a path."""

from pwaid.engine.interior import InteriorState
from pwaid.engine.solve import solve_engine

__all__ = ["InteriorState", "solve_engine"]
