"""Cylindrical joint: a section turns about an axis and slides along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.joints.axis_joint import AxisJoint, place_alignment, place_product
from ancfdae.joints.frames import across, slope_weights
from ancfdae.joints.joint import Equations, empty_coefficients
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Cylindrical(AxisJoint):
    """Let a section turn about an axis and slide along it, and no more; fields as in `AxisJoint`.

    The axis passes through `ground` or `other`. With e_1, e_2 across it in the reference
    configuration: e_j . (r(point) - r(other)) = 0, and the section keeps across the axis. On
    another beam e_j is the combination of *its* slopes that equals it in the reference
    configuration.
    """

    kind = "cylindrical"

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Equations:
        """Two equations across the axis and two perpendicularities."""
        count, (axis, ground) = len(self.points), self.split(p)
        c = empty_coefficients(4, p, reference)
        for row, direction in enumerate(across(axis)):
            if count == 1:
                c.linear[row, 0] = direction
                c.offset[row] = direction @ (reference[0] if ground is None else ground)
            else:
                alpha = slope_weights(reference[5:8], direction)
                place_product(c, row, slice(0, 2), slice(5, 8), np.outer([1.0, -1.0], alpha))
        place_alignment(c, count, reference, axis)
        return c
