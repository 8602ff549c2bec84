"""Clamp: position and orientation of a section are held."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from ancfdae.errors import require_vector
from ancfdae.model.bodies import Point
from ancfdae.model.drawing import Sign
from ancfdae.model.elements import Quantity
from ancfdae.model.joints.frames import fix_turn, flat_angle
from ancfdae.model.joints.joint import (
    Equations,
    Joint,
    empty_coefficients,
    place_coincidence,
)
from ancfdae.model.parts import Elements, Vectors
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Clamp(Joint):
    """Hold a section of a beam to ground where and as it is in the reference configuration.

    The section neither moves nor turns nor shears in its plane. It may still contract, and the
    centre line may leave it obliquely: a beam that is stretched contracts there, and one that is
    sheared shears, as right behind a wall. With n the normal of the section, y and z orthonormal
    in it and b_y, b_z the combinations of slopes that equal them in the reference: r = r_o,
    b_y . n = b_z . n = 0 and b_y . z = b_z . y = 0; in the plane r_y . n = 0. Were only the mean
    turn about n held, the two slopes could turn against each other, and a strip would twist at
    its end through the slope that hardly carries torsion, the softer the finer the mesh. An
    element without a section holds its tangent instead.

    Parameters
    ----------
    point : Point
    ground : sequence of float, optional
        Position on the ground, with design targets ``ground_x`` ...; by default where the point is
        in the reference configuration.
    """

    point: Point
    ground: Sequence[float] | None = None

    kind = "clamp"
    sign = Sign("clamp", "s", filled=True)
    design_fields = (("ground", require_vector),)
    holds_position = True
    no_second_point = "It holds to ground; use Weld to hold two sections together."

    def vectors(self, elements: Elements) -> Vectors:
        """Return the position and the slopes that span the section."""
        quantities = elements.at(self.point).quantities
        slopes = quantities[2:] or quantities[1:]
        return tuple((self.point, q) for q in (Quantity.POSITION, *slopes))

    def coefficients(self, p: Array, reference: Array) -> Equations:
        """Coincidence, and one equation for every turn."""
        d, slopes = reference.shape[1], reference[1:]
        shapes = flat_angle(self.point) if len(slopes) == 2 else ()
        c = empty_coefficients(d + (3 if shapes else d - 1), p, reference, shapes)
        place_coincidence(c, 1, reference, *self.split(p))
        fix_turn(c, d, slopes, 1)
        return c
