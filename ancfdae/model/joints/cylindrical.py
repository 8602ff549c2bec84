"""Cylindrical joint: a section turns about an axis and slides along it."""

from dataclasses import dataclass
from typing import final

from ancfdae.model.drawing import Sign
from ancfdae.model.joints.axis_joint import AxisJoint
from ancfdae.model.joints.frames import across, hold_place, square
from ancfdae.model.joints.joint import Equations
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Cylindrical(AxisJoint):
    """Let a section turn about an axis and slide along it, and no more; fields as in `AxisJoint`.

    The axis passes through `ground` or `other`. With e_1, e_2 across it in the reference
    configuration: e_j . (r(point) - r(other)) = 0, and the section keeps across the axis. The
    section of `other` carries e_j along and keeps at right angles to its centre line. The force on
    the point is the sum of -lam_j e_j over the first two, with e_j as `PointOnLine` has n_j.
    """

    kind = "cylindrical"
    sign = Sign("cylindrical joint", "h")

    def coefficients(self, p: Array, reference: Array) -> Equations:
        """Two equations across the axis and two perpendicularities."""
        axis, carrier, ground = self.around(p, reference)
        c = self.aligned(4, p, reference, square(carrier))
        for row, e in enumerate(across(axis)):
            hold_place(c, row, carrier, e, self.level(e, ground, reference))
        return c
