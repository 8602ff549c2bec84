"""Joints about an axis or along one: revolute, cylindrical, planar, prismatic, universal."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np

from ancfdae.errors.checks import require_direction, require_vector
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.joints.frames import (
    Carrier,
    SectionFrame,
    across,
    carrier_of,
    fix_turn,
    hold_axis,
    hold_place,
    hold_turn,
    is_fixed_in,
    place_shapes,
    sections,
    square,
    unit,
)
from ancfdae.model.joints.joint import (
    SECTION,
    Joint,
    JointEquations,
    RightAngle,
    empty_equations,
    place_coincidence,
)
from ancfdae.model.parts import Sign
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.vector_formulas import cross

#: Unit axis, the section of `other` or ground that carries it, and the position on the ground.
Around: TypeAlias = tuple[Array, Carrier, Array | None]


@dataclass(frozen=True)
class AxisJoint(Joint):
    """Base class of joints that align a section of a spatial beam with an axis.

    The axis, carried along by the section of the point, keeps the direction that the ground or the
    section of `other` gives it. The centre line may shear against the section; within the section
    no shear is left. If the axis lies neither in the section of the point nor in the section of
    `other`, the section of `other` also stays perpendicular to the centre line. Design targets:
    ``axis_x``, ``axis_y``, ``axis_z``, and ``ground_x`` ... to ground.

    Parameters
    ----------
    point : MaterialPoint
    axis : sequence of float
        Direction of the axis in the reference configuration; not zero.
    other : MaterialPoint, optional
        Point of another beam, whose section carries the axis along; without it the axis is fixed
        to ground.
    ground : sequence of float, optional
        Position on the ground, not with `other`; by default where the point is in the reference
        configuration, see `Pin`.
    """

    point: MaterialPoint
    axis: Sequence[float]
    other: MaterialPoint | None = None
    ground: Sequence[float] | None = None

    takes_part = SECTION
    design_fields = (("axis", require_direction), ("ground", require_vector))
    spatial = True
    way_field = "axis"

    @property
    def by_slopes(self) -> bool:
        """Whether the equations do not depend on positions: true between two points."""
        return self.other is not None

    def around(self, p: Array, reference: Array) -> Around:
        """Return the unit axis, its carrier, and the position on the ground or None."""
        axis, ground = self.split(p)
        _, *other = sections(self.points, reference)
        return unit(axis), carrier_of(other), ground

    def level(self, e: Array, ground: Array | None, reference: Array) -> Array | float:
        """Return the offset in e . (r - r') = offset: zero if there is `other`, else e . ground."""
        place = reference[0] if ground is None else ground
        return 0.0 if self.other is not None else np.sum(e * place)

    def aligned(
        self, rows: int, p: Array, reference: Array, shapes: Sequence[RightAngle] = ()
    ) -> JointEquations:
        """Return empty equations in which the last two before the shapes align the axis.

        The right angles of sections that the joint keeps, and `shapes`, are added as last
        equations.
        """
        axis, carrier, _ = self.around(p, reference)
        both = sections(self.points, reference)
        section = both[0]
        if isinstance(carrier, SectionFrame) and section.holds(axis) and not carrier.holds(axis):
            section, carrier = carrier, section
        every = tuple(
            dict.fromkeys((*section.flat(), *square(carrier, unless_it_holds=axis), *shapes))
        )
        c = empty_equations(rows, p, reference, every)
        hold_axis(c, slice(rows - 2, rows), section, carrier, axis)
        if is_fixed_in(section, carrier, axis):
            # F axis is fixed: the direction perpendicular to it in the section stays across the
            # axis.
            carrier.meet(c, rows, section.carried(unit(cross(section.normal, axis))), axis)
        else:
            place_shapes(c, both)
        return c


@final
@dataclass(frozen=True)
class Revolute(AxisJoint):
    """Hinge of a spatial beam to ground or to another beam; fields as in `AxisJoint`.

    The points coincide, r(point) - r(other) = 0 or r(point) - ground = 0, and the section keeps
    across the axis. In the plane use `Pin`.
    """

    kind = "revolute"
    sign = Sign("revolute joint", "o")
    holds_position = True

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients: coincident points, and two directions across the axis."""
        c = self.aligned(5, p, reference)
        place_coincidence(c, len(self.points), reference, self.around(p, reference)[2])
        return c


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

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients: two equations across the axis, and two that align it."""
        axis, carrier, ground = self.around(p, reference)
        c = self.aligned(4, p, reference, square(carrier))
        for row, e in enumerate(across(axis)):
            hold_place(c, row, carrier, e, self.level(e, ground, reference))
        return c


@final
@dataclass(frozen=True)
class PlanarJoint(AxisJoint):
    """Let a section slide in a plane and turn about its normal, the axis; fields as in `AxisJoint`.

    The plane passes through `ground` or `other`: axis . (r(point) - r(other)) = 0, and the section
    keeps across the axis. The first multiplier is minus the force on the point along the axis.
    """

    kind = "planar"
    sign = Sign("planar joint", "D")

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients: one equation along the normal, and two that align it."""
        axis, carrier, ground = self.around(p, reference)
        c = self.aligned(3, p, reference, square(carrier, unless_it_holds=axis))
        hold_place(c, 0, carrier, axis, self.level(axis, ground, reference))
        return c


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
        """Return the coefficients: d - 1 equations across the axis, and one per rotation."""
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


# 1 - cos of the angle, about 1e-6 rad, below which two axes count as parallel.
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
        """Raise InvalidInputError if the axes are parallel, or the fields of a joint are wrong.

        Parallel axes would keep their angle to first order only.
        """
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
        """Whether the equations do not depend on positions: true between two points."""
        return self.other is not None

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients: coincident points, and F axis . F' cross as in the reference."""
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
