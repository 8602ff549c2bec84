"""What a joint states: vector equations between position and slope vectors of points.

A joint never touches coordinates. It names material points and which vector
of them takes part; the assembler turns every statement into constraint rows,
Jacobians and design derivatives, for all joints of a scene at once.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import final

from ancfdae.bodies import Point, Quantity


@final
@dataclass(frozen=True)
class Term:
    """A vector of a point, times a number.

    Parameters
    ----------
    point : Point
    quantity : Quantity
    coefficient : float
    """

    point: Point
    quantity: Quantity
    coefficient: float = 1.0


@final
@dataclass(frozen=True)
class Equation:
    """The vector equation ``sum of terms - value = 0``, one row per direction of space.

    Parameters
    ----------
    terms : tuple of Term
    value : tuple of float or None
        The right side. None: what the terms give in the reference configuration, so that the
        scene as declared satisfies the equation.
    """

    terms: tuple[Term, ...]
    value: tuple[float, ...] | None


class Joint(abc.ABC):
    """A joint between points of beams or to ground.

    Attributes
    ----------
    name : str
        Unique in a scene; reactions are asked for by it.
    """

    name: str

    @property
    @abc.abstractmethod
    def points(self) -> tuple[Point, ...]:
        """The points that the joint touches, the one that reactions act on first."""

    @abc.abstractmethod
    def equations(self, dimension: int) -> tuple[Equation, ...]:
        """Return the vector equations in space of this dimension, the position one first."""
