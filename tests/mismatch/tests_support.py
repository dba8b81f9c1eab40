"""A mass on a spring with exact dry friction, recorded and simulated: the plant most tests share."""

from __future__ import annotations

import control
import numpy as np

from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.explain import collect
from pwaid.recording import Recording

TRUE = {"m": 1.0, "b": 0.45, "k": 3.0}


def update(t, x, u, params):
    m, b, k = params["m"], params["b"], params.get("k", 3.0)
    return np.array([x[1], (u[0] - b * x[1] - k * x[0]) / m])


def output(t, x, u, params):
    return np.array([x[0]])


def oscillator(**changes):
    """The nominal simulator, 10 % off by default."""
    params = {"m": 1.1, "b": 0.5, "k": 3.2, **changes}
    return control.nlsys(update, output, inputs=["F"], outputs=["x"], states=["x", "v"], params=params)


def multisine(rng, t, highest: float) -> np.ndarray:
    """Eight sines of 0.7 N up to `highest` Hz, with random phases."""
    f = rng.uniform(0.1, highest, 8)
    return 0.7 * np.sin(2 * np.pi * np.outer(t, f) + rng.uniform(0, 6.28, 8)).sum(axis=1)


def recorded(t, u, y, noise: float, rng, seed: int) -> Recording:
    """The recording of one run, with white noise on the position."""
    return Recording(t, u[:, None], (y + noise * rng.normal(size=t.size))[:, None], ("F",), ("x",),
                     {"F": "N", "x": "m"}, name=f"r{seed}.csv")


def record(seed: int, level: float = 0.0, samples: int = 900, dt: float = 0.02, noise: float = 2e-3,
           fine: int = 20, force=None):
    """A multisine recording of the true oscillator with Coulomb friction of the given level, exact at rest, and a force
    of the position if one is given."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * dt
    u = multisine(rng, t, 1.5)
    x, v, h = 0.0, 0.0, dt / fine
    y = np.empty(samples)
    for k in range(samples):
        y[k] = x
        for _ in range(fine):
            smooth = u[k] - TRUE["b"] * v - TRUE["k"] * x + (force(x) if force else 0.0)
            if v == 0.0 and abs(smooth) <= level:
                continue
            sign = np.sign(v) if v != 0.0 else np.sign(smooth)
            new = v + h * (smooth - level * sign)
            new = 0.0 if new * sign < 0.0 else new
            x += 0.5 * h * (v + new)
            v = new
    return recorded(t, u, y, noise, rng, seed)


def pushed(seed: int, force, highest: float = 1.5, samples: int = 900, dt: float = 0.02, noise: float = 2e-3,
           fine: int = 20):
    """A multisine recording of the true oscillator with a smooth force of position and speed."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * dt
    u = multisine(rng, t, highest)
    x, v, h, y = 0.0, 0.0, dt / fine, np.empty(samples)
    for k in range(samples):
        y[k] = x
        for _ in range(fine):
            v += h * (u[k] - TRUE["b"] * v - TRUE["k"] * x + force(x, v)) / TRUE["m"]
            x += h * v
    return recorded(t, u, y, noise, rng, seed)


def gathered(recordings, *ids, plant=None, minutes=None):
    """What explain gathers from two recordings and a held-out one, with these effects only."""
    return collect(plant or oscillator(), recordings[:2], recordings[2:], list(TRUE),
                   effects=[e for i in ids for e in effect_by_id(i)], minutes=minutes)

