"""What a drawn effect is, and the sizes it is drawn from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from concealed.catalogue import FAMILY


@dataclass(frozen=True)
class Scene:
    """Sizes in a run without the effect: rms force, rms and peak of motion and input, output statistics."""

    plant: object
    p: np.ndarray
    force: float
    q_rms: float
    q_max: float
    v_rms: float
    u_rms: float
    u_mean: float
    u_max: float
    slope: float
    y_std: np.ndarray
    y_mean: np.ndarray
    y_max: np.ndarray
    x_max: np.ndarray
    x_mean: np.ndarray
    seconds: float
    measured: tuple


@dataclass(frozen=True)
class Drawn:
    """One effect with numbers: slots of the effect vector, the key's parameters, and changes to the nominal
    side."""

    id: str
    slots: dict
    parameters: dict
    where: dict
    variant: str = ""
    trusted: tuple = ()
    p: dict = field(default_factory=dict)
    nominal_p: dict = field(default_factory=dict)
    nominal_switches: dict = field(default_factory=dict)
    drift: tuple = ()

    @property
    def family(self):
        """Family of the design's effect table."""
        return FAMILY[self.id]
