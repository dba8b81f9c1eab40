"""Systems made by interconnect and feedback: the same numbers as python-control, compiled."""

from __future__ import annotations

import control
import numpy as np
import pytest

from pwaid.errors import InputError
from pwaid.mismatch.plant import as_plant


def motor(t, x, u, params):
    return [(u[0] - params.get("b", 0.2) * x[0] - 0.1 * np.tanh(20 * x[0])) / params.get("J", 1.0)]


PLANT = control.nlsys(motor, None, inputs=["u"], outputs=["w"], states=["w"], params={"J": 1.0, "b": 0.2}, name="motor")
PI = control.ss([[0]], [[1]], [[2.0]], [[3.0]], inputs=["e"], outputs=["u"], name="pi")
SUM = control.summing_junction(inputs=["r", "-w"], output="e")
LOOP = control.interconnect([PLANT, PI, SUM], inputs=["r"], outputs=["w", "u"])
GAIN = control.ss([], [], [], [[2.0]], name="gain")


@pytest.mark.parametrize("system", [LOOP, control.feedback(PLANT, GAIN), control.feedback(
    control.series(GAIN, PLANT), GAIN)])
def test_an_interconnection_compiles_and_computes_the_same(system):
    plant, rng = as_plant(system), np.random.default_rng(0)
    assert plant.rhs is not None and dict(plant.parameters) == {"J": 1.0, "b": 0.2}
    for _ in range(20):
        x, u = rng.normal(size=system.nstates), rng.normal(size=system.ninputs)
        p = rng.uniform(0.5, 2.0, 2)
        params = dict(zip(plant.parameters, p, strict=True))
        np.testing.assert_allclose(plant.derivative(x, u, p), system.dynamics(0.0, x, u, params), rtol=1e-12)
        np.testing.assert_allclose(plant.outputs(x, u, p), system.output(0.0, x, u, params), rtol=1e-12)


def test_an_algebraic_loop_is_said():
    through = control.nlsys(None, lambda t, x, u, params: 2.0 * np.asarray(u), inputs=["u"], outputs=["y"],
                            name="through")
    loop = control.interconnect([through, PLANT], connections=[["through.u", "through.y"], ["motor.u", "through.y"]],
                                inplist=["through.u"], outlist=["motor.w"])
    with pytest.raises(InputError, match="algebraic loop"):
        as_plant(loop)
