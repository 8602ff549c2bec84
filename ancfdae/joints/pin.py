"""Pin in the plane, spherical joint in space: two points coincide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity, name_at
from ancfdae.design import replaced_component, vector_parameters
from ancfdae.errors import InvalidInput, require_vector
from ancfdae.joints.joint import Coefficients, Joint, empty_coefficients, place_coincidence
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Pin(Joint):
    """Hold a point of a beam to ground or to a point of another beam.

    The constraint is r(point) - r(other) = 0, or r(point) - ground = 0. Design targets:
    ``ground_x``, ``ground_y``(, ``ground_z``) where `ground` is given.

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

    holds_position = True

    def __post_init__(self) -> None:
        """Validate and name."""
        if not self.name:
            object.__setattr__(self, "name", name_at("pin", self.point))
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

    def parameters(self) -> dict[str, float]:
        """Components of `ground`."""
        return vector_parameters("ground", self.ground)

    def with_parameter(self, parameter: str, value: float) -> Pin:
        """Move the ground point."""
        assert self.ground is not None
        return replace(self, ground=replaced_component("ground", self.ground, parameter, value))

    def vectors(self, d: int) -> tuple[tuple[Point, Quantity], ...]:
        """Positions of the joined points."""
        return tuple((point, Quantity.POSITION) for point in self.points)

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Coefficients:
        """r(point) - r(other), or r(point) - ground."""
        n, d = reference.shape
        c = empty_coefficients(d, n, d, np.result_type(p, reference))
        place_coincidence(c, n, p if self.ground is not None else reference[0])
        return c


#: In space the pin is the spherical joint.
Spherical = Pin
