"""Universal joint: two sections meet in a cross of two axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors.checks import require_direction, require_vector
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.drawing import Sign
from ancfdae.model.joints.frames import carrier_of, place_shapes, sections, square, unit
from ancfdae.model.joints.joint import (
    SECTION,
    Joint,
    JointEquations,
    empty_equations,
    place_coincidence,
)
from ancfdae.numerics.arrays import Array

# One minus the cosine of an angle of 1e-6 that is taken for none.
_PARALLEL = 1e-12


@final
@dataclass(frozen=True)
class Universal(Joint):
    """Cardan joint of a spatial beam, to ground or to another beam.

    The points coincide, and two directions, one carried along by each section, keep their angle:
    the axes of the cross, as a rule perpendicular. A section in which its axis does not lie keeps
    at right angles to the centre line. Design targets: ``axis_x`` ..., ``cross_x`` ...

    Parameters
    ----------
    point : MaterialPoint
    axis : sequence of float
        Axis of the cross that the section of the point carries, in the reference; not zero.
    cross : sequence of float
        Axis of the cross that `other` or the ground carries, in the reference; not zero.
    other : MaterialPoint, optional
    ground : sequence of float, optional
        Position on the ground, not with `other`, with design targets ``ground_x`` ...; by default
        where the point is in the reference configuration.
    """

    point: MaterialPoint
    axis: Sequence[float]
    cross: Sequence[float]
    other: MaterialPoint | None = None
    ground: Sequence[float] | None = None

    kind = "universal"
    sign = Sign("universal joint", "P")
    takes_part = SECTION
    design_fields = (
        ("axis", require_direction),
        ("cross", require_direction),
        ("ground", require_vector),
    )
    spatial = True
    way_field = "axis"
    holds_position = True

    def __post_init__(self) -> None:
        """Refuse axes that are parallel: they would hold their angle to first order alone."""
        super().__post_init__()
        axis, cross = (np.asarray(direction, float) for direction in (self.axis, self.cross))
        if len(axis) == len(cross) and abs(unit(axis) @ unit(cross)) > 1 - _PARALLEL:
            raise InvalidInputError(
                f"joint {self.name!r}, cross",
                "must not be parallel to the axis",
                self.cross,
                "Give the direction of the other axis of the cross.",
            )

    @property
    def by_slopes(self) -> bool:
        """To ground the place of the point matters as well."""
        return self.other is not None

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Coincidence, and F axis . F' cross as in the reference."""
        *directions, ground = self.split(p)
        axis, cross = map(unit, directions)
        both = sections(self.points, reference)
        carrier = carrier_of(both[1:])
        shapes = square(both[0], unless_it_holds=axis) + square(carrier, unless_it_holds=cross)
        c = empty_equations(4, p, reference, shapes)
        place_coincidence(c, len(both), reference, ground)
        carrier.meet(c, 3, both[0].carried(axis), cross)
        c.offset[3] = np.sum(axis * cross)
        place_shapes(c, both)
        return c
