"""A rotary drive with a soft return spring: motor torque to shaft angle."""

import control
import numpy as np


def update(t, x, u, params):
    J, b, k = params["J"], params["b"], params["k"]
    return np.array([x[1], (u[0] - b * x[1] - k * x[0]) / J])


def output(t, x, u, params):
    return np.array([x[0]])


def build():
    return control.nlsys(update, output, inputs=["torque"], outputs=["theta"], states=["theta", "omega"],
                         params={"J": 0.0224, "b": 0.048, "k": 0.9}, name="rotary_drive")
