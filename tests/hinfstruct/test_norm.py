"""The norm against closed forms, dense grids and python-control; its certificate and its peaks."""

import importlib

import control
import numpy as np
import pytest
import scipy.linalg

from pwaid.errors import InputError, SolverError
from pwaid.hinfstruct import hinf_norm
from pwaid.hinfstruct.norm import gains_at
from pwaid.hinfstruct.statespace import as_matrices, difference

from .conftest import disguised, random_stable, resonance


@pytest.mark.parametrize("zeta", [0.5, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7])
def test_resonance_has_its_analytic_norm(zeta):
    exact = 1 / (2 * zeta * np.sqrt(1 - zeta**2))
    norm = hinf_norm(resonance(37.0, zeta))
    assert norm.value == pytest.approx(exact, rel=1e-9)
    assert norm.value <= norm.upper <= norm.value * (1 + 1e-9)
    assert norm.frequency == pytest.approx(37 * np.sqrt(1 - 2 * zeta**2), abs=1e-4 * 37 * zeta)


def test_peaks_at_zero_and_at_infinity():
    assert hinf_norm(resonance(3.0, 0.9)).frequencies[0] == 0.0
    high_pass = hinf_norm(([[-1.0]], [[1.0]], [[-1.0]], [[1.0]]))
    assert high_pass.value == pytest.approx(1.0, rel=1e-9) and np.isinf(high_pass.frequency)


@pytest.mark.parametrize("zeta", [1e-2, 1e-5])
def test_two_equal_peaks_are_both_returned(zeta):
    pair = tuple(
        scipy.linalg.block_diag(a, b)
        for a, b in zip(resonance(1.0, zeta), resonance(50.0, zeta), strict=True)
    )
    norm = hinf_norm(pair)
    assert np.sort(norm.active(1e-9)) == pytest.approx(
        np.array([1.0, 50.0]) * np.sqrt(1 - 2 * zeta**2), rel=1e-4 * zeta
    )
    assert norm.value == pytest.approx(1 / (2 * zeta * np.sqrt(1 - zeta**2)), rel=1e-9)


def test_all_peaks_above_a_fraction():
    blocks = [resonance(w, z) for w, z in ((1.0, 0.01), (10.0, 0.0125), (100.0, 0.03))]
    system = tuple(scipy.linalg.block_diag(*parts) for parts in zip(*blocks, strict=True))
    assert hinf_norm(system, fraction=0.99).frequencies.size == 1
    assert hinf_norm(system, fraction=0.7).frequencies.size == 2
    assert np.sort(hinf_norm(system, fraction=0.2).frequencies) == pytest.approx([1, 10, 100], rel=5e-3)


