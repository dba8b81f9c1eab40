"""Two missing effects are found by their signatures together, where the best single effect is neither of them."""

from __future__ import annotations

import numpy as np
import pytest
from tests_support import gathered, pushed

from pwaid.mismatch.effects.registry import effect_by_id
from pwaid.mismatch.pairs import fit_joint
from pwaid.mismatch.pairscreen import _together, screen_pairs
from pwaid.mismatch.screen import locate_effects

IDS = ("quadratic_drag", "sensor_drift", "asymmetric_viscous_friction", "sensor_nonlinearity", "constant_load",
       "actuator_gain_asymmetry", "linear_stiffness")


def test_two_columns_explain_what_least_squares_says():
    rng = np.random.default_rng(3)
    S = rng.normal(size=(5, 40)) / 6.0
    S /= np.linalg.norm(S, axis=1, keepdims=True)
    e = S[1] - 0.7 * S[3] + 0.1 * rng.normal(size=40)
    share, weights = _together(S, e, np.zeros(5, dtype=bool))
    for i in range(5):
        for j in range(5):
            if i == j:
                assert share[i, j] == 0.0
                continue
            w, *_ = np.linalg.lstsq(S[[i, j]].T, e, rcond=None)
            assert share[i, j] == pytest.approx(np.sum((S[[i, j]].T @ w) ** 2))
            assert weights[i, j] == pytest.approx(w[0])
    against, _ = _together(S, e, np.array([False, False, False, True, False]))  # the fourth acts one way only
    assert against[1, 3] == against[3, 1] == 0.0 < share[1, 3]


def drag_and_drift(seed: int):
    r = pushed(seed, lambda x, v: -0.5 * abs(v) * v)
    return r.replace(outputs=r.outputs + 0.02 * r.time[:, None])


def test_the_true_pair_comes_first_and_is_fitted():
    evidence = gathered([drag_and_drift(s) for s in (1, 2, 3)], *IDS)
    problem = evidence.problem
    located = locate_effects([e for i in IDS for e in effect_by_id(i)], problem.structure)
    best, second = screen_pairs(problem, problem.null_coarse, located, 2)
    assert {e.effect.id for e in best.located} == {"quadratic_drag", "sensor_drift"}
    assert best.score > max(second.score, 0.9)
    fitted = fit_joint(problem, located, count=1)[0]
    values = dict(zip(fitted.ids, fitted.values(), strict=True))
    assert values["quadratic_drag"][0] == pytest.approx(0.5, rel=0.05)
    assert values["sensor_drift"][0] == pytest.approx(0.02, rel=0.05)


def test_a_pair_that_is_not_allowed_does_not_come():
    evidence = gathered([drag_and_drift(s) for s in (1, 2, 3)], *IDS[:3])
    problem = evidence.problem
    located = locate_effects([e for i in IDS[:3] for e in effect_by_id(i)], problem.structure)
    found = screen_pairs(problem, problem.null_coarse, located, 9, allowed=lambda a, b: "sensor_drift" not in
                         (a.effect.id, b.effect.id))
    assert [sorted(e.effect.id for e in p.located) for p in found] == [["asymmetric_viscous_friction",
                                                                        "quadratic_drag"]]
