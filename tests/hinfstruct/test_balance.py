"""Balanced gramians, the transformation, truncation bound, coherent signs and order, averages."""

import numpy as np
import pytest
import scipy.linalg

from pwaid.errors import InputError
from pwaid.hinfstruct import align_models, average_models, balance, c2d, hinf_norm
from pwaid.hinfstruct.statespace import Matrices, as_matrices, difference

from .conftest import random_stable


@pytest.mark.parametrize("discrete", [False, True])
def test_gramians_are_equal_and_diagonal(discrete):
    system = c2d(random_stable(6, 0), 0.1) if discrete else random_stable(6, 0)
    result = balance(system)
    m = as_matrices(result.system)
    if discrete:
        Wc = scipy.linalg.solve_discrete_lyapunov(m.A, m.B @ m.B.T)
        Wo = scipy.linalg.solve_discrete_lyapunov(m.A.T, m.C.T @ m.C)
    else:
        Wc = scipy.linalg.solve_continuous_lyapunov(m.A, -m.B @ m.B.T)
        Wo = scipy.linalg.solve_continuous_lyapunov(m.A.T, -m.C.T @ m.C)
    scale = result.hankel[0]
    assert Wc == pytest.approx(np.diag(result.hankel), abs=1e-9 * scale)
    assert Wo == pytest.approx(np.diag(result.hankel), abs=1e-9 * scale)
    A = as_matrices(system).A
    assert result.T_inverse @ A @ result.T == pytest.approx(m.A, abs=1e-9 * np.abs(m.A).max())
    assert result.T_inverse @ result.T == pytest.approx(np.eye(6), abs=1e-9)


def test_truncation_respects_its_bound():
    system = as_matrices(random_stable(8, 1))
    reduced = balance(system, order=5)
    error = hinf_norm(difference(as_matrices(reduced.system), system)).value
    assert 0 < error <= reduced.truncation_bound


def test_alignment_undoes_signs_and_order():
    rng = np.random.default_rng(0)
    base = as_matrices(balance(random_stable(5, 2)).system)
    models = [base]
    for _ in range(4):
        perm, sign = rng.permutation(5), rng.choice([-1.0, 1.0], 5)
        A = base.A[np.ix_(perm, perm)] * sign[:, None] * sign
        models.append(Matrices(A, base.B[perm] * sign[:, None], base.C[:, perm] * sign, base.D))
    for aligned in align_models(models):
        assert pytest.approx(base.A) == aligned.A
        assert pytest.approx(base.B) == aligned.B
    mean = average_models(models)
    assert pytest.approx(base.A) == mean.A and pytest.approx(base.C) == mean.C


def test_bad_input():
    with pytest.raises(InputError, match="needs a stable system"):
        balance(([[1.0]], [[1.0]], [[1.0]], [[0.0]]))
    with pytest.raises(InputError, match="order = 9; expected 1 to 3"):
        balance(random_stable(3, 0), order=9)
    with pytest.raises(InputError, match=r"not minimal.*order=1"):
        balance((np.diag([-1.0, -2.0]), [[1.0], [0.0]], [[1.0, 0.0]], [[0.0]]))
    with pytest.raises(InputError, match="no systems to average"):
        average_models([])
    with pytest.raises(InputError, match="differ in order"):
        align_models([random_stable(3, 0), random_stable(4, 0)])
