"""From local recordings to a certified LPV model (Vizer, Mercère, Prot & Laroche 2014), usable on its own.

Local recordings are identified by subspace methods (`pi_moesp`), brought to continuous time (`d2c`), fitted
with the structure that physics gives (`StructuredModel`, `restructure_path`) in the H-infinity norm
(`hinf_norm`), checked (`identifiability`), and joined into one LPV model (`LPVModel`, `fit_lpv_minimax`,
`InertiaStructure`).
"""

from pwaid.hinfstruct.balance import Balanced, align_models, average_models, balance
from pwaid.hinfstruct.discretise import c2d, d2c
from pwaid.hinfstruct.identifiability import Identifiability, identifiability
from pwaid.hinfstruct.inertia import InertiaLPV, InertiaStructure
from pwaid.hinfstruct.lpv import LPVModel, fit_polynomial
from pwaid.hinfstruct.lpv_fit import InertiaFit, LPVFit, fit_inertia, fit_lpv_minimax, lpv_errors
from pwaid.hinfstruct.metrics import bft, interpolation_fit, vaf
from pwaid.hinfstruct.nonsmooth import NonsmoothRun, proximity_bundle
from pwaid.hinfstruct.norm import HinfNorm, hinf_norm
from pwaid.hinfstruct.polish import Polished, polish_output_error
from pwaid.hinfstruct.problem import MatchingProblem
from pwaid.hinfstruct.proxlinear import prox_linear
from pwaid.hinfstruct.restructure import Restructured, restructure, restructure_path
from pwaid.hinfstruct.simulate import simulate_lpv
from pwaid.hinfstruct.smooth import lbfgs, levenberg_marquardt
from pwaid.hinfstruct.starts import null_space_start, printed_start_system, velocity_loop_start
from pwaid.hinfstruct.statespace import frequency_response, simulate_discrete
from pwaid.hinfstruct.structured import Parameter, StructuredModel
from pwaid.hinfstruct.subspace import SubspaceModel, pi_moesp, po_moesp

__all__ = [
    "Balanced",
    "HinfNorm",
    "Identifiability",
    "InertiaFit",
    "InertiaLPV",
    "InertiaStructure",
    "LPVFit",
    "LPVModel",
    "MatchingProblem",
    "NonsmoothRun",
    "Parameter",
    "Polished",
    "Restructured",
    "StructuredModel",
    "SubspaceModel",
    "align_models",
    "average_models",
    "balance",
    "bft",
    "c2d",
    "d2c",
    "fit_inertia",
    "fit_lpv_minimax",
    "fit_polynomial",
    "frequency_response",
    "hinf_norm",
    "identifiability",
    "interpolation_fit",
    "lbfgs",
    "levenberg_marquardt",
    "lpv_errors",
    "null_space_start",
    "pi_moesp",
    "po_moesp",
    "polish_output_error",
    "printed_start_system",
    "prox_linear",
    "proximity_bundle",
    "restructure",
    "restructure_path",
    "simulate_discrete",
    "simulate_lpv",
    "vaf",
    "velocity_loop_start",
]
