"""Plants: nominal parameters as engineers would have them, simulator text, exact truth equations."""

from __future__ import annotations

from concealed.plants.arm import ARM
from concealed.plants.axis import LINEAR_DRIVE, MASS_SPRING_DAMPER, PENDULUM, ROTARY_DRIVE
from concealed.plants.electrical import DC_MOTOR, RL_CIRCUIT
from concealed.plants.hydraulic import HYDRAULIC_CYLINDER
from concealed.plants.tanks import CASCADED_TANKS, SINGLE_TANK
from concealed.plants.thermal import THERMAL_PLANT
from concealed.plants.two_mass import TWO_MASS_DRIVE

PLANTS = {
    plant.name: plant
    for plant in (
        ROTARY_DRIVE, LINEAR_DRIVE, TWO_MASS_DRIVE, PENDULUM, MASS_SPRING_DAMPER, ARM, SINGLE_TANK,
        CASCADED_TANKS, THERMAL_PLANT, DC_MOTOR, RL_CIRCUIT, HYDRAULIC_CYLINDER,
    )
}
