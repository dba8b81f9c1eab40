"""Dynamic models: NARX with free-run simulation, and continuous-time PWA systems with located events."""

from pwaid.dynamics.cell import Cell
from pwaid.dynamics.dry_friction import DryFriction
from pwaid.dynamics.narx import NARX
from pwaid.dynamics.phase_portrait import phase_portrait
from pwaid.dynamics.pwa_convert import cells_of_hyperplanes, from_nlsys, to_nlsys
from pwaid.dynamics.pwa_discrete import discretise
from pwaid.dynamics.pwa_feedback import close_loop
from pwaid.dynamics.pwa_simulation import PWAStatus, PWATrajectory
from pwaid.dynamics.pwa_system import PWASystem

__all__ = [
    "NARX",
    "Cell",
    "DryFriction",
    "PWAStatus",
    "PWASystem",
    "PWATrajectory",
    "cells_of_hyperplanes",
    "close_loop",
    "discretise",
    "from_nlsys",
    "phase_portrait",
    "to_nlsys",
]
