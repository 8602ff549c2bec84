"""Revolute joint about any axis: points coincide, sections turn about the axis only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.bodies import Point
from ancfdae.errors import require_direction, require_vector
from ancfdae.joints.frames import unit
from ancfdae.joints.joint import (
    SECTION,
    Coefficients,
    Joint,
    empty_coefficients,
    place_alignment,
    place_coincidence,
)
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Revolute(Joint):
    """Hinge of a spatial beam to ground or to another beam.

    With e_1, e_2 across the axis in the reference configuration, the section's combinations of
    slopes b_j that equal e_j there must stay perpendicular to the axis a: r(point) - r(other) =
    0, b_1 . a = 0, b_2 . a = 0. On another beam a is the combination of *its* slopes that
    equals the axis, and the last two equations are bilinear. In the plane use `Pin`. Design
    targets: ``axis_x``, ``axis_y``, ``axis_z``, and ``ground_x`` ... where `ground` is given.

    Parameters
    ----------
    point : Point
    axis : sequence of float
        Direction of the axis in the reference configuration.
    other : Point, optional
        Point of another beam; without it the joint holds to ground.
    ground : sequence of float, optional
        Place on the ground; by default where the point is in the reference configuration.
    name : str, optional
        By default ``revolute(beam@fraction)``.

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
    kind = "revolute"
    design_fields = (("axis", require_direction), ("ground", require_vector))
    holds_position = True
    spatial = True

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Coefficients:
        """Coincidence and two perpendicularities."""
        count, (axis, ground) = len(self.points), self.split(p)
        c = empty_coefficients(5, len(reference), 3, np.result_type(p, reference))
        place_coincidence(c, count, reference, ground)
        place_alignment(c, count, reference, unit(axis))
        return c
