"""Joints of points and of whole sections: pin, distance, line; clamp, weld, moving support."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors.checks import require_direction, require_positive, require_vector
from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.elements import Quantity
from ancfdae.model.joints.frames import (
    across,
    fix_turn,
    flat_angle,
    hold_turn,
    place_shapes,
    sections,
    unit,
)
from ancfdae.model.joints.joint import (
    SECTION,
    FormulaJoint,
    Joint,
    JointEquations,
    Travelling,
    empty_equations,
    place_coincidence,
)
from ancfdae.model.parts import Elements, Sign, Stroke, Vectors
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Clamp(Joint):
    """Hold a section of a beam to ground where and as it is in the reference configuration.

    The section neither moves nor turns nor shears in its plane. It may still contract, and the
    centre line may leave it obliquely: a beam that is stretched contracts there, and one that is
    sheared shears, as right behind a wall. With n the normal of the section, y and z orthonormal
    in it and b_y, b_z the combinations of slopes that equal them in the reference: r = r_o,
    b_y . n = b_z . n = 0 and b_y . z = b_z . y = 0; in the plane r_y . n = 0. Were only the mean
    turn about n held, the two slopes could turn against each other, and a strip would twist at
    its end through the slope that carries little torsion, the softer the finer the mesh. An
    element without a section holds its tangent instead.

    Parameters
    ----------
    point : MaterialPoint
    ground : sequence of float, optional
        Position on the ground, with design targets ``ground_x`` ...; by default where the point is
        in the reference configuration.
    """

    point: MaterialPoint
    ground: Sequence[float] | None = None

    kind = "clamp"
    sign = Sign("clamp", "s", filled=True)
    design_fields = (("ground", require_vector),)
    holds_position = True
    no_second_point = "It holds to ground; use Weld to hold two sections together."

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors in the equations: the position and slopes that span the section."""
        quantities = elements.at(self.point).quantities
        slopes = quantities[2:] or quantities[1:]
        return tuple((self.point, q) for q in (Quantity.POSITION, *slopes))

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients: position on the ground, and one equation per rotation."""
        d, slopes = reference.shape[1], reference[1:]
        shapes = flat_angle(self.point) if len(slopes) == 2 else ()
        c = empty_equations(d + (3 if shapes else d - 1), p, reference, shapes)
        place_coincidence(c, 1, reference, *self.split(p))
        fix_turn(c, d, slopes, 1)
        return c


@final
@dataclass(frozen=True)
class Weld(Joint):
    """Hold a section to another one, at the angle that they have in the reference configuration.

    The points coincide, and the sections turn as one and keep flat right angles: 3 equations in the
    plane; in space 6, and one for each section that is not rigid and that no other joint holds. As
    behind a `Clamp` a section may contract, and its centre line may leave it obliquely. To ground
    use `Clamp`. The first d multipliers are minus the force on the point. The next are minus the
    moments on its section, to the order of its strain: one in the plane, in space three, about the
    axes that are z, x and y of space in the reference.

    Parameters
    ----------
    point, other : MaterialPoint
        Points of two bodies, at the same position in the reference configuration.
    """

    point: MaterialPoint
    other: MaterialPoint

    kind = "weld"
    sign = Sign("weld", "X", filled=True)
    takes_part = SECTION
    holds_position = True

    @property
    def by_slopes(self) -> bool:
        """Return true: the equations do not depend on positions."""
        return True

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients: coincident points, and one equation per rotation."""
        d, (section, other) = reference.shape[1], sections(self.points, reference)
        rows = 3 if d == 2 else 6
        c = empty_equations(rows, p, reference, section.flat() + other.flat())
        place_coincidence(c, 2, reference, None)
        hold_turn(c, slice(d, rows), section, other)
        place_shapes(c, (section, other))
        return c


@final
@dataclass(frozen=True)
class MovingSupport(Travelling):
    """Hold a section as a `Clamp` does, on a base that moves along a direction by a law of time.

    r(point) = r_o(point) + e x(t), e being the direction at unit length. A base that turns is a
    `Revolute`, in the plane a `Pin`, with a `RotationDriver`; one that moves in a plane and turns a
    `PlanarJoint` with two of `TranslationDriver` and a `RotationDriver`. Design targets:
    ``direction_x`` ... and the parameters of the law.

    Parameters
    ----------
    point : MaterialPoint
    direction : sequence of float
        Direction of the base motion, not zero; its length has no effect (dimensionless).
    travel : Law
        Displacement x(t) of the base; m.
    """

    kind = "base"
    sign = Sign("moving base", "p", filled=True)
    holds_position = True

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors in the equations: position and section slopes, as for a `Clamp`."""
        return Clamp(self.point).vectors(elements)

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the part constant in time: the coefficients of a `Clamp` at the point."""
        return Clamp(self.point).coefficients(p[:0], reference)

    def moving(self, p: Array, reference: Array) -> tuple[JointEquations, ...]:
        """Return the coefficients multiplied by the law: an offset along the direction."""
        still = self.coefficients(p, reference)
        c = empty_equations(len(still.offset), p, reference)
        c.offset[: reference.shape[1]] = unit(self.split(p)[0])
        return (c,)


