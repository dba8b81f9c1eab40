"""Wilson score interval of a proportion."""

from __future__ import annotations

import math


def wilson(hits, n, z=1.959963985):
    """95 % interval (low, high) of `hits` out of `n`; (0, 1) when n is 0."""
    if not 0 <= hits <= n:
        raise ValueError(f"hits = {hits} of n = {n}: expected 0 ≤ hits ≤ n")
    if n == 0:
        return 0.0, 1.0
    p = hits / n
    centre = p + z * z / (2.0 * n)
    spread = z * math.sqrt(p * (1.0 - p) / n + z * z / (4.0 * n * n))
    scale = 1.0 + z * z / n
    return max((centre - spread) / scale, 0.0), min((centre + spread) / scale, 1.0)
