"""Revolute joint about any axis: points coincide, sections turn about the axis only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity, name_at
from ancfdae.design import replaced_component, vector_parameters
from ancfdae.errors import InvalidInput, require_vector
from ancfdae.joints.frames import across, slope_weights, unit
from ancfdae.joints.joint import Coefficients, Joint, empty_coefficients, place_coincidence
from ancfdae.numerics.arrays import Array

_SLOPES = (Quantity.SLOPE_X, Quantity.SLOPE_Y, Quantity.SLOPE_Z)


@final
@dataclass(frozen=True)
class Revolute(Joint):
    """Hinge of a spatial beam to ground or to another beam.

    With e_1, e_2 across the axis in the reference configuration, the section's combinations of
    slopes b_j that equal e_j there must stay perpendicular to the axis a: r(point) - r(other) =
    0, b_1 . a = 0, b_2 . a = 0. On another beam a is the combination of *its* slopes that
    equals the axis, and the last two equations are bilinear. In the plane use `Pin`. Design
    targets: ``axis_x``, ``axis_y``, ``axis_z``, and ``ground_x`` ... where `ground` is given.

    Parameters
    ----------
    point : Point
    axis : sequence of float
        Direction of the axis in the reference configuration.
    other : Point, optional
        Point of another beam; without it the joint holds to ground.
    ground : sequence of float, optional
        Place on the ground; by default where the point is in the reference configuration.
    name : str, optional
        By default ``revolute(beam@fraction)``.

    Raises
    ------
    InvalidInput
        If the axis is zero or not spatial, or both `other` and `ground` are given.
    """

    point: Point
    axis: Sequence[float]
    other: Point | None = None
    ground: Sequence[float] | None = None
    name: str = ""

    holds_position = True

    def __post_init__(self) -> None:
        """Validate and name."""
        if not self.name:
            name = name_at("revolute", self.point)
            object.__setattr__(self, "name", name)
        require_vector(f"joint {self.name!r}, axis", self.axis, (3,))
        if not any(self.axis):
            raise InvalidInput(
                f"joint {self.name!r}, axis",
                "must not be zero",
                tuple(self.axis),
                "Give a direction.",
            )
        if self.ground is not None:
            require_vector(f"joint {self.name!r}, ground", self.ground, (3,))
        if self.other is not None and self.ground is not None:
            raise InvalidInput(
                f"joint {self.name!r}",
                "joins either two points or a point and the ground",
                "both",
                "Leave out `other` or `ground`.",
            )

    @property
    def points(self) -> tuple[Point, ...]:
        """The joined points."""
        return (self.point,) if self.other is None else (self.point, self.other)

    def parameters(self) -> dict[str, float]:
        """Components of `axis` and `ground`."""
        return vector_parameters("axis", self.axis) | vector_parameters("ground", self.ground)

    def with_parameter(self, parameter: str, value: float) -> Revolute:
        """Turn the axis or move the ground point."""
        if parameter.startswith("axis"):
            return replace(self, axis=replaced_component("axis", self.axis, parameter, value))
        assert self.ground is not None
        return replace(self, ground=replaced_component("ground", self.ground, parameter, value))

    def vectors(self, d: int) -> tuple[tuple[Point, Quantity], ...]:
        """Positions, then the slopes of each section."""
        if d != 3:
            raise InvalidInput(
                f"joint {self.name!r}", "is spatial", f"a scene in {d} dimensions", "Use Pin."
            )
        positions = tuple((point, Quantity.POSITION) for point in self.points)
        return positions + tuple((point, slope) for point in self.points for slope in _SLOPES)

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Coefficients:
        """Coincidence and two perpendicularities."""
        n, count = len(reference), len(self.points)
        c = empty_coefficients(5, n, 3, np.result_type(p, reference))
        place_coincidence(c, count, p[3:6] if self.ground is not None else reference[0])
        axis, own = unit(p[:3]), slice(count, count + 3)
        for row, direction in enumerate(across(axis), start=3):
            beta = slope_weights(reference[own], direction)
            if count == 1:
                c.linear[row, own] = beta[:, None] * axis
                continue
            other = slice(count + 3, count + 6)
            alpha = slope_weights(reference[other], axis)
            c.bilinear[row, own, other] = beta[:, None] * alpha
            c.bilinear[row, other, own] = alpha[:, None] * beta
        return c
