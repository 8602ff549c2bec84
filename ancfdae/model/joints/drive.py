"""Driven joints: the rotation of a section, the displacement of a point along a direction."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors.checks import require_direction
from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.elements import Quantity
from ancfdae.model.joints.frames import (
    OUT_OF_PLANE,
    across,
    axis_torque,
    carrier_of,
    flat_angle,
    hold_place,
    place_shapes,
    sections,
    spanned,
    square,
    unit,
)
from ancfdae.model.joints.joint import (
    SECTION,
    DrivenJoint,
    JointEquations,
    Travelling,
    empty_equations,
)
from ancfdae.model.laws.law import Law, require_law
from ancfdae.model.parts import Elements, Sign, Vectors
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class RotationDriver(DrivenJoint):
    """Prescribe the angle of a section by a law of time: a driven crank, a motor in an elbow.

    The angle, in rad, counts from the reference configuration, about an axis fixed in space, or
    relative to the section of `other`, which carries the axis along. Sections are rotated, not
    centre lines: a beam that shears transmits a moment through its sections. For an element without
    a section the tangent is rotated. In space another joint, such as `Revolute`, must fix the axis.
    Design targets: the parameters of the law, and ``axis_x`` ... where the axis is given.

    Parameters
    ----------
    point : MaterialPoint
    angle : Law
    axis : sequence of float, optional
        Axis of the turning in space, not zero; z by default. Not in the plane.
    other : MaterialPoint, optional
        Point of another beam, whose section the angle counts from; without it from ground.
    """

    point: MaterialPoint
    angle: Law
    axis: Sequence[float] | None = None
    other: MaterialPoint | None = None

    kind = "drive"
    sign = Sign("drive", r"$\circlearrowleft$", filled=True, size=17.0)
    shows_ground = False
    takes_part = SECTION
    design_fields = (("angle", require_law), ("axis", require_direction))

    def vectors(self, elements: Elements) -> Vectors:
        """Return the slopes that take part: those spanning the section; all slopes with `other`."""
        if self.other is not None:
            return super().vectors(elements)[2:]
        return tuple((self.point, q) for q in elements.at(self.point).spanning)

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients that do not depend on the angle: axis, shear, right angles."""
        a, d = self._axis(p), reference.shape[1]
        if self.other is None:
            return self._against_ground(p, reference, lambda m: (a @ m) * a, still=True)
        section, other = sections(self.points, reference)
        shapes = () if d == 2 else axis_torque(section, a) + axis_torque(other, a)
        c = empty_equations(1, p, reference, shapes)
        section.take_out_shear(c, 0, a, 1.0)
        other.take_out_shear(c, 0, a, -1.0)
        place_shapes(c, (section, other))
        return c

    def moving(self, p: Array, reference: Array) -> tuple[JointEquations, ...]:
        """Return the coefficients multiplied by the cosine and by the sine of the angle."""
        a = self._axis(p)
        if self.other is None:
            cosine = self._against_ground(p, reference, lambda m: m - (a @ m) * a)
            return cosine, self._against_ground(p, reference, lambda m: np.cross(a, m))
        e_1, e_2 = np.eye(2) if reference.shape[1] == 2 else across(a)
        cosine = self._against_section(p, reference, ((e_1, e_2), (e_2, -e_1)))
        return cosine, self._against_section(p, reference, ((e_1, -e_1), (e_2, -e_2)))

    def faces(self, p: Array, reference: Array, U: Array, t: float) -> bool:
        """Whether the section is at the prescribed angle, not half a turn away from it.

        There the derivative of the equation in the angle has the sign that it has in the reference.
        """
        cosine, sine = self.moving(p, reference)
        on_cosine, on_sine = self.by_turn(p, np.array([t]))[:, 0]
        rate = on_cosine * cosine.at(U)[0] + on_sine * sine.at(U)[0]
        return bool(rate * sine.at(reference)[0] > 0)

    def by_turn(self, p: Array, t: Array) -> Array:
        """Return the derivatives of cosine and sine in the angle, -sin and cos, shape (2, k)."""
        cosine, sine = self.factors(p, t, 0)
        return np.array([-sine, cosine])

    def turn_rate(self, p: Array, t: Array) -> Array:
        """Return the rate of the prescribed angle at times t, shape (k,); rad/s."""
        return self.angle.derivative(self.split(p)[0], t, 1)

    def factors(self, p: Array, t: Array, order: int) -> Array:
        """Return cosine and sine of the angle, or a time derivative of them, shape (2, k)."""
        law = self.split(p)[0]
        return cosine_and_sine([self.angle.derivative(law, t, k) for k in range(order + 1)])

    def _against_ground(
        self,
        p: Array,
        slopes: Array,
        part: Callable[[Array], Array],
        still: bool = False,
    ) -> JointEquations:
        """Return the part of sum_w F w . R m_w over the section axes w that `part` selects of m_w.

        R rotates by the prescribed angle. m_w = (a - 1/2 (a . n) n) x w: in the reference a
        rotation phi of the section changes the sum by a . phi (docs/theory/03-joints-and-loads.md).
        """
        d, a = slopes.shape[1], self._axis(p)
        n, axes, weights = spanned(slopes)
        twisting = d == 3 and abs((a @ n).real) > OUT_OF_PLANE
        c = empty_equations(1, p, slopes, flat_angle(self.point) if twisting else ())
        for w, share in zip(axes, weights, strict=True):
            m = np.cross(a - (a @ n) / 2 * n, w)
            c.linear[0] += np.outer(share, part(m)[:d])
        if twisting and still:
            product = np.outer(*weights)
            c.bilinear[1] = product + product.T
        return c

    def _against_section(
        self, p: Array, reference: Array, pairs: Sequence[tuple[Array, Array]]
    ) -> JointEquations:
        """Return the part of 1/2 (F e_1 . F' R e_2 - F e_2 . F' R e_1) in the given `pairs`.

        R rotates by the prescribed angle; F and F' carry directions along with the two sections.
        """
        section, other = sections(self.points, reference)
        c = empty_equations(len(self.coefficients(p, reference).offset), p, reference)
        for e, e_other in pairs:
            other.meet(c, 0, section.carried(e), e_other, 0.5)
        return c

    def _axis(self, p: Array) -> Array:
        axis = self.split(p)[1]
        return np.array([0.0, 0.0, 1.0]) if axis is None else unit(axis)


