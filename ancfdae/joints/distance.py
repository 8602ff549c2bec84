"""Distance between two points: a massless rigid link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity, name_at
from ancfdae.design import replaced_component, vector_parameters
from ancfdae.errors import InvalidInput, require_positive, require_vector
from ancfdae.joints.joint import Coefficients, Joint, empty_coefficients
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Distance(Joint):
    """Keep two points, or a point and the ground, at a distance.

    (|r(point) - r(other)|^2 / L - L) / 2 = 0; its multiplier is the tension (negative) or
    thrust of the link. Design targets: ``length``, and ``ground_x`` ... where `ground` is given.

    Parameters
    ----------
    point : Point
    length : float
        Length L of the link.
    other : Point, optional
        Point of another beam.
    ground : sequence of float, optional
        Place on the ground; one of `other` and `ground` must be given.
    name : str, optional
        By default ``link(beam@fraction)``.

    Raises
    ------
    InvalidInput
        If the length is not positive, or not exactly one of `other` and `ground` is given.
    """

    point: Point
    length: float
    other: Point | None = None
    ground: Sequence[float] | None = None
    name: str = ""

    def __post_init__(self) -> None:
        """Validate and name."""
        if not self.name:
            object.__setattr__(self, "name", name_at("link", self.point))
        require_positive(f"joint {self.name!r}, length", self.length)
        if (self.other is None) == (self.ground is None):
            raise InvalidInput(
                f"joint {self.name!r}",
                "links a point either to another one or to the ground",
                "both" if self.other is not None else "neither",
                "Give `other` or `ground`.",
            )
        if self.ground is not None:
            require_vector(f"joint {self.name!r}, ground", self.ground)

    @property
    def points(self) -> tuple[Point, ...]:
        """The linked points."""
        return (self.point,) if self.other is None else (self.point, self.other)

    def parameters(self) -> dict[str, float]:
        """Length and components of `ground`."""
        return {"length": self.length} | vector_parameters("ground", self.ground)

    def with_parameter(self, parameter: str, value: float) -> Distance:
        """Change the length or move the ground point."""
        if parameter == "length":
            return replace(self, length=value)
        assert self.ground is not None
        return replace(self, ground=replaced_component("ground", self.ground, parameter, value))

    def vectors(self, d: int) -> tuple[tuple[Point, Quantity], ...]:
        """Positions of the linked points."""
        return tuple((point, Quantity.POSITION) for point in self.points)

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Coefficients:
        """(|U_0 - U_1|^2 / L - L) / 2."""
        n, d = reference.shape
        c = empty_coefficients(1, n, d, np.result_type(p, reference))
        L, ground = p[0], p[1:]
        c.bilinear[0, 0, 0] = 1 / L
        c.offset[0] = L / 2
        if n == 2:
            c.bilinear[0, 1, 1] = 1 / L
            c.bilinear[0, 0, 1] = c.bilinear[0, 1, 0] = -1 / L
        else:
            c.linear[0, 0] = -ground / L
            c.offset[0] -= np.sum(ground * ground) / (2 * L)
        return c
