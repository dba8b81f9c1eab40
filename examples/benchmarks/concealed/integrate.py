"""The truth: fine fixed steps of RK4 with located events, exact actuators and sensors (numba).

Each sample is cut into `nsub` steps. Dry friction is a mode (stick, or slip to one side): a sign change of
the
sliding speed inside a step is located by regula falsi, speed is set to zero there, and the axis sticks until
the force it carries exceeds breakaway. Actuator laws act on the held input: delay (whole sub-steps), play,
dead zone, gain asymmetry, clip, rate limit, lag, all exact at the sub-step. Sensor laws act on the sampled
state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from concealed import laws
from concealed import vector as V
from concealed.jit import njit
from concealed.plants import arm, axis, electrical, hydraulic, tanks, thermal, two_mass

N_STATES = {0: 2, 1: 4, 2: 4, 3: 1, 4: 2, 5: 1, 6: 2, 7: 1, 8: 3}
TIME_CONSTANT_OF_D = 3.0  # derivative filter of the controllers, samples


@njit
def rates(kind, x, u, p, e, w, mode, dx):
    """Fill `dx`; return the force that standstill of the friction axis would have to carry."""
    dx[:] = 0.0
    held = 0.0
    if kind == 0:
        held = axis.rhs(x, u, p, e, w, mode, dx)
    elif kind == 1:
        held = two_mass.rhs(x, u, p, e, w, mode, dx)
    elif kind == 2:
        held = arm.rhs(x, u, p, e, w, mode, dx)
    elif kind == 3:
        tanks.single(x, u, p, e, w, dx)
    elif kind == 4:
        tanks.cascade(x, u, p, e, w, dx)
    elif kind == 5:
        thermal.rhs(x, u, p, e, w, dx)
    elif kind == 6:
        held = electrical.motor(x, u, p, e, w, mode, dx)
    elif kind == 7:
        electrical.coil(x, u, p, e, w, dx)
    else:
        held = hydraulic.rhs(x, u, p, e, w, mode, dx)
    return held


@njit
def friction_speed(kind, e):
    """State index of the speed that dry friction acts on."""
    if kind == 1:
        return 1 + 2 * int(e[V.FRICTION_SIDE])
    if kind == 2:
        return 2
    return 1


@njit
def transmitted_force(kind, x, u, p, e):
    """Force through the rubbing joint, for load-dependent friction."""
    if kind == 0:
        return p[2] * u[0]
    if kind == 1:
        if e[V.FRICTION_SIDE] > 0.0:
            return laws.gap_force(x[0] - x[2], x[1] - x[3], p[2], p[3], e[V.HALF_GAP])
        return p[6] * u[0]
    if kind == 6:
        return p[2] * x[0]
    if kind == 8:
        return p[2] * x[2]
    return p[5] * u[0]


@njit
def rk4(kind, x, u, p, e, w, mode, h, k, out):
    """One step of the classical Runge–Kutta method; `k` is work space (5, n)."""
    n = len(x)
    one, two, three, four, middle = k[0], k[1], k[2], k[3], k[4]
    half = 0.5 * h
    rates(kind, x, u, p, e, w, mode, one)
    for i in range(n):
        middle[i] = x[i] + half * one[i]
    rates(kind, middle, u, p, e, w, mode, two)
    for i in range(n):
        middle[i] = x[i] + half * two[i]
    rates(kind, middle, u, p, e, w, mode, three)
    for i in range(n):
        middle[i] = x[i] + h * three[i]
    rates(kind, middle, u, p, e, w, mode, four)
    sixth = h / 6.0
    for i in range(n):
        out[i] = x[i] + sixth * (one[i] + 2.0 * two[i] + 2.0 * three[i] + four[i])


@njit
def stick_or_slip(kind, x, u, p, e, w, k):
    """Mode at zero speed: 0 if friction can carry the force, else the side it breaks away to."""
    held = rates(kind, x, u, p, e, w, 0, k[0])
    side = 1 if held > 0.0 else -1
    if abs(held) <= laws.static_level(side, e, transmitted_force(kind, x, u, p, e)):
        return 0
    return side


@njit
def advance(kind, x, u, p, e, w, mode, h, k, out):
    """One sub-step of length `h` with located stick–slip events, in place; returns the new mode."""
    if mode == 2:
        rk4(kind, x, u, p, e, w, 2, h, k, out)
        x[:] = out
        return 2
    iv = friction_speed(kind, e)
    left = h
    for _ in range(6):
        if mode == 0:
            mode = stick_or_slip(kind, x, u, p, e, w, k)
        rk4(kind, x, u, p, e, w, mode, left, k, out)
        if mode == 0 or out[iv] * mode >= 0.0:
            x[:] = out
            return mode
        if x[iv] * mode <= 0.0:
            x[iv] = 0.0
            mode = 0
            rk4(kind, x, u, p, e, w, 0, left, k, out)
            x[:] = out
            return 0
        low, v_low, high, v_high = 0.0, x[iv], left, out[iv]
        tau = left
        for _ in range(8):
            tau = low + (high - low) * v_low / (v_low - v_high)
            rk4(kind, x, u, p, e, w, mode, tau, k, out)
            if out[iv] * mode > 0.0:
                low, v_low = tau, out[iv]
            else:
                high, v_high = tau, out[iv]
            if abs(out[iv]) < 1e-12:
                break
        x[:] = out
        x[iv] = 0.0
        mode = stick_or_slip(kind, x, u, p, e, w, k)
        left -= tau
        if left <= 0.0:
            return mode
    return mode


@njit
def actuate(command, e, state, h, speed):
    """Actuator chain over one sub-step; `state` = (play output, rate-limited value, lag value). Mid-step
    value."""
    v = command
    if e[V.PLAY] > 0.0:
        state[0] = max(min(state[0], v + e[V.PLAY]), v - e[V.PLAY])
        v = state[0]
    if e[V.HALF_WIDTH] > 0.0:
        v = math.copysign(max(abs(v) - e[V.HALF_WIDTH], 0.0), v)
    if e[V.GAIN_ASYMMETRY] != 0.0:
        v *= 1.0 + e[V.GAIN_ASYMMETRY] if v > 0.0 else 1.0 - e[V.GAIN_ASYMMETRY]
    if e[V.LIMIT] > 0.0:
        v = max(min(v, e[V.LIMIT]), -e[V.LIMIT])
    if e[V.SPEED_LIMIT_STALL] > 0.0 and v * speed > 0.0:
        room = max(e[V.SPEED_LIMIT_STALL] - e[V.SPEED_LIMIT_SLOPE] * abs(speed), 0.0)
        v = math.copysign(min(abs(v), room), v)
    if e[V.RATE] > 0.0:
        step = e[V.RATE] * h
        before = state[1]
        state[1] = before + max(min(v - before, step), -step)
        v = 0.5 * (before + state[1])
    if e[V.LAG] > 0.0:
        before = state[2]
        state[2] = v + (before - v) * math.exp(-h / e[V.LAG])
        v = v + (before - v) * math.exp(-0.5 * h / e[V.LAG])
    return v


@njit
def sense(x, oidx, e, filtered, t, y):
    """Sampled outputs with sensor effects, without noise."""
    for j in range(len(oidx)):
        v = x[oidx[j]]
        if int(e[V.SENSOR_CHANNEL]) == j:
            if e[V.SENSOR_LAG] > 0.0:
                v = filtered
            v += e[V.SENSOR_CUBIC] * v * v * v
            v += e[V.OFFSET] + e[V.DRIFT] * t
            if e[V.RECTIFIED] > 0.0:
                v = abs(v)
            if e[V.SENSOR_LIMIT] > 0.0:
                v = max(min(v, e[V.SENSOR_LIMIT]), -e[V.SENSOR_LIMIT])
        y[j] = v


@njit
def control_law(kind, y, r, gains, memory, ts, u):
    """PID with filtered derivative of the measurement: gains rows = channel, Kp, Ki, Kd, limit, bias, speed
    channel.

    A speed channel ≥ 0 feeds a measured speed to Kd in place of the derivative.
    """
    for j in range(len(u)):
        g = gains[j]
        v = y[int(g[0])]
        error = r[j] - v
        if memory[j, 2] == 0.0:
            memory[j, 1] = v
            memory[j, 2] = 1.0
        slope = (v - memory[j, 1]) / (TIME_CONSTANT_OF_D * ts)
        memory[j, 1] += slope * ts
        if g[6] >= 0.0:
            slope = y[int(g[6])]
        raw = g[5] + g[1] * error + memory[j, 0] - g[3] * slope
        u[j] = max(min(raw, g[5] + g[4]), g[5] - g[4])
        if u[j] == raw:
            memory[j, 0] += g[2] * error * ts


@njit
def run(kind, n, p, e, x0, signal, w, drift, drift_index, ts, nsub, first, gains, noise, oidx):
    """Simulate one recording; see `simulate`."""
    samples, nu = signal.shape
    ny = len(oidx)
    x = np.zeros(n + V.N_HIDDEN)
    x[:n] = x0
    if e[V.MODE_INERTIA] > 0.0:
        x[n + V.MODE_POSITION] = x0[0]
        x[n + V.MODE_VELOCITY] = x0[1]
    x[n + V.SECOND_STORE] = x0[0]
    out = np.zeros_like(x)
    k = np.zeros((5, len(x)))
    states = np.zeros((samples, n))
    clean = np.zeros((samples, ny))
    inputs = np.zeros((samples, nu))
    used = np.zeros(nu)
    memory = np.zeros((nu, 3))
    closed = len(gains) > 0
    q = p.copy()
    dry = e[V.LEVEL_POSITIVE] + e[V.LEVEL_NEGATIVE] + e[V.STATIC_EXTRA] + e[V.LOAD_FACTOR] > 0.0
    iv = friction_speed(kind, e)
    mode = 2
    if dry:
        mode = 0 if x[iv] == 0.0 else (1 if x[iv] > 0.0 else -1)
    channel = int(e[V.SENSOR_CHANNEL])
    filtered = x[oidx[channel]]
    h = ts / nsub
    late = int(e[V.DELAY_SUBSTEPS])
    actuator = np.zeros(3)
    started = False
    for s in range(samples):
        states[s] = x[:n]
        sense(x, oidx, e, filtered, s * ts, clean[s])
        if closed:
            control_law(kind, clean[s] + noise[s], signal[s], gains, memory, ts, inputs[s])
        else:
            inputs[s] = signal[s]
        if drift_index >= 0:
            q[drift_index] = p[drift_index] * drift[s]
        for j in range(nsub):
            fine = s * nsub + j - late
            if fine < 0:
                fine = 0
            row = fine // nsub
            command = inputs[row, 0]
            part = (fine - row * nsub + 0.5) / nsub
            if first and row + 1 < samples:
                command += part * (signal[row + 1, 0] - signal[row, 0])
            if not started:
                actuator[:] = command
                started = True
            used[0] = actuate(command, e, actuator, h, x[iv] if iv < n else 0.0)
            for c in range(1, nu):
                used[c] = inputs[s, c]
                if first and s + 1 < samples:
                    used[c] += (j + 0.5) / nsub * (signal[s + 1, c] - signal[s, c])
            t = s * ts + (j + 0.5) * h
            extra = w[s] + e[V.LOAD]
            if e[V.TONE] != 0.0:
                extra += e[V.TONE] * math.sin(2.0 * math.pi * e[V.TONE_FREQUENCY] * t + e[V.TONE_PHASE])
            before = x[oidx[channel]]
            mode = advance(kind, x, used, q, e, extra, mode, h, k, out)
            if kind == 3 or kind == 4:
                tanks.project(x, n, e)
            if e[V.SENSOR_LAG] > 0.0:
                mean = 0.5 * (before + x[oidx[channel]])
                filtered = mean + (filtered - mean) * math.exp(-h / e[V.SENSOR_LAG])
    return inputs, states, clean


@dataclass(frozen=True)
class Loop:
    """A sampled controller: `gains` (inputs, 7) as in `control_law`; the signal is then its reference."""

    gains: np.ndarray


def simulate(plant, p, e, x0, signal, *, nsub, outputs, w=None, drift=None, hold="zero", loop=None,
             noise=None):
    """One recording of the plant.

    Parameters
    ----------
    p, e, x0 : arrays
        Plant parameters, effect vector, initial state.
    signal : array, shape (n, inputs)
        Input, or the reference when `loop` is given.
    w : array, shape (n,), optional
        Disturbance in `plant.force_unit`, held between samples.
    drift : (parameter index, array (n,)), optional
        Factor on one parameter over time.
    noise : array, shape (n, outputs), optional
        Sensor noise that the controller sees (it is *not* added to what is returned).

    Returns
    -------
    inputs, states, clean : arrays
        Recorded input (n, inputs), states (n, states), outputs without noise (n, outputs).
    """
    signal = np.ascontiguousarray(signal, dtype=float)
    samples = len(signal)
    outputs = np.asarray(outputs, dtype=np.int64)
    w = np.zeros(samples) if w is None else np.ascontiguousarray(w)
    index, factor = (-1, np.ones(1)) if drift is None else drift
    gains = np.zeros((0, 7)) if loop is None else np.ascontiguousarray(loop.gains)
    noise = np.zeros((samples, len(outputs))) if noise is None else np.ascontiguousarray(noise)
    return run(plant.kind, N_STATES[plant.kind], np.asarray(p, float), e, np.asarray(x0, float), signal, w,
               factor,
               index, plant.ts, nsub, hold == "first", gains, noise, outputs)
