"""Small other effects that every real machine has: a few at a few percent of the force, kept under a stated
size."""

from __future__ import annotations

import numpy as np

from concealed import vector as V

# The catalogue's id of each small effect.
IDS = {"drag": "quadratic_drag", "stiffness_3": "cubic_stiffness", "gain_asymmetry": "actuator_gain_asymmetry",
       "lag": "actuator_lag", "sensor_cubic": "sensor_nonlinearity", "leak": "leakage", "radiation": "radiation"}


def draw(scene, rng, strength, taken, channel=0):
    """Slots of two or three small effects; none of the slots in `taken`. `channel`: the output that is curved.

    Parameters
    ----------
    strength : float
        Share of the rms force that each small force may have, 0.02–0.05 in the hard cell.
    """
    plant = scene.plant
    pool = {}
    if plant.velocity >= 0:
        pool["drag"] = strength * scene.force / scene.v_rms**2
    if plant.position >= 0:
        pool["stiffness_3"] = strength * scene.force / (0.6 * scene.q_max) ** 3
    if min(plant.bias) == 0.0:
        pool["gain_asymmetry"] = strength
    pool["lag"] = 0.15 / (2.0 * np.pi * plant.band[1])
    pool["sensor_cubic"] = 0.01 / scene.y_max[channel] ** 2
    if plant.name in ("single_tank", "cascaded_tanks"):
        pool["leak"] = strength * scene.p[plant.index("gain")] * scene.u_mean / scene.x_mean[0]
    if plant.name == "thermal_plant":
        hot, cold = scene.x_mean[0] + 273.15, scene.p[3] + 273.15
        pool["radiation"] = strength * scene.p[1] * (scene.x_mean[0] - scene.p[3]) / (hot**4 - cold**4)
    names = [n for n in pool if n not in taken]
    chosen = rng.permutation(names)[: int(rng.integers(2, 4))]
    return {str(n): float(pool[n] * rng.uniform(0.4, 1.0)) for n in chosen}


def scaled(slots, factor):
    """The same clutter, `factor` times as large."""
    return {name: value * factor for name, value in slots.items()}


def applied(e, slots):
    """Effect vector with clutter added to what is there."""
    out = e.copy()
    for name, value in slots.items():
        out[V.INDEX[name]] += value
    return out