@pytest.mark.parametrize(("n", "seed"), [(3, 0), (12, 1), (30, 2), (100, 3)])
def test_random_systems_stay_below_the_certified_bound(n, seed):
    system = random_stable(n, seed, margin=0.05)
    norm = hinf_norm(system, fraction=0.5)
    m = as_matrices(system)
    grid = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 40_000 // n)])
    gains = gains_at(m, grid)
    assert gains.max() <= norm.upper
    assert gains_at(m, norm.frequencies) == pytest.approx(norm.gains, rel=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_value_meets_its_certificate_and_is_a_true_gain(seed):
    n, inputs, outputs = 2 + seed % 7, 1 + seed % 3, 1 + seed // 3 % 3
    system = random_stable(n, 100 + seed, inputs, outputs, margin=10.0 ** -(seed % 4))
    norm = hinf_norm(system)
    assert norm.upper <= norm.value * (1 + 3e-10)
    assert gains_at(as_matrices(system), norm.frequency)[0] == pytest.approx(norm.value, rel=1e-12)


def test_grid_peaks_are_all_found():
    system = random_stable(14, 7, margin=0.02)
    norm = hinf_norm(system, fraction=0.3)
    grid = np.geomspace(1e-3, 1e3, 40000)
    gains = gains_at(as_matrices(system), grid)
    inner = (gains[1:-1] > gains[:-2]) & (gains[1:-1] > gains[2:]) & (gains[1:-1] >= 0.3001 * norm.value)
    for omega in grid[1:-1][inner]:
        assert np.min(np.abs(norm.frequencies - omega)) < 1e-3 * omega


def test_discrete_norm_is_that_of_the_unit_circle():
    rng = np.random.default_rng(5)
    A = rng.standard_normal((5, 5))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    system = control.ss(A, rng.standard_normal((5, 2)), rng.standard_normal((2, 5)), np.zeros((2, 2)), 0.1)
    norm = hinf_norm(system)
    gains = gains_at(as_matrices(system), np.linspace(0, np.pi / 0.1, 20001))
    assert 0.999 * norm.value <= gains.max() <= norm.upper
    assert gains_at(as_matrices(system), norm.frequency)[0] == pytest.approx(norm.value, rel=1e-9)


def test_all_pass_and_static_gain_and_zero():
    assert hinf_norm(([[-1.0]], [[1.0]], [[-2.0]], [[1.0]])).value == pytest.approx(1.0, rel=1e-12)
    assert hinf_norm(([[-1.0]], [[0.0]], [[1.0]], [[-3.0]])).value == pytest.approx(3.0)
    assert hinf_norm(([[-1.0]], [[0.0]], [[1.0]], [[0.0]])).value == 0.0


def test_defective_poles_and_widely_spread_poles():
    chain = -np.eye(6) + np.diag(np.ones(5), 1)  # 1 / (s + 1)^6, one eigenvector
    first, last = np.eye(6)[:1], np.eye(6)[:, -1:]
    norm = hinf_norm((chain, last, first, [[0.0]]))
    assert norm.value == pytest.approx(1.0, rel=1e-9) and norm.frequency == 0.0
    spread = (np.diag([-1e-6, -1e6]), np.ones((2, 1)), [[1e-6, 1e6]], [[0.0]])
    assert hinf_norm(spread).value == pytest.approx(2.0, rel=1e-9)


def test_an_exact_difference_is_zero_up_to_rounding():
    system = random_stable(8, 4)
    Q, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((8, 8)))
    same = (Q.T @ system[0] @ Q, Q.T @ system[1], system[2] @ Q, system[3])
    norm = hinf_norm(difference(as_matrices(system), as_matrices(same)))
    assert norm.value <= norm.upper < 1e-11 * hinf_norm(system).value


def test_agrees_with_slicot_where_it_is_installed():
    pytest.importorskip("slycot")
    for seed in range(5):
        system = random_stable(12, seed)
        reference, _ = control.linfnorm(control.ss(*system), tol=1e-11)
        assert hinf_norm(system).value == pytest.approx(reference, rel=1e-9)


@pytest.mark.parametrize(
    ("system", "options", "message"),
    [
        (([[0.5]], [[1.0]], [[1.0]], [[0.0]]), {}, "not stable.*norm is infinite"),
        (([[np.nan]], [[1.0]], [[1.0]], [[0.0]]), {}, "A contains NaN"),
        (([[-1.0]], [[1.0, 2.0]], [[1.0]], [[0.0]]), {}, "do not fit together"),
        (resonance(1.0, 0.1), {"fraction": 0.0}, "fraction = 0.0; expected"),
        (resonance(1.0, 0.1), {"tol": 1.0}, "tol = 1.0; expected"),
        ("a string", {}, "expected control.StateSpace"),
    ],
)
def test_bad_input(system, options, message):
    with pytest.raises(InputError, match=message):
        hinf_norm(system, **options)


def test_gains_that_climb_by_rounding_end_in_a_wider_certificate(arm, monkeypatch):
    module = importlib.import_module("pwaid.hinfstruct.norm")
    climb, peaks = 1e-9, module._peaks

    def climbing(gain, value, fraction):
        where, gains = peaks(gain, value, fraction)
        return where, np.maximum(gains, value) * (1 + climb)

    monkeypatch.setattr(module, "_peaks", climbing)
    m = as_matrices(arm.matrices(0.1))
    with pytest.raises(SolverError, match="keeps exceeding"):  # a gain of order one climbs for real
        hinf_norm(m)
    climb = 1e-4
    A, B, C, D = disguised(m, 1)
    norm = hinf_norm(difference(m, as_matrices((A, B, (1 + 1e-10) * C, D))))
    assert norm.iterations >= 5  # five rounds, all in vain
    assert 1e-4 < norm.upper / norm.value - 1 < 1e-3


@pytest.mark.parametrize("system, fraction, value", [
    (control.ss(np.diag([-1.0, -2.0]), np.eye(2), np.diag([-0.5, -0.5]), np.diag([1.0, 0.99])), 0.99, 1.0),
    (control.ss([[-1.0]], [[1.0]], [[1.0]], [[1.0]]), 0.5, 2.0),
])
def test_levels_that_are_singular_values_of_the_feedthrough(system, fraction, value):
    assert hinf_norm(system, fraction=fraction).value == pytest.approx(value)
