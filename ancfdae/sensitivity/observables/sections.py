"""Observables of the sections of beams: forces and moments, and von Mises' stress.

**Forces and moments** act from the beam beyond the section on the beam before it. Their axes are
those of the deformed section: its normal, its height, and the axis across both; moments are about
the axis of the beam. Internal damping contributes. They follow from the forces that elements
transmit from node to node. Where loads, reactions and inertia act at nodes, they are balanced to
round-off; loads spread along elements, inertia among them, leave an error of second order in the
element length, at any point (docs/theory/02-strain-energy.md). A load or joint between nodes
spreads over its element.

At an inner node forces jump by the force of a joint, load or point mass there. ``rod.at(0.5)`` is
just after it, in the element that begins there, ``rod.at(0.5, before=True)`` just before; the end
of a beam belongs to the last element. Shear forces and moments of cables follow from their
curvature: moments are best at 1/2 -+ 1/(2 sqrt 3) of an element. A cable in space has no axes
across it: its shear force along 1 and its moment about 2 are the magnitudes of the vectors.

**Stress**, at a point or as a smooth maximum over a beam, is the second Piola-Kirchhoff stress of
the beam's law, with internal damping; it differs from the true stress by the order of the strain.
The shear stress of torsion is distributed over a section by Saint-Venant's solution, over boxes by
Bredt's formula, over I sections by the formula of each wall. The shear stress of V_y and V_z is
distributed by Jourawski's formula, with its component along the force only, and so is the radial
stress of curved beams, M/(A R) in the mean; both uniformly for energies other than
`EnhancedContinuum`. In a curved bar in bending the stress errs, against plane elasticity, by 3.5 %
of its largest value where the radius of curvature equals the height, by 1.0 % and 0.2 % where it is
two and five times the height. Cables have the stress of their axial force and bending moment; in
space, where their rotation about the axis is unknown, the largest stress that a point at this
distance from the centroid can have. A strain of 1e-9 is added in squares, E times 1e-9, so that the
stress has a derivative where there is none.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import final

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.checks import require_positive, require_text
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint, Quantity, require_point
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.observable import (
    Leaf,
    LeafGradient,
    Named,
    Observable,
    States,
    known_scene,
    require_index,
)


class ForceComponent(IntEnum):
    """A force or moment of a section; the value is its index among the six."""

    AXIAL_FORCE = 0
    SHEAR_FORCE_Y = 1
    SHEAR_FORCE_Z = 2
    TORQUE = 3
    BENDING_MOMENT_Y = 4
    BENDING_MOMENT_Z = 5


def axial_force(point: MaterialPoint) -> Observable:
    """Return the axial force in a beam at a point of its axis, positive in tension; N."""
    return SectionForce(point, ForceComponent.AXIAL_FORCE)


def shear_force(point: MaterialPoint, along: int = 1) -> Observable:
    """Return a shear force in a beam at a point of its axis; N.

    `along` is 1 for the height of the section and 2 for its width.
    """
    components = (ForceComponent.SHEAR_FORCE_Y, ForceComponent.SHEAR_FORCE_Z)
    return SectionForce(point, components[_across("shear_force, along", along)])


def bending_moment(point: MaterialPoint, about: int = 2) -> Observable:
    """Return a bending moment in a beam at a point of its axis; N m.

    `about` is 2 for the width of the section, the z axis of a planar scene, and 1 for its height.
    A positive moment about z bends the beam towards its height axis.
    """
    components = (ForceComponent.BENDING_MOMENT_Y, ForceComponent.BENDING_MOMENT_Z)
    return SectionForce(point, components[_across("bending_moment, about", about)])


def torsional_moment(point: MaterialPoint) -> Observable:
    """Return the torsional moment (torque) in a spatial beam at a point of its axis; N m."""
    return SectionForce(point, ForceComponent.TORQUE)


def _across(where: str, axis: int) -> int:
    """Return the index, 0 or 1, of an axis of the section, 1 (height) or 2 (width)."""
    require_index(where, axis)
    if axis == 0:
        raise InvalidInputError(
            where, "must be an axis of the section", axis, "Use 1 (height) or 2 (width)."
        )
    return int(axis) - 1


@final
@dataclass(frozen=True)
class SectionForce(Leaf):
    """A force or moment in a beam, in the axes of its section."""

    point: MaterialPoint
    component: ForceComponent

    def __post_init__(self) -> None:
        require_point("section force, point", self.point)
        if self.point.y != 0 or self.point.z != 0:
            raise InvalidInputError(
                "section force, point",
                "must lie on the axis of the beam: forces belong to the whole section",
                f"y = {self.point.y}, z = {self.point.z}",
                "For example rod.at(0.5), without y and z.",
            )

    def check_leaf(self, system: Named) -> None:
        """Raise for a point that does not exist, or a component that a plane or a cable lacks."""
        element = known_scene(system).naming.layout.beam(self.point.beam).element
        planar = (
            ForceComponent.AXIAL_FORCE,
            ForceComponent.SHEAR_FORCE_Y,
            ForceComponent.BENDING_MOMENT_Z,
        )
        if Quantity.SLOPE_Z not in element.quantities and self.component not in planar:
            raise InvalidInputError(
                "section force",
                "a planar beam, and a cable, has an axial force, a shear force along 1 and a "
                "moment about 2",
                self.component.name,
                "Use one of these, or a spatial beam.",
            )
        known_scene(system).sections.forces(self.point)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return the section force, N, or moment, N m, at the states, shape (k,)."""
        forces = known_scene(system).sections.forces(self.point)
        return forces.value(self.component, states.q, states.v)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return partials by complex steps of the element's coordinates and parameters."""
        forces = known_scene(system).sections.forces(self.point)
        return LeafGradient.of(forces.partials(self.component, states.q, states.v, system.n_b))


