"""Structured models: patterns, functions, derivatives, re-parametrisation, pickling, and clear refusals."""

import pickle

import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.hinfstruct import Parameter, StructuredModel

PATTERN = {"A": [[0, 1], ["-k", "-2*d"]], "B": [[0], ["k"]], "C": [["1.5*g", 0]]}


def spring(theta):
    m, c, k = theta
    A = np.array([[0, 1], [-k / m, -c / m]])
    return A, np.array([[0], [1 / m]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))


PHYSICAL = [
    Parameter("m", 2.0, "kg", 0.1, 10),
    Parameter("c", 0.5, "N s/m", 0),
    Parameter("k", 8.0, "N/m", 0),
]
pattern, function = StructuredModel.from_pattern, StructuredModel.from_function


def test_pattern_places_factors_and_repeated_names():
    model = StructuredModel.from_pattern(**PATTERN)
    assert model.names == ("k", "d", "g") and model.affine
    m = model.matrices([3.0, 0.5, 2.0])
    assert m.A.tolist() == [[0, 1], [-3, -1]]
    assert m.B.tolist() == [[0], [3]] and m.C.tolist() == [[3, 0]]
    assert model.statespace([3.0, 0.5, 2.0]).nstates == 2


@pytest.mark.parametrize(
    "model", [pattern(**PATTERN), function(spring, PHYSICAL)], ids=["pattern", "function"]
)
def test_derivatives_agree_with_central_differences(model):
    theta = np.array([2.0, 0.5, 8.0])
    exact = model.differentiate(theta)
    for k in range(3):
        step = 1e-6 * np.eye(3)[k]
        for d, plus, minus in zip(
            exact, model.evaluate(theta + step), model.evaluate(theta - step), strict=True
        ):
            assert d[k] == pytest.approx((plus - minus) / 2e-6, abs=1e-7)


def test_reparametrise_chains_the_derivative():
    model = StructuredModel.from_pattern(**PATTERN)
    p = [Parameter("w", 3.0), Parameter("z", 0.1)]
    other = model.reparametrise(p, lambda x: np.array([x[0] ** 2, x[0] * x[1], 1.0 + 0 * x[0]]))
    at = np.array([3.0, 0.1])
    assert pytest.approx(model.matrices([9.0, 0.3, 1.0]).A) == other.matrices(at).A
    dA = other.differentiate(at)[0]
    assert dA[0] == pytest.approx(np.array([[0, 0], [-6.0, -0.2]]))
    assert dA[1] == pytest.approx(np.array([[0, 0], [0, -6.0]]))


def halved(p):
    return np.array([p[0] / 2, p[0], p[1]])


@pytest.mark.parametrize("model", [
    pattern(**PATTERN), function(spring, PHYSICAL),
    function(spring, PHYSICAL).reparametrise([Parameter("a", 2.0), Parameter("b", 3.0)], halved)])
def test_models_pickle(model):
    copy, theta = pickle.loads(pickle.dumps(model)), np.arange(1.0, 1.0 + model.size)
    assert copy.names == model.names
    for mine, theirs in zip((*copy.evaluate(theta), *copy.differentiate(theta)),
                            (*model.evaluate(theta), *model.differentiate(theta)), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: pattern([["a b"]], [[1]], [[1]]), "write a name"),
        (lambda: pattern([["a"], ["b"]], [[1]], [[1]]), "do not fit together"),
        (lambda: pattern([[-1.0]], [[1]], [[1]]), "at least one parameter"),
        (lambda: pattern([["a", 1], [2]], [[1]], [[1]]), "rows of different length"),
        (lambda: pattern([["a"]], [[1]], [[1]], parameters=[Parameter("b")]), r"uses the parameters \['a'\]"),
        (lambda: pattern([[np.inf]], [["a"]], [[1]]), "NaN or infinite"),
        (lambda: Parameter("m", 20.0, "kg", 0, 10), "nominal 20.0 lies outside"),
        (lambda: Parameter("m", 1.0, "kg", 3, 3), "must be below high"),
        (lambda: function(spring, [Parameter("m"), *PHYSICAL[1:]]), "finite nominal value"),
        (lambda: function(spring, [PHYSICAL[0], *PHYSICAL[:2]]), "declared more than once"),
        (lambda: function(lambda t: (1, 2), PHYSICAL), "four matrices"),
        (
            lambda: function(lambda t: spring(np.abs(t)), PHYSICAL),
            "not analytic",
        ),
        (lambda: function(lambda t: spring([float(x) for x in t]), PHYSICAL), "accept complex"),
        (lambda: function(spring, PHYSICAL, jacobian="numeric"), "a callable or 'complex-step'"),
        (lambda: pattern(**PATTERN).statespace([1.0]), "this model has 3 parameters"),
        (lambda: pattern(**PATTERN).statespace([1.0, np.nan, 0]), r"not finite for \['d'\]"),
    ],
)
def test_bad_input(build, message):
    with pytest.raises(InputError, match=message):
        build()