# -- points ------------------------------------------------------------------------------------


@final
@dataclass(frozen=True)
class Pin(Joint):
    """Hold a point of a beam to ground or to a point of another beam.

    The constraint is r(point) - r(other) = 0, or r(point) - ground = 0. Design targets:
    ``ground_x``, ``ground_y``(, ``ground_z``) to ground.

    Parameters
    ----------
    point : MaterialPoint
    other : MaterialPoint, optional
        Point of another beam; without it the joint holds to ground.
    ground : sequence of float, optional
        Position on the ground; by default where the point is in the reference configuration, also
        where other design variables move it, until a target such as ``ground_x`` writes it.
    """

    point: MaterialPoint
    other: MaterialPoint | None = None
    ground: Sequence[float] | None = None

    kind = "pin"
    sign = Sign("pin", "o")
    design_fields = (("ground", require_vector),)
    holds_position = True

    @property
    def by_slopes(self) -> bool:
        """Whether the equations do not depend on positions: true between two points."""
        return self.other is not None

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients of r(point) - r(other), or of r(point) - ground."""
        n, d = reference.shape
        c = empty_equations(d, p, reference)
        place_coincidence(c, n, reference, *self.split(p))
        return c


#: The spherical joint: another name of `Pin`, which holds a point and leaves all rotations free.
Spherical = Pin


@final
@dataclass(frozen=True)
class Distance(FormulaJoint):
    """Keep two points, or a point and the ground, at a distance.

    (|r(point) - r(other)|^2 / L - L) / 2 = 0; its multiplier is the force in the link, positive in
    tension; N. Design targets: ``length``, and ``ground_x`` ... where `ground` is given.

    Parameters
    ----------
    point : MaterialPoint
    length : float
        Length L of the link; positive.
    other : MaterialPoint, optional
    ground : sequence of float, optional
        Position on the ground; just one of `other` and `ground` must be given.
    """

    point: MaterialPoint
    length: float
    other: MaterialPoint | None = None
    ground: Sequence[float] | None = None

    kind = "link"
    sign = Sign("link", ".", filled=True)
    stroke = Stroke.LINK
    design_fields = (("length", require_positive), ("ground", require_vector))
    needs_other_end = True

    def equations(self, U: Array, p: Array, reference: Array, laws: Array) -> list[Any]:
        """Return (|U_0 - U_1|^2 / L - L) / 2, by differences of places that may be far away.

        Products of the places themselves, which coefficients would take, lose |U|^2 eps.
        """
        L, ground = self.split(p)
        r = U[0] - (U[1] if ground is None else ground)
        return [(r @ r / L - L) / 2]


@final
@dataclass(frozen=True)
class PointOnLine(Joint):
    """Keep a point on a straight line.

    n_j . (r(point) - through) = 0 for the d - 1 directions n_j across the line: in the plane the
    direction turned by +90 degrees, in space n_1 as near as possible to the axis of space that is
    most across, the first of equals, and n_2 = direction x n_1. The force on the point is the sum
    of -lam_j n_j. Design targets: ``direction_x`` ..., and ``through_x`` ... where `through` is
    given.

    Parameters
    ----------
    point : MaterialPoint
    direction : sequence of float
        Direction of the line, not zero; its length has no effect (dimensionless).
    through : sequence of float, optional
        A point of the line; by default where `point` is in the reference configuration.
    """

    point: MaterialPoint
    direction: Sequence[float]
    through: Sequence[float] | None = None

    kind = "line"
    sign = Sign("point on a line", "d")
    way_field = "direction"
    design_fields = (("direction", require_direction), ("through", require_vector))

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients of n_j . (r - through) = 0, one row per direction across."""
        c = empty_equations(reference.shape[1] - 1, p, reference)
        direction, through = self.split(p)
        c.linear[:, 0] = across(direction)
        c.offset[:] = c.linear[:, 0] @ (reference[0] if through is None else through)
        return c
