"""Point on a line fixed to ground: a massless slider."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity, name_at
from ancfdae.design import replaced_component, vector_parameters
from ancfdae.errors import InvalidInput, require_vector
from ancfdae.joints.frames import across
from ancfdae.joints.joint import Coefficients, Joint, empty_coefficients
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class PointOnLine(Joint):
    """Keep a point on a straight line.

    n_j . (r(point) - through) = 0 for the d - 1 directions n_j across the line. Design targets:
    ``direction_x`` ..., and ``through_x`` ... where `through` is given.

    Parameters
    ----------
    point : Point
    direction : sequence of float
    through : sequence of float, optional
        A point of the line; by default where `point` is in the reference configuration.
    name : str, optional
        By default ``line(beam@fraction)``.

    Raises
    ------
    InvalidInput
        If the direction is zero.
    """

    point: Point
    direction: Sequence[float]
    through: Sequence[float] | None = None
    name: str = ""

    def __post_init__(self) -> None:
        """Validate and name."""
        if not self.name:
            object.__setattr__(self, "name", name_at("line", self.point))
        require_vector(f"joint {self.name!r}, direction", self.direction)
        if not any(self.direction):
            raise InvalidInput(
                f"joint {self.name!r}, direction",
                "must not be zero",
                tuple(self.direction),
                "Give the direction of the line.",
            )
        if self.through is not None:
            size = len(tuple(self.direction))
            require_vector(f"joint {self.name!r}, through", self.through, (size,))

    @property
    def points(self) -> tuple[Point, ...]:
        """The sliding point."""
        return (self.point,)

    def parameters(self) -> dict[str, float]:
        """Components of `direction` and `through`."""
        line = vector_parameters("direction", self.direction)
        return line | vector_parameters("through", self.through)

    def with_parameter(self, parameter: str, value: float) -> PointOnLine:
        """Turn or move the line."""
        if parameter.startswith("direction"):
            direction = replaced_component("direction", self.direction, parameter, value)
            return replace(self, direction=direction)
        assert self.through is not None
        return replace(self, through=replaced_component("through", self.through, parameter, value))

    def vectors(self, d: int) -> tuple[tuple[Point, Quantity], ...]:
        """Position of the point."""
        return ((self.point, Quantity.POSITION),)

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Coefficients:
        """n_j . (r - through)."""
        n, d = reference.shape
        c = empty_coefficients(d - 1, n, d, np.result_type(p, reference))
        normals = across(p[:d])
        c.linear[:, 0] = normals
        c.offset[:] = normals @ (p[d:] if self.through is not None else reference[0])
        return c
