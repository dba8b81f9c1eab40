"""Subspace identification: exact without noise, several experiments, order from the gap, clear refusals."""

import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.hinfstruct import c2d, hinf_norm, pi_moesp, po_moesp, simulate_discrete
from pwaid.hinfstruct.statespace import as_matrices, difference

from .conftest import random_stable

DT = 0.1
TRUTH = as_matrices(c2d(random_stable(4, 3), DT))


def experiment(samples, rng, x0=None):
    u = np.random.default_rng(rng).standard_normal((samples, 2))
    return u, simulate_discrete(TRUTH, u, x0)


@pytest.mark.parametrize("method", [pi_moesp, po_moesp])
def test_noise_free_identification_is_exact(method):
    model = method(experiment(600, 0), 4, dt=DT)
    assert hinf_norm(difference(as_matrices(model.system), TRUTH)).value < 1e-8 * hinf_norm(TRUTH).value
    assert model.stable and model.gap > 1e6


def test_several_experiments_with_unknown_initial_states():
    rng = np.random.default_rng(1)
    starts = rng.standard_normal((3, 4))
    data = [experiment(150 + 30 * k, 10 + k, x0) for k, x0 in enumerate(starts)]
    model = po_moesp(data, 4, dt=DT, block_rows=12)
    assert hinf_norm(difference(as_matrices(model.system), TRUTH)).value < 1e-8 * hinf_norm(TRUTH).value
    for (u, y), x0 in zip(data, model.initial_states, strict=True):
        assert simulate_discrete(as_matrices(model.system), u, x0) == pytest.approx(y, abs=1e-7)


def test_order_is_read_from_the_gap():
    u, y = experiment(800, 4)
    y = y + 1e-4 * np.random.default_rng(5).standard_normal(y.shape)
    model = po_moesp((u, y), dt=DT)
    assert model.order == 4 and model.gap > 5


def test_pi_moesp_is_consistent_under_coloured_noise_and_po_moesp_is_biased():
    errors = {pi_moesp: [], po_moesp: []}
    for seed in range(3):
        u, y = experiment(20_000, 6 + seed)
        noise = np.random.default_rng(70 + seed).standard_normal((len(y) + 3, 2))
        y = y + 0.3 * sum(noise[k : len(y) + k] for k in range(4))
        for method, found in errors.items():
            model = as_matrices(method((u, y), 4, dt=DT).system)
            found.append(hinf_norm(difference(model, TRUTH)).value / hinf_norm(TRUTH).value)
    assert np.mean(errors[pi_moesp]) < 0.6 * np.mean(errors[po_moesp])


def test_feedthrough_can_be_fixed_at_zero():
    model = pi_moesp(experiment(600, 0), 4, dt=DT, feedthrough=False)
    assert not model.system.D.any()


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        (
            lambda u,
            y: (u, np.where(np.arange(len(y))[:, None] == 3, np.nan, y)),
            {},
            "experiment 0 contains NaN",
        ),
        (lambda u, y: (u[:-1], y), {}, "299 input samples and 300 output samples"),
        (lambda u, y: (u[:30], y[:30]), {}, "30 samples; 20 block rows need more than 40"),
        (lambda u, y: (u[:60], y[:60]), {}, "too few samples for 20 block rows"),
        (lambda u, y: (np.ones_like(u), y), {}, "does not excite 20 block rows"),
        (lambda u, y: (u, y), {"order": 99}, "order = 99 with block_rows = 20"),
        (lambda u, y: (u, y), {"dt": -1.0}, "positive sampling time"),
    ],
)
def test_bad_input(change, options, message):
    with pytest.raises(InputError, match=message):
        pi_moesp(change(*experiment(300, 0)), **{"order": 4, "dt": DT, **options})


def test_no_experiments():
    with pytest.raises(InputError, match="no experiments"):
        pi_moesp([], 4, dt=DT)
