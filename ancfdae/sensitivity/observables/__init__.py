"""Observables: what can be seen of a motion, with exact partial derivatives."""

from ancfdae.sensitivity.observables.drives import (
    drive_torque,
    guide_force,
    joint_power,
    load_power,
)
from ancfdae.sensitivity.observables.mass import (
    angular_momentum,
    centre_of_mass,
    inertia,
    linear_momentum,
    mass,
)
from ancfdae.sensitivity.observables.observable import (
    Leaf,
    Observable,
    ObservablePartials,
    observe,
    remembered,
)
from ancfdae.sensitivity.observables.quantities import (
    design_value,
    elapsed_time,
    kinetic_energy,
    multiplier,
    reaction,
    strain_energy,
)
from ancfdae.sensitivity.observables.section_forces import (
    axial_force,
    bending_moment,
    shear_force,
    torque,
)
from ancfdae.sensitivity.observables.states import States, states_of
from ancfdae.sensitivity.observables.stress import maximum_stress, von_mises
from ancfdae.sensitivity.observables.user_functions import apply, custom
from ancfdae.sensitivity.observables.vectors import (
    axial_strain,
    deflection,
    position,
    slope,
    slope_angle,
    velocity,
)
