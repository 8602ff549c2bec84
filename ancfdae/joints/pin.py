"""Pin in the plane, spherical joint in space: two points coincide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from ancfdae.bodies import Point, Quantity
from ancfdae.errors import InvalidInput, require_vector
from ancfdae.joints.contract import Equation, Joint, Term


@final
@dataclass(frozen=True)
class Pin(Joint):
    """Hold a point of a beam to ground or to a point of another beam.

    The constraint is r(point) - r(other) = 0, or r(point) - ground = 0.

    Parameters
    ----------
    point : Point
    other : Point, optional
        Point of another beam; without it the joint holds to ground.
    ground : sequence of float, optional
        Place on the ground; by default where the point is in the reference configuration.
    name : str, optional
        By default ``pin(beam@fraction)``.

    Raises
    ------
    InvalidInput
        If both `other` and `ground` are given.
    """

    point: Point
    other: Point | None = None
    ground: Sequence[float] | None = None
    name: str = ""

    def __post_init__(self) -> None:
        """Validate and name."""
        if not self.name:
            object.__setattr__(self, "name", f"pin({self.point.beam}@{self.point.fraction:g})")
        if self.other is not None and self.ground is not None:
            raise InvalidInput(
                f"joint {self.name!r}",
                "joins either two points or a point and the ground",
                "both",
                "Leave out `other` or `ground`.",
            )
        if self.ground is not None:
            require_vector(f"joint {self.name!r}, ground", self.ground)

    @property
    def points(self) -> tuple[Point, ...]:
        """The joined points."""
        return (self.point,) if self.other is None else (self.point, self.other)

    def equations(self, dimension: int) -> tuple[Equation, ...]:
        """Return the one vector equation."""
        here = Term(self.point, Quantity.POSITION)
        if self.other is not None:
            there = Term(self.other, Quantity.POSITION, -1.0)
            return (Equation((here, there), (0.0,) * dimension),)
        return (Equation((here,), None if self.ground is None else tuple(self.ground)),)


#: In space the pin is the spherical joint.
Spherical = Pin
