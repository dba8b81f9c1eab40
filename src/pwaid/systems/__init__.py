"""Systems of known truth, named author-year-system, used by tests, examples and docs alike.

`yamada2018_bench` is a module: its `Bench` is the experiment of section IV of that paper.
"""

from pwaid.systems.maruta2011 import maruta2011_dc_motor
from pwaid.systems.maruta2014 import maruta2014_pyramid, maruta2014_rotary_actuator
from pwaid.systems.vizer2014 import (
    vizer2014_flexible_arm,
    vizer2014_flexible_arm_experiment,
    vizer2014_flexible_arm_lpv,
    vizer2014_flexible_arm_model,
    vizer2014_flexible_arm_sweep,
)
from pwaid.systems.yamada2018 import yamada2018_two_inertia

__all__ = [
    "maruta2011_dc_motor",
    "maruta2014_pyramid",
    "maruta2014_rotary_actuator",
    "vizer2014_flexible_arm",
    "vizer2014_flexible_arm_experiment",
    "vizer2014_flexible_arm_lpv",
    "vizer2014_flexible_arm_model",
    "vizer2014_flexible_arm_sweep",
    "yamada2018_two_inertia",
]
