"""Cylindrical joint: a section turns about an axis and slides along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.bodies import Point
from ancfdae.errors import require_direction, require_vector
from ancfdae.joints.frames import across, slope_weights, unit
from ancfdae.joints.joint import (
    SECTION,
    Coefficients,
    Joint,
    empty_coefficients,
    place_alignment,
    place_product,
)
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Cylindrical(Joint):
    """Let a section of a spatial beam turn about an axis and slide along it, and no more.

    The axis passes through a place on the ground, or through a point of another beam, whose
    section then carries it along. With e_1, e_2 across the axis in the reference configuration:
    e_j . (r(point) - r(other)) = 0, and the two perpendicularities of `Revolute`. On another
    beam e_j is the combination of *its* slopes that equals it in the reference configuration.
    Design targets: ``axis_x``, ``axis_y``, ``axis_z``, and ``ground_x`` ... where `ground` is
    given.

    Parameters
    ----------
    point : Point
    axis : sequence of float
        Direction of the axis in the reference configuration.
    other : Point, optional
        Point of another beam, on the axis; without it the axis is fixed to ground.
    ground : sequence of float, optional
        Place on the axis; by default where the point is in the reference configuration.
    name : str, optional
        By default ``cylindrical(beam@fraction)``.

    Raises
    ------
    InvalidInput
        If the axis is zero, or both `other` and `ground` are given.
    """

    point: Point
    axis: Sequence[float]
    other: Point | None = None
    ground: Sequence[float] | None = None
    name: str = ""

    takes_part = SECTION
    kind = "cylindrical"
    design_fields = (("axis", require_direction), ("ground", require_vector))
    spatial = True

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Coefficients:
        """Two equations across the axis and two perpendicularities."""
        count, (axis, ground) = len(self.points), self.split(p)
        c = empty_coefficients(4, len(reference), 3, np.result_type(p, reference))
        for row, direction in enumerate(across(axis)):
            if count == 1:
                c.linear[row, 0] = direction
                c.offset[row] = direction @ (reference[0] if ground is None else ground)
            else:
                alpha = slope_weights(reference[5:8], direction)
                place_product(c, row, slice(0, 2), slice(5, 8), np.outer([1.0, -1.0], alpha))
        place_alignment(c, count, reference, unit(axis))
        return c
