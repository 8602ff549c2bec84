"""Moving base: a section is held, and its place moves by a law of time."""

from dataclasses import dataclass
from typing import final

from ancfdae.model.drawing import Sign
from ancfdae.model.joints.clamp import Clamp
from ancfdae.model.joints.frames import unit
from ancfdae.model.joints.joint import Equations, Travelling, empty_coefficients
from ancfdae.model.parts import Elements, Vectors
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class MovingBase(Travelling):
    """Hold a section as a `Clamp` does, on a base that moves along a direction by a law of time.

    r(point) = r_o(point) + direction x(t). A base that turns is a `Revolute`, in the plane a `Pin`,
    with a `Drive`; one that moves in a plane and turns a `PlanarJoint` with two of `Guide` and a
    `Drive`. Design targets: ``direction_x`` ... and the parameters of the law.

    Parameters
    ----------
    point : Point
    direction : sequence of float
        Not zero.
    travel : Law
    """

    kind = "base"
    sign = Sign("moving base", "p", filled=True)
    holds_position = True

    def vectors(self, elements: Elements) -> Vectors:
        """Return those of a clamp."""
        return Clamp(self.point).vectors(elements)

    def coefficients(self, p: Array, reference: Array) -> Equations:
        """Return those of a clamp."""
        return Clamp(self.point).coefficients(p[:0], reference)

    def moving(self, p: Array, reference: Array) -> tuple[Equations, ...]:
        """Return the direction."""
        still = self.coefficients(p, reference)
        c = empty_coefficients(len(still.offset), p, reference)
        c.offset[: reference.shape[1]] = unit(self.split(p)[0])
        return (c,)
