"""Build one sealed case from a recipe: plant, recordings, effects, noise, nominal side."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from concealed import clutter, excitation, vector
from concealed.drawn import Scene
from concealed.effects import draw
from concealed.integrate import simulate
from concealed.plants import PLANTS
from concealed.refit import refit

NSUB = 24
LARGEST_GROWTH = 2.0  # of what clutter does beside the effects, over what it does alone
QUIET_CLUTTER = 0.3  # largest clutter in cells without disturbance, in units of the sensor noise
LOUD_CLUTTER = 1.0


class Rejected(Exception):
    """This draw does not make a case of its class; the caller draws again."""


@dataclass(frozen=True)
class Recipe:
    """What a case shall contain, before numbers are drawn.

    Attributes
    ----------
    excitation : "multisine", "steps", "sine" or "closed_loop"
    noise, disturbance : float
        Sensor noise as a share of each output's spread; coloured force as a share of the rms force.
    effects : tuple of (id, size factor)
    stranger : str
        An effect that no catalogue entry describes, or "".
    parameter_error, state_error : bool
    beyond : float or None
        Puts thresholds out of reach.
    """

    plant: str
    excitation: str
    noise: float
    disturbance: float = 0.0
    coloured_sensor: bool = False
    effects: tuple = ()
    stranger: str = ""
    parameter_error: bool = True
    state_error: bool = False
    beyond: float | None = None
    measured: str = ""
    hold: str = "zero"
    repeats: bool = False
    floor: bool = False
    same_amplitude: bool = False
    load_side: bool = False


@dataclass
class Recorded:
    """One recording with its truth."""

    name: str
    role: str
    x0: np.ndarray
    signal: np.ndarray
    loop: object
    w: np.ndarray
    drift: tuple | None
    u: np.ndarray = field(default=None)
    y: np.ndarray = field(default=None)
    free: np.ndarray = field(default=None)


@dataclass
class Case:
    """Everything about a case: what goes into the folder and what goes into the key."""

    recipe: Recipe
    plant: object
    measured: tuple
    p: np.ndarray
    e: np.ndarray
    nominal: np.ndarray
    e_nominal: np.ndarray
    free: tuple
    variant: str
    drawn: tuple
    recordings: list
    sigma: np.ndarray
    margins: dict
    heldout_margins: dict
    facts: dict
    nested: dict = field(default_factory=dict)


def build(recipe, rng):
    """Draw numbers for `recipe`; raise `Rejected` when a simulation leaves its range."""
    plant = PLANTS[recipe.plant]
    p = np.array([q.typical * np.exp(rng.uniform(-0.3, 0.3)) if q.typical else 0.0 for q in plant.params])
    p[[q.name == "gain" and q.unit == "-" for q in plant.params]] = 1.0  # a force has one size, wherever it enters
    if plant.name == "two_link_arm":
        p[1] = min(p[1], 0.7 * p[2])
    measured = plant.measured[recipe.measured or str(rng.choice(list(plant.measured)))]
    recordings = _plan(recipe, plant, p, measured, rng)
    base = vector.neutral(**plant.switches)
    scene = _scene(plant, p, base, recordings, measured, recipe)
    drawn = tuple(draw(name, scene, rng, size, recipe.beyond) for name, size in recipe.effects)
    p, e = _true_side(p, base, drawn, plant)
    if recipe.load_side:
        e[vector.FRICTION_SIDE] = 1.0
    e = _strangers(recipe, plant, scene, e, recordings, rng)
    _drifts(drawn, plant, recordings)
    sigma = _noise_size(plant, p, e, recordings, measured, recipe, scene)
    nominal, e_nominal, free, variant = _nominal_side(p, base, drawn, plant, recipe, rng)
    case = Case(recipe, plant, measured, p, e, nominal, e_nominal, free, variant, drawn, recordings, sigma,
                {}, {},
                {"scene": scene})
    _add_clutter(case, scene, base, rng)
    _record(case, rng)
    return case


def _plan(recipe, plant, p, measured, rng):
    """Lengths, amplitudes and inputs of the recordings."""
    kind = recipe.excitation
    n_train = int(rng.integers(2, 4))
    total = int(rng.integers(2400, 3800))
    levels = [1.0, 0.5, 0.75][:n_train]
    if recipe.same_amplitude:
        levels = [1.0] * n_train
    tests = [0.8] if rng.uniform() < 0.5 else [0.9, 0.65]
    tune = rng.uniform(0.3, 0.7)
    out = []
    for i, level in enumerate(levels + tests):
        train = i < n_train
        n = total // n_train if train else 1000
        level = level * rng.uniform(0.92, 1.08)
        loop = None
        if kind == "closed_loop":
            signal, loop = excitation.closed_loop(plant, p, measured, n, level, rng)
        elif kind == "sine":
            signal = excitation.sine(plant, n, level, rng,
                                     tune if train else tune + rng.choice([-0.12, 0.12]))
        else:
            signal = getattr(excitation, kind)(plant, n, level, rng)
        spread = np.array(plant.x0_spread) * (6.0 if recipe.state_error else 1.0)
        x0 = np.array(plant.x0) + spread * np.clip(rng.standard_normal(len(plant.x0)), -1.5, 1.5)
        if plant.force_unit in ("m^3/s", "W"):
            x0 = np.maximum(x0, 0.02)
        role = "train" if train else "test"
        out.append(Recorded(f"{role}_{i}", role, x0, signal, loop, np.zeros(n), None))
    if recipe.repeats:
        twin = replace(out[0], name="train_again", x0=out[0].x0.copy(), w=out[0].w.copy())
        out.insert(n_train, twin)
    return out


def _run(plant, p, e, rec, measured, hold, noise=None, w=None):
    return simulate(plant, p, e, rec.x0, rec.signal, nsub=NSUB, outputs=measured, w=w, drift=rec.drift,
                    hold=hold,
                    loop=rec.loop, noise=noise)


def _scene(plant, p, base, recordings, measured, recipe):
    """Sizes in a run without any effect."""
    runs = [_run(plant, p, base, rec, measured, recipe.hold) for rec in recordings]
    chosen = range(len(runs)) if recipe.beyond else [i for i, r in enumerate(recordings) if r.role == "train"]
    u = np.concatenate([runs[i][0] for i in chosen])[:, 0]
    x = np.concatenate([runs[i][1] for i in chosen])
    y = np.concatenate([runs[i][2] for i in chosen])
    if not (np.isfinite(x).all() and np.isfinite(u).all()):
        raise Rejected("the run without effects diverges")
    bias = plant.bias[0]
    gain, driver = _drive(plant, p, u - bias, x)
    q = x[:, plant.position] if plant.position >= 0 else np.zeros(2)
    v = x[:, plant.velocity] if plant.velocity >= 0 else np.zeros(2)
    slope = np.sqrt(np.mean(np.concatenate([np.diff(runs[i][0][:, 0]) for i in chosen]) ** 2)) / plant.ts
    if recipe.excitation == "steps" or recipe.excitation == "closed_loop":
        slope = 2.0 * np.pi * np.sqrt(plant.band[0] * plant.band[1]) * 1.5 * u.std()
    return Scene(plant=plant, p=p, force=float(gain * driver.std()), q_rms=float(q.std()),
                 q_max=float(abs(q).max()),
                 v_rms=float(np.sqrt((v**2).mean())), u_rms=float(u.std()), u_mean=float(bias),
                 u_max=float(abs(u).max()), slope=float(slope), y_std=y.std(axis=0),
                 y_mean=y.mean(axis=0) if min(plant.x0) > 0.0 else 0.0 * y[0], y_max=abs(y).max(axis=0),
                 x_max=x.max(axis=0), x_mean=x.mean(axis=0),
                 seconds=float(np.mean([len(runs[i][0]) for i in chosen]) * plant.ts), measured=measured)


def _drive(plant, p, u, x):
    """Gain and signal whose product is the force that drives the plant."""
    if plant.name == "dc_motor":
        return p[2], x[:, 0]
    if plant.name == "hydraulic_cylinder":
        return p[2], x[:, 2]
    names = [q.name for q in plant.params]
    return (p[names.index("gain")] if "gain" in names else 1.0), u


def _true_side(p, base, drawn, plant):
    p, e = p.copy(), base.copy()
    for d in drawn:
        e = vector.with_values(e, d.slots)
        for name, value in d.p.items():
            p[plant.index(name)] = value
    return p, e


def _drifts(drawn, plant, recordings):
    for d in drawn:
        if d.drift:
            name, rate = d.drift
            for rec in recordings:
                rec.drift = (plant.index(name), 1.0 + rate * plant.ts * np.arange(len(rec.signal)))


def _strangers(recipe, plant, scene, e, recordings, rng):
    """Effects outside the catalogue; all but the speed limit differ from recording to recording."""
    kind = recipe.stranger
    if kind == "torque_speed_limit":
        stall = 0.9 * scene.u_max
        return vector.with_values(e, {"speed_limit_stall": stall,
                                      "speed_limit_slope": stall / (rng.uniform(0.9, 1.3) * scene.v_rms)})
    low, high = plant.band
    for rec in recordings:
        n = len(rec.signal)
        t = np.arange(n) * plant.ts
        if kind == "pulse_disturbance":
            for _ in range(int(rng.integers(3, 7))):
                at = int(rng.integers(0, n - 60))
                wide = int(rng.uniform(0.15, 0.5) / np.sqrt(low * high) / plant.ts)
                rec.w[at:at + wide] += rng.choice([-1.0, 1.0]) * rng.uniform(0.6, 1.6) * scene.force
        elif kind == "sine_disturbance":
            f = low * (high / low) ** rng.uniform(0.3, 0.7)
            rec.w += rng.uniform(0.4, 0.8) * scene.force * np.sin(2.0 * np.pi
                                                                  * f * t + rng.uniform(0.0, 6.28))
        elif kind == "unknown_disturbance":
            rec.w += rng.uniform(0.4, 0.7) * scene.force * excitation.coloured(n, plant.ts,
                                                                               np.sqrt(low * high), rng)
        elif kind == "parameter_wander":
            free = [i for i, q in enumerate(plant.params) if q.free]
            index = free[-1]
            slow = excitation.coloured(n, plant.ts, 1.0 / (0.15 * n * plant.ts) / 6.28, rng)
            rec.drift = (index, np.exp(0.55 * slow))
    return e


STRANGERS = ("pulse_disturbance", "sine_disturbance", "unknown_disturbance", "parameter_wander",
             "output_dropout",
             "torque_speed_limit")


def _noise_size(plant, p, e, recordings, measured, recipe, scene):
    """Sensor noise per output: a share of the spread of the outputs with the effect."""
    runs = [_run(plant, p, e, rec, measured, recipe.hold) for rec in recordings if rec.role == "train"]
    y = np.concatenate([r[2] for r in runs])
    x = np.concatenate([r[1] for r in runs])
    if not np.isfinite(x).all() or (abs(x).max(axis=0) > 12.0 * np.maximum(abs(scene.x_max), 1e-9) + 1e3 *
                                    np.array(plant.x0_spread)).any():
        raise Rejected("the run with the effect leaves its range")
    return recipe.noise * y.std(axis=0)


def _nominal_side(p, base, drawn, plant, recipe, rng):
    """What the engineer has: parameters with errors, terms left out, and the list of parameters that may be
    wrong."""
    nominal, e = p.copy(), base.copy()
    trusted, variant = set(), ""
    for d in drawn:
        trusted |= set(d.trusted)
        variant = d.variant or variant
        e = vector.with_values(e, d.nominal_switches)
        for name, value in d.nominal_p.items():
            nominal[plant.index(name)] = value
    free = tuple(i for i, q in enumerate(plant.params) if q.free and q.name not in trusted)
    if recipe.parameter_error:
        for i in free:
            nominal[i] *= 1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.3)
    return nominal, e, free, variant


def _add_clutter(case, scene, base, rng):
    """Add small effects and shrink them until they leave no more than the stated size after a refit."""
    loud = case.recipe.disturbance > 0.0
    taken = {n for d in case.drawn for n in d.slots}
    channel = vector.INDEX["sensor_channel"]  # a sensor's effect says which sensor has the clutter's curvature too
    base = base.copy()
    base[channel] = case.e[channel]
    slots = clutter.draw(scene, rng, 0.05 if loud else 0.02, taken, int(case.e[channel]))
    limit = LOUD_CLUTTER if loud else QUIET_CLUTTER
    if case.recipe.beyond:
        limit = 0.1
    for _ in range(4):
        pairs = []
        for rec in case.recordings:
            if rec.role == "train":
                still = replace(rec, drift=None)
                u, _, y = _run(case.plant, case.p, clutter.applied(base, slots), still, case.measured,
                               case.recipe.hold)
                pairs.append((u, y, rec.x0))
        size = refit(case.plant, case.p, base, case.free, pairs, case.sigma, case.measured,
                     move=case.recipe.parameter_error, hold=case.recipe.hold, iterations=5).ratio()
        if size <= limit:
            break
        slots = clutter.scaled(slots, 0.8 * limit / size)
    slots = clutter.scaled(slots, min(1.0, LARGEST_GROWTH / _growth(case, base, slots)))
    case.facts["clutter"] = slots
    case.facts["clutter_ratio"] = size
    case.e = clutter.applied(case.e, slots)


def _growth(case, base, slots):
    """How much more the clutter does beside the effects than alone: an axis that a load drives far off meets more of a
    cubic spring."""
    def does(e):
        changes = []
        for rec in case.recordings:
            still = replace(rec, drift=None)
            y, other = (_run(case.plant, case.p, some, still, case.measured, case.recipe.hold)[2]
                        for some in (e, clutter.applied(e, slots)))
            changes.append(np.clip(np.nan_to_num((other - y) / case.sigma, nan=1e4), -1e4, 1e4))
        return float(np.sqrt(np.mean(np.concatenate(changes) ** 2)))

    return does(case.e) / max(does(base), 1e-9)


def _record(case, rng):
    """Run everything once with noise and disturbance, and once without, on the same recorded input."""
    recipe, plant = case.recipe, case.plant
    scene = case.facts["scene"]
    lsb = case.sigma * rng.uniform(0.0, 0.5) * (rng.uniform() < 0.5)
    moved = []
    for rec in case.recordings:
        n = len(rec.signal)
        noise = case.sigma * rng.standard_normal((n, len(case.measured)))
        if recipe.coloured_sensor:
            middle = np.sqrt(plant.band[0] * plant.band[1]) * 3.0
            noise = case.sigma * np.column_stack([excitation.coloured(n, plant.ts, middle,
                                                                      rng) for _ in case.sigma])
        w = rec.w.copy()
        if recipe.disturbance > 0.0:
            cutoff = np.sqrt(plant.band[0] * plant.band[1])
            w += recipe.disturbance * scene.force * excitation.coloured(n, plant.ts, cutoff, rng)
        rec.u, _, clean = _run(plant, case.p, case.e, rec, case.measured, recipe.hold, noise, w)
        quiet = replace(rec, signal=rec.u, loop=None)
        _, _, rec.free = _run(plant, case.p, case.e, quiet, case.measured, recipe.hold, w=rec.w)
        moved.append((clean - rec.free) / case.sigma)
        quantum = case.e[vector.QUANTUM]
        rec.y = clean + noise
        if recipe.stranger == "output_dropout":
            rec.y = _dropouts(rec.y, rng)
        for j in range(len(case.measured)):
            if lsb[j] > 0.0:
                rec.y[:, j] = lsb[j] * np.round(rec.y[:, j] / lsb[j])
            if quantum > 0.0 and j == int(case.e[vector.SENSOR_CHANNEL]):
                rec.y[:, j] = quantum * np.round(rec.y[:, j] / quantum)
                rec.free[:, j] = quantum * np.round(rec.free[:, j] / quantum)
        if not (np.isfinite(rec.y).all() and np.isfinite(rec.free).all()):
            raise Rejected("a recording is not finite")
    case.facts["disturbance_ratio"] = float(np.sqrt((np.concatenate(moved) ** 2).mean(axis=0)).max())


def _dropouts(y, rng):
    y = y.copy()
    for _ in range(int(rng.integers(4, 8))):
        wide = int(rng.integers(25, 70))
        at = int(rng.integers(1, len(y) - wide))
        y[at:at + wide] = y[at - 1]
    return y
