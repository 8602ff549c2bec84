"""Prismatic joint: a section slides along an axis and does not turn."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from ancfdae.errors.checks import require_direction
from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.drawing import Sign
from ancfdae.model.joints.frames import (
    across,
    carrier_of,
    fix_turn,
    hold_place,
    hold_turn,
    place_shapes,
    sections,
    square,
)
from ancfdae.model.joints.joint import SECTION, Joint, JointEquations, empty_equations
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Prismatic(Joint):
    """Let a section slide along an axis, without turning; to ground or to another beam.

    e_j . (r(point) - r(other)) stays as in the reference configuration for the d - 1 directions
    e_j across the axis, and the section turns with that of `other` or not at all. The section of
    `other` carries e_j along and keeps at right angles to its centre line. The force on the point
    is the sum of -lam_j e_j over the first equations, with e_j as `PointOnLine` has n_j. Design
    targets: ``axis_x`` ...

    Parameters
    ----------
    point : MaterialPoint
    axis : sequence of float
        Direction in the reference configuration; not zero.
    other : MaterialPoint, optional
        Point of another beam, whose section carries the axis along; without it the axis is fixed
        to ground.
    """

    point: MaterialPoint
    axis: Sequence[float]
    other: MaterialPoint | None = None

    kind = "prismatic"
    sign = Sign("prismatic joint", "d")
    takes_part = SECTION
    way_field = "axis"
    design_fields = (("axis", require_direction),)

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Equations across the axis, and one for every turn."""
        (axis,), d = self.split(p), reference.shape[1]
        section, *others = sections(self.points, reference)
        carrier, places = carrier_of(others), reference[: len(self.points)]
        apart = places[0] - places[1] if others else places[0]
        rows = 2 if d == 2 else 5
        c = empty_equations(rows, p, reference, section.flat() + square(carrier))
        for row, e in enumerate(across(axis)):
            hold_place(c, row, carrier, e, e @ apart)
        if others:
            hold_turn(c, slice(d - 1, rows), section, others[0])
            place_shapes(c, (section, others[0]))
        else:
            fix_turn(c, d - 1, reference[2:], 2)
        return c
