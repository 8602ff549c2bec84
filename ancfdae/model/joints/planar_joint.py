"""Planar joint: a section slides in a plane and turns about its normal."""

from dataclasses import dataclass
from typing import final

from ancfdae.model.drawing import Sign
from ancfdae.model.joints.axis_joint import AxisJoint
from ancfdae.model.joints.frames import hold_place, square
from ancfdae.model.joints.joint import Equations
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class PlanarJoint(AxisJoint):
    """Let a section slide in a plane and turn about its normal, the axis; fields as in `AxisJoint`.

    The plane passes through `ground` or `other`: axis . (r(point) - r(other)) = 0, and the section
    keeps across the axis. The first multiplier is minus the force on the point along the axis.
    """

    kind = "planar"
    sign = Sign("planar joint", "D")

    def coefficients(self, p: Array, reference: Array) -> Equations:
        """One equation along the normal of the plane and two perpendicularities."""
        axis, carrier, ground = self.around(p, reference)
        c = self.aligned(3, p, reference, square(carrier, unless_it_holds=axis))
        hold_place(c, 0, carrier, axis, self.level(axis, ground, reference))
        return c
