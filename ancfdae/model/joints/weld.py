"""Weld: two sections are held against each other."""

from dataclasses import dataclass
from typing import final

from ancfdae.model.bodies import Point
from ancfdae.model.drawing import Sign
from ancfdae.model.joints.frames import hold_turn, place_shapes, sections
from ancfdae.model.joints.joint import (
    SECTION,
    Equations,
    Joint,
    empty_coefficients,
    place_coincidence,
)
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Weld(Joint):
    """Hold a section to another one, at the angle that they have in the reference configuration.

    The points coincide, and the sections turn as one and keep flat right angles: 3 equations in the
    plane; in space 6, and one for each section that is not rigid and that no other joint holds. As
    behind a `Clamp` a section may contract, and its centre line may leave it obliquely. To ground
    use `Clamp`. Behind those of the force the multipliers are minus the moments on the section of
    the point, to the order of its strain: in the plane one, in space three, about the axes that
    were z, x and y of space in the reference.

    Parameters
    ----------
    point, other : Point
        At the same place in the reference configuration.
    """

    point: Point
    other: Point

    kind = "weld"
    sign = Sign("weld", "X", filled=True)
    takes_part = SECTION
    holds_position = True

    def coefficients(self, p: Array, reference: Array) -> Equations:
        """Coincidence, and one equation for every turn."""
        d, (section, other) = reference.shape[1], sections(self.points, reference)
        rows = 3 if d == 2 else 6
        c = empty_coefficients(rows, p, reference, section.flat() + other.flat())
        place_coincidence(c, 2, reference, None)
        hold_turn(c, slice(d, rows), section, other)
        place_shapes(c, (section, other))
        return c
