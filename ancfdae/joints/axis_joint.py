"""Joints about an axis: the section of a point keeps across it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ancfdae.bodies import Point
from ancfdae.errors import require_direction, require_vector
from ancfdae.joints.frames import across, slope_weights, unit
from ancfdae.joints.joint import SECTION, Equations, Joint
from ancfdae.numerics.arrays import Array


@dataclass(frozen=True)
class AxisJoint(Joint):
    """A joint of a section of a spatial beam about an axis.

    With e_1, e_2 across the axis in the reference configuration, the section's combinations of
    slopes b_j that equal e_j there stay perpendicular to the axis a: b_1 . a = 0, b_2 . a = 0. On
    another beam a is the combination of *its* slopes that equals the axis, and these equations
    are bilinear. Design targets: ``axis_x``, ``axis_y``, ``axis_z``, and ``ground_x`` ... where
    `ground` is given.

    Parameters
    ----------
    point : Point
    axis : sequence of float
        Direction of the axis in the reference configuration; not zero.
    other : Point, optional
        Point of another beam, whose section carries the axis along; without it the axis is fixed
        to ground.
    ground : sequence of float, optional
        Place on the ground, not with `other`; by default where the point is in the reference
        configuration.
    name : str, optional
        By default ``kind(beam@fraction)``.
    """

    point: Point
    axis: Sequence[float]
    other: Point | None = None
    ground: Sequence[float] | None = None
    name: str = ""

    takes_part = SECTION
    design_fields = (("axis", require_direction), ("ground", require_vector))
    spatial = True


def place_alignment(c: Equations, count: int, reference: Array, axis: Array) -> None:
    """Enter the last two equations, b_j . a = 0."""
    own, other, axis = slice(count, count + 3), slice(count + 3, count + 6), unit(axis)
    for row, direction in zip((-2, -1), across(axis), strict=True):
        beta = slope_weights(reference[own], direction)
        if count == 1:
            c.linear[row, own] = beta[:, None] * axis
        else:
            place_product(c, row, own, other, np.outer(beta, slope_weights(reference[other], axis)))


def place_product(c: Equations, row: int, i: slice, j: slice, weights: Array) -> None:
    """Enter sum_ij weights_ij U_i . U_j, i and j different vectors, into an equation."""
    c.bilinear[row, i, j] = weights
    c.bilinear[row, j, i] = weights.T
