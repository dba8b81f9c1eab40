"""A law of two variables is found as one, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from pwaid.mismatch.microscope import examine
from pwaid.mismatch.pairmap import examine_pairs

N = 1500


def motion(seed=3):
    t = np.arange(N) * 0.02
    rng = np.random.default_rng(seed)

    def wave(top):
        return np.sin(2 * np.pi * np.outer(t, rng.uniform(0.05, top, 6)) + rng.uniform(0, 6.28, 6)).sum(axis=1)

    u, x = wave(0.8), wave(0.6)
    return {"x": x, "v": np.gradient(x, 0.02), "u": u, "du/dt": np.gradient(u, 0.02), "t": t}


def noisy(d, seed=0):
    return d + 0.05 * np.std(d) * np.random.default_rng(seed).normal(size=N)


def look(d, z):
    single = examine(d, np.ones(N), z, {})
    return single, examine_pairs(d, np.ones(N), z, single.variable, single.gain)


@pytest.mark.parametrize(("pair", "law"), [
    (("v", "u"), lambda z: np.abs(z["u"]) * np.sign(z["v"])),  # friction that grows with the load
    (("x", "u"), lambda z: z["x"] * z["u"]),  # a gain that depends on position
])
def test_a_law_of_two_variables_is_found(pair, law):
    z = motion()
    d = noisy(law(z) + 0.3 * z["x"])  # linear parts cost nothing
    single, got = look(d, z)
    assert got.variables == pair
    assert got.gain > 0.5
    assert not single.variable or got.gain > single.gain + 0.05
    inside = [np.clip(z[n], *np.quantile(z[n], [0.05, 0.95])) for n in pair]
    shape = got.map(np.column_stack(inside)) - got.partial
    assert np.std(shape) < 0.6 * np.std(got.partial)


@pytest.mark.parametrize("law", [lambda z: np.sign(z["v"]), lambda z: z["x"] ** 3])
def test_a_law_of_one_variable_needs_no_second(law):
    single, got = look(noisy(law(motion())), motion())
    assert single.variable in ("v", "x")
    assert got is None


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_no_law_of_any_pair(seed):
    rng = np.random.default_rng(seed)
    assert look(np.convolve(rng.normal(size=N + 30), np.ones(31), "valid"), motion(seed))[1] is None


def test_too_little_to_look_at_gives_none():
    z = {n: s[:100] for n, s in motion().items()}
    assert examine_pairs(z["x"] * z["u"], np.ones(100), z) is None
    assert examine_pairs(np.zeros(N), np.ones(N), motion()) is None


def test_a_variable_that_rests_at_one_value_nearly_always_is_looked_at():
    z = motion()
    z["valve"] = np.where(np.arange(N) % 150 == 0, 1.0, 0.0)  # open in less than one per cent of the samples
    single, _ = look(noisy(np.sign(z["v"])), z)
    assert single.variable == "v"
    opened = examine(noisy(50 * z["valve"]), np.ones(N), z, {})
    assert np.isfinite(opened.ranking["valve"])
