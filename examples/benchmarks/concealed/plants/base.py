"""What every plant declares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Param:
    """One physical parameter: `free` ones may be wrong in the nominal simulator, the others are trusted."""

    name: str
    unit: str
    typical: float
    free: bool = True
    meaning: str = ""


@dataclass(frozen=True)
class Plant:
    """A plant with its nominal simulator text and the facts the generator needs.

    Attributes
    ----------
    kind : int
        Which equations `concealed.integrate` uses.
    states, inputs : tuple of (name, unit)
    params : tuple of Param
        In the order of the integrator's parameter vector.
    force_unit : str
        Unit of the quantity that a disturbance or a constant load adds to.
    ts : float
        Sampling time, seconds.
    amplitude, bias : tuple of float
        Usual input size and its mean, one per input.
    band : (float, float)
        Excited band, Hz.
    measured : dict
        Label of a measured set -> indices of the measured states.
    position, velocity : int
        State indices of the axis that carries friction, -1 if there is none.
    effects : tuple of str
        Catalogue ids that make sense here.
    source : callable(params, variant) -> str
        Text of `simulator.py`; `variant` is the effect the nominal text leaves out by construction, or "".
    switches : dict
        Structural slots of the effect vector that the usual nominal simulator has.
    loop : dict
        How a controller for this plant is designed: see `concealed.excitation.controller`.
    """

    name: str
    title: str
    kind: int
    states: tuple
    inputs: tuple
    params: tuple
    force_unit: str
    ts: float
    amplitude: tuple
    bias: tuple
    band: tuple
    measured: dict
    position: int
    velocity: int
    effects: tuple
    source: Callable
    x0: tuple
    x0_spread: tuple
    switches: dict = field(default_factory=dict)
    loop: dict = field(default_factory=dict)

    def index(self, name):
        """Position of the parameter `name` in the integrator's parameter vector."""
        return [p.name for p in self.params].index(name)


_TEXT = '''"""{title}. {note}"""

import {module}
import numpy as np

PARAMETERS = {{
{parameters}
}}


def derivative(t, x, u, params):
{unpack}
{body}


def output(t, x, u, params):
    return np.array([{outputs}])


def build():
    return control.nlsys(
        derivative,
        output,
        inputs={inputs},
        outputs={output_names},
        states={states},
        params=dict(PARAMETERS),
        name="{name}",
    )
'''


def nonlinear_text(plant, params, measured, body, note, omit=()):
    """Text of a `simulator.py` around the state equation `body`, parameters in `omit` left out."""
    kept = [p for p in plant.params if p.name not in omit]
    lines = [f'    "{p.name}": {params[p.name]:.6g},  # {p.unit}{", " + p.meaning if p.meaning else ""}'
             for p in kept]
    unpack = [f'    {p.name} = params["{p.name}"]' for p in kept]
    return _TEXT.format(
        title=plant.title, note=note, module="control", parameters="\n".join(lines), unpack="\n".join(unpack),
        body=body, outputs=", ".join(f"x[{i}]" for i in measured),
        inputs=repr([n for n, _ in plant.inputs]), output_names=repr([plant.states[i][0]
                                                                      + "_m" for i in measured]),
        states=repr([n for n, _ in plant.states]), name=plant.name,
    )
