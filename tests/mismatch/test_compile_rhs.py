"""Compiled right-hand sides compute what the originals compute."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pwaid.mismatch.compile_rhs import CompileFailure, compiled_pair


def helper(v, params):
    return params["c"] * abs(v)


def update(t, x, u, params):
    theta, omega = x
    damping = params.get("b", 1.0) + helper(omega, params)
    return [omega, (u[0] - damping * omega - math.sin(theta)) / params["J"]]


def test_helpers_defaults_and_unpacking_compile():
    rhs, _, raises = compiled_pair(update, None, (2, 1, 2), {"J": 2.0, "b": 0.3, "c": 0.1})
    dx, x, u = np.empty(2), np.array([0.3, -0.7]), np.array([0.4])
    rhs(0.0, x, u, np.array([2.0, 0.3, 0.1]), dx)
    np.testing.assert_allclose(dx, update(0.0, x, u, {"J": 2.0, "b": 0.3, "c": 0.1}), rtol=1e-12)
    assert not raises


def test_texts_and_arrays_in_params_are_constants():
    def table(t, x, u, params):
        force = np.interp(x[0], params["place"], params["force"])
        if params["mode"] == "damped":
            force = force + params["b"] * x[1]
        return np.array([x[1], u[0] - force])

    constants = {"place": np.array([-1.0, 0.0, 1.0]), "force": np.array([-2.0, 0.0, 0.5]), "mode": "damped"}
    rhs, *_ = compiled_pair(table, None, (2, 1, 2), {"b": 0.3}, constants=constants)
    dx, x, u = np.empty(2), np.array([0.4, -0.7]), np.array([0.4])
    rhs(0.0, x, u, np.array([0.5]), dx)
    np.testing.assert_allclose(dx, [-0.7, 0.4 - 0.2 + 0.35], rtol=1e-12)


def test_what_does_not_compile_says_so():
    def strange(t, x, u, params):
        return [float(str(x[0]))]

    with pytest.raises(CompileFailure):
        compiled_pair(strange, None, (1, 1, 1), {"a": 1.0})


def test_a_parameter_without_default_is_refused():
    def missing(t, x, u, params):
        return np.array([params["nowhere"] * x[0]])

    with pytest.raises(CompileFailure, match="nowhere"):
        compiled_pair(missing, None, (1, 1, 1), {"a": 1.0})
