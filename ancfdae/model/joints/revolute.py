"""Revolute joint about any axis: points coincide, sections turn about the axis only."""

from dataclasses import dataclass
from typing import final

from ancfdae.model.drawing import Sign
from ancfdae.model.joints.axis_joint import AxisJoint
from ancfdae.model.joints.joint import Equations, place_coincidence
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Revolute(AxisJoint):
    """Hinge of a spatial beam to ground or to another beam; fields as in `AxisJoint`.

    The points coincide, r(point) - r(other) = 0 or r(point) - ground = 0, and the section keeps
    across the axis. In the plane use `Pin`.
    """

    kind = "revolute"
    sign = Sign("revolute joint", "o")
    holds_position = True

    def coefficients(self, p: Array, reference: Array) -> Equations:
        """Coincidence and two perpendicularities."""
        c = self.aligned(5, p, reference)
        place_coincidence(c, len(self.points), reference, self.around(p, reference)[2])
        return c
