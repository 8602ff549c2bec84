"""Observables of the sections of beams: axial and shear forces, bending moments, torque.

They are what the beam beyond the section does to the beam before it, in the axes of the deformed
section: its normal, its height, and what is across both; moments are about the axis of the beam.
Internal damping has its part. They follow from what elements transmit from node to node, so that
they are in balance with loads, reactions and inertia to round-off where these act at nodes; loads
spread along elements, inertia among them, leave an error of second order in the element length, at
any point (docs/theory/02-strain-energy.md). A load or joint between nodes spreads over its element.

At an inner node forces jump by what a joint, load or point mass does there. ``rod.at(0.5)`` is just
after it, in the element that begins there, ``rod.at(0.5, before=True)`` just before; the end of a
beam belongs to the last element. Shear forces and moments of cables follow from their
curvature: moments are best at 1/2 -+ 1/(2 sqrt 3) of an element. A cable in space has no
axes across it: its shear force along 1 and its moment about 2 are the sizes of the vectors.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import final

from ancfdae.equations import MechanicalSystem
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint, Quantity, require_point
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.observable import Leaf, LeafGradient, Observable
from ancfdae.sensitivity.observables.states import Named, States, known_scene, require_index


class ForceComponent(IntEnum):
    """Which force or moment of a section; the value is its place among them."""

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
    """Return the torque in a spatial beam at a point of its axis; N m."""
    return SectionForce(point, ForceComponent.TORQUE)


def _across(where: str, axis: int) -> int:
    """Place of an axis of the section, 1 or 2, among them."""
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
        """Refuse a point that does not exist, and what a plane or a cable lacks."""
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
        """Integral over the section."""
        forces = known_scene(system).sections.forces(self.point)
        return forces.value(self.component, states.q, states.v)

    def leaf_gradient(self, system: MechanicalSystem, states: States) -> LeafGradient:
        """Complex steps of the element's coordinates and parameters."""
        forces = known_scene(system).sections.forces(self.point)
        return LeafGradient.of(forces.partials(self.component, states.q, states.v, system.n_b))
