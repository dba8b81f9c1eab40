"""Laws whose variable and breakpoints are known, found on the unknown input they make."""

from __future__ import annotations

import numpy as np
import pytest

from pwaid.mismatch.microscope import examine

N, H = 1500, 0.02
T = np.arange(N) * H


def motion(seed):
    """A position and its speed, and a command, each a multisine; deterministic in the seed."""
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(0.15, 1.2, 7), rng.uniform(0, 6.28, (2, 7))
    x = np.sin(2 * np.pi * np.outer(T, f) + phase[0]) @ (1 / (2 * np.pi * f)) / 2
    u = np.sin(2 * np.pi * np.outer(T, f[::-1] * 1.07) + phase[1]).sum(axis=1) / 2
    return {"x": x, "v": np.gradient(x, H), "u": u, "du/dt": np.gradient(u, H), "t": T}


def look(d, seed=5, noise=0.05, smear=0):
    z = motion(seed)
    rng = np.random.default_rng(seed + 1)
    if smear:
        d = np.convolve(np.pad(d, smear, mode="edge"), np.ones(2 * smear + 1) / (2 * smear + 1), "valid")
    d = d + 0.3 * z["x"] - 0.2 * z["v"]  # parameter errors cost nothing
    e = np.convolve(rng.normal(size=N + 8), np.ones(9) / 3, "valid") * noise * np.std(d)
    slopes = {n: np.gradient(s, H) for n, s in z.items()}
    width = {n: 3 * (2 * smear + 1) * H * float(np.median(np.abs(s))) for n, s in slopes.items()}
    return examine(d + e, np.full(N, 0.1), z, slopes, width)


def bouc_wen(v, stiffness=15.0, limit=0.6):
    f = np.zeros(N)
    for k in range(N - 1):
        f[k + 1] = np.clip(f[k] + stiffness * v[k] * H, -limit, limit)
    return f


def test_coulomb_friction_is_a_jump_of_the_speed_at_zero():
    got = look(-0.5 * np.sign(motion(5)["v"]), smear=2)
    assert got.variable == "v" and not got.memory
    bend = min(got.bends, key=lambda b: abs(b.position))
    assert bend.jump and abs(bend.position) < 0.05 * np.std(motion(5)["v"])
    assert bend.low <= bend.position <= bend.high
    assert bend.size == pytest.approx(-1.0, abs=0.25)


def test_end_stops_bend_the_position_at_both_stops():
    x = motion(5)["x"]
    g = 0.6 * np.max(np.abs(x))
    got = look(-8 * (np.maximum(x - g, 0) + np.minimum(x + g, 0)))
    assert got.variable == "x" and not got.memory
    positions = [b.position for b in got.bends]
    for stop in (-g, g):
        assert min(abs(p - stop) for p in positions) < 0.06 * g


def test_dead_zone_bends_the_command():
    u = motion(5)["u"]
    got = look(-np.clip(u, -0.5, 0.5))
    assert got.variable == "u" and not got.memory
    np.testing.assert_allclose([b.position for b in got.bends], [-0.5, 0.5], atol=0.04)


def test_hysteretic_spring_has_memory():
    got = look(-bouc_wen(motion(5)["v"]))
    assert got.variable in ("x", "v") and got.memory


def test_delay_is_no_static_law_of_any_variable():
    u = motion(5)["u"]
    got = look(np.interp(T - 0.05, T, u) - u)
    assert got.variable == ""


@pytest.mark.parametrize("seed", range(4))
def test_noise_alone_names_no_variable(seed):
    rng = np.random.default_rng(seed)
    d = np.convolve(rng.normal(size=N + 30), np.ones(31), "valid")
    z = motion(seed)
    assert examine(d, np.ones(N), z, {}).variable == ""


def test_too_little_to_look_at_gives_an_empty_ranking():
    z = {n: s[:150] for n, s in motion(5).items()}
    assert examine(z["x"] ** 3, np.ones(150), z, {}).ranking == {}
    assert examine(np.zeros(N), np.ones(N), motion(5), {}).ranking == {}
