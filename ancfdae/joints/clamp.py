"""Clamp: position and all slopes of a section are held."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity, name_at
from ancfdae.errors import InvalidInput
from ancfdae.joints.joint import Coefficients, Joint, empty_coefficients
from ancfdae.numerics.arrays import Array


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

    holds_position = True

    def __post_init__(self) -> None:
        """Name."""
        if not self.name:
            object.__setattr__(self, "name", name_at("clamp", self.point))

    @property
    def points(self) -> tuple[Point, ...]:
        """The held point."""
        return (self.point,)

    def parameters(self) -> dict[str, float]:
        """None."""
        return {}

    def with_parameter(self, parameter: str, value: float) -> Clamp:
        """Refuse: a clamp has no parameters."""
        raise InvalidInput(
            f"joint {self.name!r}", "has no parameters", parameter, "Choose another."
        )

    def vectors(self, d: int) -> tuple[tuple[Point, Quantity], ...]:
        """Position and slopes of the section."""
        return tuple((self.point, quantity) for quantity in list(Quantity)[: d + 1])

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Coefficients:
        """U_i - U_i(reference)."""
        n, d = reference.shape
        c = empty_coefficients(n * d, n, d, reference.dtype)
        rows, axes = np.arange(n * d), np.arange(n * d) % d
        c.linear[rows, rows // d, axes] = 1.0
        c.offset[:] = reference.ravel()
        return c
