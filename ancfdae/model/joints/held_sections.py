"""Sections that are held: to ground, against each other, on a base that moves."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from ancfdae.errors.checks import require_vector
from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.drawing import Sign
from ancfdae.model.elements import Quantity
from ancfdae.model.joints.frames import (
    fix_turn,
    flat_angle,
    hold_turn,
    place_shapes,
    sections,
    unit,
)
from ancfdae.model.joints.joint import (
    SECTION,
    Joint,
    JointEquations,
    Travelling,
    empty_equations,
    place_coincidence,
)
from ancfdae.model.parts import Elements, Vectors
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
        """Return the position and the slopes that span the section."""
        quantities = elements.at(self.point).quantities
        slopes = quantities[2:] or quantities[1:]
        return tuple((self.point, q) for q in (Quantity.POSITION, *slopes))

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Coincidence, and one equation for every turn."""
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
    use `Clamp`. Behind those of the force the multipliers are minus the moments on the section of
    the point, to the order of its strain: in the plane one, in space three, about the axes that
    were z, x and y of space in the reference.

    Parameters
    ----------
    point, other : MaterialPoint
        At the same place in the reference configuration.
    """

    point: MaterialPoint
    other: MaterialPoint

    kind = "weld"
    sign = Sign("weld", "X", filled=True)
    takes_part = SECTION
    holds_position = True

    @property
    def by_slopes(self) -> bool:
        """Return true: places coincide, wherever they are."""
        return True

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Coincidence, and one equation for every turn."""
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
        Not zero; its length does not count.
    travel : Law
    """

    kind = "base"
    sign = Sign("moving base", "p", filled=True)
    holds_position = True

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors of a `Clamp` at the point."""
        return Clamp(self.point).vectors(elements)

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients of a `Clamp` at the point."""
        return Clamp(self.point).coefficients(p[:0], reference)

    def moving(self, p: Array, reference: Array) -> tuple[JointEquations, ...]:
        """Return the coefficients that go with the law: the direction of the travel."""
        still = self.coefficients(p, reference)
        c = empty_equations(len(still.offset), p, reference)
        c.offset[: reference.shape[1]] = unit(self.split(p)[0])
        return (c,)