# -- stress ------------------------------------------------------------------------------------


def von_mises(point: MaterialPoint) -> Observable:
    """Return von Mises' stress at a point of a beam, for example ``rod.at(0.3, y=0.01)``; Pa."""
    return VonMises(point)


def maximum_von_mises(beam: str, sharpness: float) -> Observable:
    """Return the smooth maximum of von Mises' stress over a beam at every time; Pa.

    The aggregate of Kreisselmeier and Steinhauser over n points, log(sum exp(k s))/k: it exceeds
    the largest stress s by at most log(n)/k. The points are those of the section's outline where
    stresses of bending and torsion are largest, at both ends and in the middle of every element.

    For a bound over time too, use ``SmoothUpperBound(maximum_von_mises("rod", k), k)``.

    Parameters
    ----------
    beam : str
        Name of the beam.
    sharpness : float
        k, in the inverse unit of a stress; positive. For example 50 over the allowable stress.
    """
    return MaximumStress(beam, sharpness)


@final
@dataclass(frozen=True)
class VonMises(Leaf):
    """Von Mises' stress at a material point."""

    point: MaterialPoint

    def __post_init__(self) -> None:
        require_point("von_mises, point", self.point)

    def check_leaf(self, system: Named) -> None:
        """Raise for a point that does not exist or lies outside the section."""
        sections = known_scene(system).sections
        sections.require_material(self.point)
        sections.stress_at(self.point)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return von Mises' stress at the states, shape (k,); Pa."""
        return known_scene(system).sections.stress_at(self.point).value(states.q, states.v)[:, 0, 0]

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the partials of the stress in q, v and the design variables."""
        points = known_scene(system).sections.stress_at(self.point)
        weights = np.ones((len(states.t), 1, 1))
        return LeafGradient.of(points.partials(states.q, states.v, weights, system.n_b))


@final
@dataclass(frozen=True)
class MaximumStress(Leaf):
    """Kreisselmeier-Steinhauser aggregate of von Mises' stress over a beam."""

    beam: str
    sharpness: float

    def __post_init__(self) -> None:
        require_text("maximum_von_mises, beam", self.beam)
        require_positive("maximum_von_mises, sharpness", self.sharpness)

    def check_leaf(self, system: Named) -> None:
        """Raise unless the scene has the beam and stresses are known in it."""
        known_scene(system).sections.stress_over(self.beam)

    def leaf_value(self, system: Named, states: States) -> Array:
        """Return log(sum exp(k s))/k over the points of the beam, shape (n_t,); Pa."""
        stress = known_scene(system).sections.stress_over(self.beam).value(states.q, states.v)
        k = self.sharpness
        return np.asarray(scipy.special.logsumexp(k * stress, axis=(1, 2)) / k)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Return the partials: the mean of partials of stresses s, with weights exp(k s)."""
        points = known_scene(system).sections.stress_over(self.beam)
        stress = points.value(states.q, states.v)
        weights = scipy.special.softmax(self.sharpness * stress, axis=(1, 2))
        return LeafGradient.of(points.partials(states.q, states.v, weights, system.n_b))
