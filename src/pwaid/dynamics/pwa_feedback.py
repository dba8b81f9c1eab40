"""Piecewise-affine plant and piecewise-affine controller, connected by signal names: again a PWA system.

Every cell of the closed loop is a pair (cell of the plant, cell of the controller); pairs without interior
are left out. So the drive with backlash (3 cells) under switched damping (4 cells) has the 12 cells of
Yamada et al., III-C.3.
"""

from __future__ import annotations

import numpy as np

from pwaid.dynamics.cell import Cell
from pwaid.dynamics.pwa_borders import has_interior
from pwaid.dynamics.pwa_system import PWASystem
from pwaid.errors import InputError

__all__ = ["close_loop"]


def _picker(wanted, available) -> np.ndarray:
    """0/1 matrix that takes the signals `available` to the signals `wanted`; rows of zeros for those not
    there.
    """
    return np.array([[float(w == a) for a in available] for w in wanted]).reshape(len(wanted), len(available))


def close_loop(plant: PWASystem, controller: PWASystem, name: str = "closed loop") -> PWASystem:
    """Connect a plant and a controller that has states of its own or none.

    Plant outputs go to the controller inputs of the same name, controller outputs to the plant inputs of
    the same name. The inputs of neither kind stay inputs of the closed loop (references first, then
    disturbances); its outputs are the plant's outputs and then the controller's; its states the plant's and
    then the controller's.

    Parameters
    ----------
    plant, controller : PWASystem

    Returns
    -------
    PWASystem

    Raises
    ------
    InputError
        No common signal in one of the directions; names used twice; or an algebraic loop: a plant output
        that the controller measures depends on the plant input without delay.
    """
    measured = [y for y in plant.outputs if y in controller.inputs]
    driven = [u for u in plant.inputs if u in controller.outputs]
    if not measured or not driven:
        raise InputError(
            f"plant (inputs {plant.inputs}, outputs {plant.outputs}) and controller (inputs "
            f"{controller.inputs}, outputs {controller.outputs}) share no signal in the "
            f"{'feedback' if driven else 'forward'} direction; "
            "name the measured and the driven signals alike"
        )
    references = tuple(u for u in controller.inputs if u not in measured)
    disturbances = tuple(u for u in plant.inputs if u not in driven)
    cells = []
    for p in plant.cells:
        for c in controller.cells:
            cell = _pair(plant, controller, p, c, references + disturbances)
            if has_interior(cell):
                cells.append(cell)
    return PWASystem(tuple(cells), plant.states + controller.states, references + disturbances,
                     plant.outputs + controller.outputs, name)  # fmt: skip


def _pair(plant: PWASystem, controller: PWASystem, p: Cell, c: Cell, external) -> Cell:
    """The closed loop while the plant is in cell p and the controller in cell c."""
    to_plant_u, ext_to_plant = _picker(plant.inputs, controller.outputs), _picker(plant.inputs, external)
    to_ctrl_u, ext_to_ctrl = _picker(controller.inputs, plant.outputs), _picker(controller.inputs, external)
    if np.abs(to_ctrl_u @ p.D @ to_plant_u).max(initial=0.0) > 0:
        raise InputError(
            f"plant cell {p.name!r}: a measured output depends on a driven input without delay (D is not "
            "zero), an algebraic loop; give the controller or the plant a state in between"
        )
    n, k = p.A.shape[0], c.A.shape[0]
    # controller input v = Vx x + Vw w + v0; plant input u = Ux x + Uc xc + Uw w + u0
    Vx, Vw, v0 = to_ctrl_u @ p.C, to_ctrl_u @ p.D @ ext_to_plant + ext_to_ctrl, to_ctrl_u @ p.c
    Ux, Uc = to_plant_u @ c.D @ Vx, to_plant_u @ c.C
    Uw, u0 = to_plant_u @ c.D @ Vw + ext_to_plant, to_plant_u @ (c.D @ v0 + c.c)
    return Cell(
        A=np.block([[p.A + p.B @ Ux, p.B @ Uc], [c.B @ Vx, c.A]]),
        a=np.concatenate([p.a + p.B @ u0, c.a + c.B @ v0]),
        B=np.vstack([p.B @ Uw, c.B @ Vw]),
        G=np.block([[p.G + p.H @ Ux, p.H @ Uc], [c.H @ Vx, c.G]]),
        H=np.vstack([p.H @ Uw, c.H @ Vw]),
        g=np.concatenate([p.g + p.H @ u0, c.g + c.H @ v0]),
        C=np.block([[p.C + p.D @ Ux, p.D @ Uc], [c.D @ Vx, c.C]]),
        c=np.concatenate([p.c + p.D @ u0, c.c + c.D @ v0]),
        D=np.vstack([p.D @ Uw, c.D @ Vw]),
        F=np.hstack([p.F, np.zeros((p.F.shape[0], k))]) if p.F.size else np.zeros((0, n + k)),
        f=p.f,
        name=" / ".join(part for part in (p.name, c.name) if part),
    )  # fmt: skip
