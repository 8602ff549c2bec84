"""Observables: quantities of a motion at every instant, with exact partial derivatives."""

from ancfdae.sensitivity.observables.accelerations import acceleration
from ancfdae.sensitivity.observables.controllers import effort, state
from ancfdae.sensitivity.observables.drives import (
    driver_force,
    driver_torque,
    joint_power,
    load_power,
    spring_energy,
)
from ancfdae.sensitivity.observables.mass import (
    angular_momentum,
    centre_of_mass,
    inertia,
    linear_momentum,
    mass,
)
from ancfdae.sensitivity.observables.observable import observe
from ancfdae.sensitivity.observables.orientation import orientation, rotation_angle
from ancfdae.sensitivity.observables.quantities import (
    design_value,
    elapsed_time,
    gravitational_energy,
    kinetic_energy,
    multiplier,
    potential_energy,
    reaction,
    strain_energy,
)
from ancfdae.sensitivity.observables.rotation import angular_velocity
from ancfdae.sensitivity.observables.section_forces import (
    axial_force,
    bending_moment,
    shear_force,
    torsional_moment,
)
from ancfdae.sensitivity.observables.stress import maximum_von_mises, von_mises
from ancfdae.sensitivity.observables.user_functions import apply, custom
from ancfdae.sensitivity.observables.vectors import (
    axial_strain,
    deflection,
    position,
    slope,
    slope_angle,
    velocity,
)

__all__ = [
    "acceleration",
    "angular_momentum",
    "angular_velocity",
    "apply",
    "axial_force",
    "axial_strain",
    "bending_moment",
    "centre_of_mass",
    "custom",
    "deflection",
    "design_value",
    "driver_force",
    "driver_torque",
    "effort",
    "elapsed_time",
    "gravitational_energy",
    "inertia",
    "joint_power",
    "kinetic_energy",
    "linear_momentum",
    "load_power",
    "mass",
    "maximum_von_mises",
    "multiplier",
    "observe",
    "orientation",
    "position",
    "potential_energy",
    "reaction",
    "rotation_angle",
    "shear_force",
    "slope",
    "slope_angle",
    "spring_energy",
    "state",
    "strain_energy",
    "torsional_moment",
    "velocity",
    "von_mises",
]