def cosine_and_sine(theta: Sequence[Array]) -> Array:
    """Return (cos, sin) of an angle, or their time derivative, shape (2, ...).

    `theta` holds the angle and its time derivatives up to the order of the result.
    """
    angle, order = theta[0], len(theta) - 1
    e, e_n = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    if order == 0:
        return e
    # e' = w e_n, e_n' = -w e.
    w, last = theta[1], theta[order]
    by_e = (0 * w, -(w**2), -3 * w * theta[min(order, 2)])[order - 1]
    by_e_n = last - w**3 if order == 3 else last
    return by_e_n * e_n + by_e * e


@final
@dataclass(frozen=True)
class TranslationDriver(Travelling):
    """Prescribe the displacement of a point along a direction by a law of time.

    direction . (r(point) - r(other)) exceeds its value in the reference configuration by x(t), with
    r(other) = 0 for the ground. The section of `other` carries the direction along; if the
    direction does not lie in the section, the section stays perpendicular to its centre line.
    Design targets: ``direction_x`` ... and the parameters of the law.

    Parameters
    ----------
    point : MaterialPoint
    direction : sequence of float
        Direction, not zero; its length has no effect (dimensionless).
    travel : Law
        Displacement x(t); m.
    other : MaterialPoint, optional
        Point of another beam, whose section carries the direction; by default it is fixed in space.
    """

    other: MaterialPoint | None = None

    kind = "guide"
    sign = Sign("guide", r"$\leftrightarrow$", filled=True, size=15.0)
    takes_part = SECTION

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors that take part: positions, and the slopes of the other point."""
        if self.other is None:
            return ((self.point, Quantity.POSITION),)
        first, second, *slopes = super().vectors(elements)
        return (first, second, *slopes[elements.d :])

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients of direction . (r - r') as in the reference configuration."""
        e = unit(self.split(p)[0])
        others = sections(self.points[1:], reference)
        carrier = carrier_of(others)
        c = empty_equations(1, p, reference, square(carrier, unless_it_holds=e))
        hold_place(c, 0, carrier, e, e @ (reference[0] - reference[1] if others else reference[0]))
        place_shapes(c, others)
        return c

    def moving(self, p: Array, reference: Array) -> tuple[JointEquations, ...]:
        """Return the coefficients multiplied by the law: an offset of one along the direction."""
        c = self.coefficients(p, reference)
        travel = empty_equations(len(c.offset), p, reference)
        travel.offset[0] = 1.0
        return (travel,)
