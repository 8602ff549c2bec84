"""Observables: what can be seen of a motion, with exact partial derivatives."""

from ancfdae.observables.drives import drive_torque, guide_force, joint_power, load_power
from ancfdae.observables.mass import (
    angular_momentum,
    centre_of_mass,
    inertia,
    linear_momentum,
    mass,
)
from ancfdae.observables.observable import (
    Leaf,
    Observable,
    ObservablePartials,
    observe,
    remembered,
)
from ancfdae.observables.quantities import (
    design_value,
    elapsed_time,
    kinetic_energy,
    multiplier,
    reaction,
    strain_energy,
)
from ancfdae.observables.section_forces import axial_force, bending_moment, shear_force, torque
from ancfdae.observables.states import States, states_of
from ancfdae.observables.stress import maximum_stress, von_mises
from ancfdae.observables.user_functions import apply, custom
from ancfdae.observables.vectors import (
    axial_strain,
    deflection,
    position,
    slope,
    slope_angle,
    velocity,
)
