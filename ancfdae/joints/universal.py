"""Universal joint: two sections meet in a cross of two axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.bodies import Point
from ancfdae.errors import require_direction
from ancfdae.joints.frames import carrier_of, place_shapes, sections, square, unit
from ancfdae.joints.joint import (
    SECTION,
    Equations,
    Joint,
    empty_coefficients,
    place_coincidence,
)
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Universal(Joint):
    """Cardan joint of a spatial beam, to ground or to another beam.

    The points coincide, and two directions, one carried along by each section, keep their angle:
    the axes of the cross, as a rule perpendicular. A section in which its axis does not lie keeps
    at right angles to the centre line. Design targets: ``axis_x`` ..., ``cross_x`` ...

    Parameters
    ----------
    point : Point
    axis : sequence of float
        Axis of the cross that the section of the point carries, in the reference; not zero.
    cross : sequence of float
        Axis of the cross that `other` or the ground carries, in the reference; not zero.
    other : Point, optional
    name : str, optional
        By default ``universal(beam@fraction)``.
    """

    point: Point
    axis: Sequence[float]
    cross: Sequence[float]
    other: Point | None = None
    name: str = ""

    kind = "universal"
    takes_part = SECTION
    design_fields = (("axis", require_direction), ("cross", require_direction))
    spatial = True
    holds_position = True

    def coefficients(self, p: Array, reference: Array) -> Equations:
        """Coincidence, and F axis . F' cross as in the reference."""
        axis, cross = (unit(direction) for direction in self.split(p))
        both = sections(self.points, reference)
        carrier = carrier_of(both[1:])
        shapes = square(both[0], unless_it_holds=axis) + square(carrier, unless_it_holds=cross)
        c = empty_coefficients(4, p, reference, shapes)
        place_coincidence(c, len(both), reference, None)
        carrier.meet(c, 3, both[0].carried(axis), cross)
        c.offset[3] = np.sum(axis * cross)
        place_shapes(c, both)
        return c
