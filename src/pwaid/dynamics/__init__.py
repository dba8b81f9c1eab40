"""Dynamic models: NARX with free-run simulation, and continuous-time PWA systems with located events."""

from pwaid.dynamics.cell import Cell
from pwaid.dynamics.dry_friction import DryFriction
from pwaid.dynamics.fit_measures import explained_percent, fit_percent, rmse
from pwaid.dynamics.narx import NARX, NARXPath
from pwaid.dynamics.narx_model import FreeRun, NARXModel
from pwaid.dynamics.phase_portrait import phase_portrait
from pwaid.dynamics.pwa_convert import cells_of_hyperplanes, from_nlsys, to_nlsys
from pwaid.dynamics.pwa_discrete import discretise
from pwaid.dynamics.pwa_feedback import close_loop
from pwaid.dynamics.pwa_simulation import PWAStatus, PWATrajectory
from pwaid.dynamics.pwa_system import PWASystem
from pwaid.dynamics.refine import refine, refine_path

__all__ = [
    "NARX",
    "Cell",
    "DryFriction",
    "FreeRun",
    "NARXModel",
    "NARXPath",
    "PWAStatus",
    "PWASystem",
    "PWATrajectory",
    "cells_of_hyperplanes",
    "close_loop",
    "discretise",
    "explained_percent",
    "fit_percent",
    "from_nlsys",
    "phase_portrait",
    "refine",
    "refine_path",
    "rmse",
    "to_nlsys",
]
