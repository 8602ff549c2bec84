"""Clamp: position and all slopes of a section are held."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from ancfdae.bodies import Point, Quantity
from ancfdae.joints.contract import Equation, Joint, Term


@final
@dataclass(frozen=True)
class Clamp(Joint):
    """Hold a section of a beam to ground as it is in the reference configuration.

    The constraints are r = r_o and r_k = r_ok for every slope vector: the section neither
    moves, nor turns, nor deforms.

    Parameters
    ----------
    point : Point
    name : str, optional
        By default ``clamp(beam@fraction)``.
    """

    point: Point
    name: str = ""

    def __post_init__(self) -> None:
        """Name."""
        if not self.name:
            object.__setattr__(self, "name", f"clamp({self.point.beam}@{self.point.fraction:g})")

    @property
    def points(self) -> tuple[Point, ...]:
        """The held point."""
        return (self.point,)

    def equations(self, dimension: int) -> tuple[Equation, ...]:
        """Return one equation per vector of the section."""
        quantities = list(Quantity)[: dimension + 1]
        return tuple(Equation((Term(self.point, quantity),), None) for quantity in quantities)
