"""Prescribed place of a point along a direction."""

from dataclasses import dataclass
from typing import final

from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.drawing import Sign
from ancfdae.model.elements import Quantity
from ancfdae.model.joints.frames import carrier_of, hold_place, place_shapes, sections, square, unit
from ancfdae.model.joints.joint import SECTION, JointEquations, Travelling, empty_equations
from ancfdae.model.parts import Elements, Vectors
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class TranslationDriver(Travelling):
    """Move a point along a direction by a law of time.

    direction . (r(point) - r(other)) = x(t) more than in the reference configuration, the ground
    having r = 0. The section of `other` carries the direction along; if the direction does not lie
    in it, it keeps at right angles to its centre line. Design targets: ``direction_x`` ... and the
    parameters of the law.

    Parameters
    ----------
    point : MaterialPoint
    direction : sequence of float
        Not zero; its length does not count.
    travel : Law
    other : MaterialPoint, optional
        Point of another beam, whose section carries the direction; without it it is fixed.
    """

    other: MaterialPoint | None = None

    kind = "guide"
    sign = Sign("guide", r"$\leftrightarrow$", filled=True, size=15.0)
    takes_part = SECTION

    def vectors(self, elements: Elements) -> Vectors:
        """Return the position to ground; both positions and the slopes of the other point."""
        if self.other is None:
            return ((self.point, Quantity.POSITION),)
        first, second, *slopes = super().vectors(elements)
        return (first, second, *slopes[elements.d :])

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Direction . (r - r') as in the reference."""
        e = unit(self.split(p)[0])
        others = sections(self.points[1:], reference)
        carrier = carrier_of(others)
        c = empty_equations(1, p, reference, square(carrier, unless_it_holds=e))
        hold_place(c, 0, carrier, e, e @ (reference[0] - reference[1] if others else reference[0]))
        place_shapes(c, others)
        return c

    def moving(self, p: Array, reference: Array) -> tuple[JointEquations, ...]:
        """Return the coefficients that go with the law: an offset along the direction."""
        c = self.coefficients(p, reference)
        travel = empty_equations(len(c.offset), p, reference)
        travel.offset[0] = 1.0
        return (travel,)
