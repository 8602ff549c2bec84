"""Pin in the plane, spherical joint in space: two points coincide."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from ancfdae.errors import require_vector
from ancfdae.model.bodies import Point
from ancfdae.model.drawing import Sign
from ancfdae.model.joints.joint import Equations, Joint, empty_coefficients, place_coincidence
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Pin(Joint):
    """Hold a point of a beam to ground or to a point of another beam.

    The constraint is r(point) - r(other) = 0, or r(point) - ground = 0. Design targets:
    ``ground_x``, ``ground_y``(, ``ground_z``) to ground.

    Parameters
    ----------
    point : Point
    other : Point, optional
        Point of another beam; without it the joint holds to ground.
    ground : sequence of float, optional
        Position on the ground; by default where the point is in the reference configuration, also
        where other design variables move it, until a target such as ``ground_x`` writes it.
    """

    point: Point
    other: Point | None = None
    ground: Sequence[float] | None = None

    kind = "pin"
    sign = Sign("pin", "o")
    design_fields = (("ground", require_vector),)
    holds_position = True

    def coefficients(self, p: Array, reference: Array) -> Equations:
        """r(point) - r(other), or r(point) - ground."""
        n, d = reference.shape
        c = empty_coefficients(d, p, reference)
        place_coincidence(c, n, reference, *self.split(p))
        return c


#: In space the pin is the spherical joint.
Spherical = Pin
