"""Joints about an axis: the section of a point keeps across it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ancfdae.errors import require_direction, require_vector
from ancfdae.model.bodies import Point
from ancfdae.model.joints.frames import (
    Carrier,
    SectionFrame,
    axis_shapes,
    carrier_of,
    hold_axis,
    is_fixed_in,
    place_shapes,
    sections,
    unit,
)
from ancfdae.model.joints.joint import SECTION, Equations, Joint, RightAngle, empty_coefficients
from ancfdae.numerics.arrays import Array

#: The axis, what carries it at `other`, and the place on the ground.
Around: TypeAlias = tuple[Array, Carrier, Array | None]


@dataclass(frozen=True)
class AxisJoint(Joint):
    """A joint of a section of a spatial beam about an axis.

    The axis, as the section carries it along, stays where the ground or the section of `other` has
    it. What a section holds of it is a matter of the section, not of the centre line, which may
    shear against it; in the section no shear is left. Where the axis lies neither in the section of
    the point nor in that of `other`, the section of `other` keeps at right angles to the centre
    line, too. Design targets: ``axis_x``, ``axis_y``, ``axis_z``, and ``ground_x`` ... to ground.

    Parameters
    ----------
    point : Point
    axis : sequence of float
        Direction of the axis in the reference configuration; not zero.
    other : Point, optional
        Point of another beam, whose section carries the axis along; without it the axis is fixed
        to ground.
    ground : sequence of float, optional
        Position on the ground, not with `other`; by default where the point is in the reference
        configuration, see `Pin`.
    """

    point: Point
    axis: Sequence[float]
    other: Point | None = None
    ground: Sequence[float] | None = None

    takes_part = SECTION
    design_fields = (("axis", require_direction), ("ground", require_vector))
    spatial = True
    way_field = "axis"

    def around(self, p: Array, reference: Array) -> Around:
        """Return the axis and what carries it."""
        axis, ground = self.split(p)
        _, *other = sections(self.points, reference)
        return unit(axis), carrier_of(other), ground

    def level(self, e: Array, ground: Array | None, reference: Array) -> Array | float:
        """Return what e . (r - r') is: zero at another point, the place of the ground."""
        place = reference[0] if ground is None else ground
        return 0.0 if self.other is not None else np.sum(e * place)

    def aligned(
        self, rows: int, p: Array, reference: Array, shapes: Sequence[RightAngle] = ()
    ) -> Equations:
        """Return coefficients with the last two of these equations entered, and all shapes."""
        axis, carrier, _ = self.around(p, reference)
        both = sections(self.points, reference)
        section = both[0]
        if isinstance(carrier, SectionFrame) and section.holds(axis) and not carrier.holds(axis):
            section, carrier = carrier, section
        every = tuple(dict.fromkeys((*axis_shapes(section, carrier, axis), *shapes)))
        c = empty_coefficients(rows, p, reference, every)
        hold_axis(c, slice(rows - 2, rows), section, carrier, axis)
        if is_fixed_in(section, carrier, axis):
            # F axis is fixed: what is square to it in the section is across the axis.
            carrier.meet(c, rows, section.carried(unit(np.cross(section.normal, axis))), axis)
        else:
            place_shapes(c, both)
        return c
