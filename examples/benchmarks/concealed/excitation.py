"""Inputs, references and controllers: multisine, one sine, random steps, trapezoids in closed loop."""

from __future__ import annotations

import math

import numpy as np

from concealed.integrate import Loop

RMS_OF_MULTISINE = 0.6
COMMAND_ROOM = 3.0


def multisine(plant, n, level, rng):
    """Random-phase multisine over the plant's band, shape (n, inputs); rms = 0.6 · amplitude · level."""
    t = np.arange(n) * plant.ts
    columns = []
    for amplitude, bias in zip(plant.amplitude, plant.bias, strict=True):
        span = n * plant.ts
        lines = np.unique(np.round(np.geomspace(max(plant.band[0], 1.0 / span), plant.band[1], 24) * span))
        lines = lines[lines >= 1.0]
        size = lines**-0.35
        phase = rng.uniform(0.0, 2.0 * math.pi, len(lines))
        x = (size * np.cos(2.0 * math.pi * np.outer(t, lines / span) + phase)).sum(axis=1)
        columns.append(bias + RMS_OF_MULTISINE * amplitude * level * x / x.std())
    return np.column_stack(columns)


def sine(plant, n, level, rng, tune):
    """One steady sine; `tune` is the place of its frequency in the band (0 low, 1 high)."""
    t = np.arange(n) * plant.ts
    low, high = plant.band[0] * 2.0, plant.band[1] * 0.5
    columns = []
    for j, (amplitude, bias) in enumerate(zip(plant.amplitude, plant.bias, strict=True)):
        f = low * (high / low) ** tune * (1.0 + 0.31 * j)
        columns.append(bias + amplitude * level * np.sin(2.0 * math.pi * f * t + rng.uniform(0.0, 6.28)))
    return np.column_stack(columns)


def steps(plant, n, level, rng):
    """Random levels held for random times, mean taken out."""
    columns = []
    longest = 0.12 / plant.band[0] / plant.ts
    shortest = 0.6 / plant.band[1] / plant.ts
    for amplitude, bias in zip(plant.amplitude, plant.bias, strict=True):
        x = np.zeros(n)
        at = 0
        while at < n:
            wide = int(math.exp(rng.uniform(math.log(shortest), math.log(longest)))) + 1
            x[at:at + wide] = rng.uniform(-1.0, 1.0)
            at += wide
        columns.append(bias + amplitude * level * (x - x.mean()))
    return np.column_stack(columns)


def trapezoids(n, ts, move, speed_time, rng, centre=0.0):
    """Reference of moves between random places with constant speed and rests, shape (n,)."""
    r = np.full(n, centre)
    at, place = 0, centre
    side = 1.0
    while at < n:
        goal = centre + side * move * rng.uniform(0.35, 1.0)
        side = -side
        travel = max(int(speed_time * rng.uniform(0.6, 1.4) * abs(goal - place) / (2.0 * move) / ts) + 2, 3)
        rest = int(speed_time * rng.uniform(0.1, 0.5) / ts) + 1
        ramp = place + (goal - place) * np.linspace(0.0, 1.0, travel)
        path = np.concatenate([ramp, np.full(rest, goal)])
        stop = min(at + len(path), n)
        r[at:stop] = path[: stop - at]
        place = goal
        at = stop
    return r


def staircase(n, ts, move, hold_time, rng, centre=0.0):
    """Reference of random steps, shape (n,)."""
    r = np.full(n, centre)
    at = 0
    while at < n:
        wide = int(hold_time * rng.uniform(0.4, 1.2) / ts) + 2
        r[at:at + wide] = centre + move * rng.uniform(-1.0, 1.0)
        at += wide
    return r


def closed_loop(plant, p, measured, n, level, rng):
    """Reference (n, inputs) and `Loop` for the plant's natural controller on the measured states."""
    rows = []
    columns = []
    for j in range(len(plant.inputs)):
        gains, centre, move, pace = _gains(plant, p, measured, j)
        gains[4] = COMMAND_ROOM * plant.amplitude[j]
        gains[5] = plant.bias[j]
        rows.append(gains)
        shape = trapezoids if rng.uniform() < 0.6 else staircase
        columns.append(shape(n, plant.ts, move * level, pace, rng, centre))
    return np.column_stack(columns), Loop(np.array(rows))


def _gains(plant, p, measured, j):
    """One controller row (channel, Kp, Ki, Kd, limit, bias, speed channel), centre, move and pace of its
    task."""
    gains = np.zeros(7)
    gains[6] = -1.0
    design = plant.loop["design"]
    middle = math.sqrt(plant.band[0] * plant.band[1])
    move = plant.loop["move"]
    if design == "store":
        state = measured[-1]
        gains[0] = len(measured) - 1
        gains[1] = 1.2 * plant.amplitude[j] / move
        gains[2] = gains[1] * 4.0 * middle
        return gains, plant.x0[state], move, 0.5 / middle
    omega = 2.0 * math.pi * plant.loop["bandwidth"]
    pace = 3.0 / plant.loop["bandwidth"]
    inertia, gain = _inertia(plant, p, j)
    position, velocity = _axis_states(plant, j)
    if design == "flow":
        inertia, gain, omega = p[2], p[4], omega
    if position in measured:
        gains[0] = measured.index(position)
        if design == "flow":
            gains[1] = inertia * omega / gain
            return gains, 0.0, move, pace
        gains[1] = inertia * omega**2 / gain
        gains[3] = 1.4 * inertia * omega / gain
        if velocity in measured:
            gains[6] = measured.index(velocity)
        return gains, plant.x0[position], move, pace
    gains[0] = measured.index(velocity)
    gains[1] = (0.4 * inertia / gain) if design == "flow" else inertia * omega / gain
    gains[2] = gains[1] * omega * (2.0 if design == "flow" else 0.4)
    speed = move if design == "speed" else 2.0 * move / pace * 2.5
    return gains, 0.0, speed, pace


def _inertia(plant, p, j):
    if plant.name == "two_mass_drive":
        return p[0] + p[1], p[6]
    if plant.name == "two_link_arm":
        return (p[0] + 2.0 * p[1], p[2])[j], p[5]
    if plant.name == "dc_motor":
        return p[3] * p[0] / p[2], 1.0
    if plant.name == "hydraulic_cylinder":
        return p[2], p[4]
    return p[0], p[2]


def _axis_states(plant, j):
    if plant.name == "two_link_arm":
        return j, 2 + j
    return plant.position, plant.velocity


def coloured(n, ts, cutoff, rng):
    """Unit-variance coloured noise: white noise through two first-order low-passes at `cutoff` Hz, shape
    (n,)."""
    a = math.exp(-2.0 * math.pi * cutoff * ts)
    warm = int(6.0 / (1.0 - a)) + 10
    x = rng.standard_normal(n + warm)
    y = np.zeros(n + warm)
    first = second = 0.0
    for i, v in enumerate(x):
        first = a * first + (1.0 - a) * v
        second = a * second + (1.0 - a) * first
        y[i] = second
    y = y[warm:]
    scale = math.sqrt((1.0 - a) ** 4 * _energy(a))
    return y / scale


def _energy(a):
    """Sum of squared impulse response of 1/(1 − a z⁻¹)², the variance gain before scaling."""
    return (1.0 + a * a) / (1.0 - a * a) ** 3
