"""A mass on a spring with exact dry friction, recorded and simulated: the plant most tests share."""

from __future__ import annotations

import control
import numpy as np

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


def record(seed: int, level: float = 0.0, samples: int = 900, dt: float = 0.02, noise: float = 2e-3,
           fine: int = 20):
    """A multisine recording of the true oscillator with Coulomb friction of the given level, exact at rest."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * dt
    f = rng.uniform(0.1, 1.5, 8)
    u = 0.7 * np.sin(2 * np.pi * np.outer(t, f) + rng.uniform(0, 6.28, 8)).sum(axis=1)
    x, v, h = 0.0, 0.0, dt / fine
    y = np.empty(samples)
    for k in range(samples):
        y[k] = x
        for _ in range(fine):
            smooth = u[k] - TRUE["b"] * v - TRUE["k"] * x
            if v == 0.0 and abs(smooth) <= level:
                continue
            sign = np.sign(v) if v != 0.0 else np.sign(smooth)
            new = v + h * (smooth - level * sign)
            new = 0.0 if new * sign < 0.0 else new
            x += 0.5 * h * (v + new)
            v = new
    return Recording(t, u[:, None], (y + noise * rng.normal(size=samples))[:, None], ("F",), ("x",),
                     {"F": "N", "x": "m"}, name=f"r{seed}.csv")

