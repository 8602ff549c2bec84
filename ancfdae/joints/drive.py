"""Prescribed motions: the turning of a section, or the place of a point along a line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity, name_at
from ancfdae.errors import InvalidInput, require_kind, require_vector
from ancfdae.joints.frames import unit
from ancfdae.joints.joint import Coefficients, Joint, empty_coefficients
from ancfdae.joints.laws import Law
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Drive(Joint):
    """Turn the tangent of a beam at a point by a law of time (a driven crank).

    With u the tangent in the reference configuration, freed of its part along the axis, and
    w = axis x u, the tangent r_x stays perpendicular to n = -sin(theta) u + cos(theta) w: the
    equation n(t) . r_x = 0, theta in rad from the reference configuration. Design targets: the
    parameters of the law.

    Parameters
    ----------
    point : Point
    angle : Law
    axis : sequence of float, optional
        Axis of the turning in space, z by default; not used in the plane.
    name : str, optional
        By default ``drive(beam@fraction)``.

    Raises
    ------
    InvalidInput
        If the axis is zero.
    """

    point: Point
    angle: Law
    axis: Sequence[float] = (0.0, 0.0, 1.0)
    name: str = ""

    driven = True

    def __post_init__(self) -> None:
        """Validate and name."""
        if not self.name:
            object.__setattr__(self, "name", name_at("drive", self.point))
        require_kind(
            f"joint {self.name!r}, angle", self.angle, (Law,), "For example Uniform(speed=2)."
        )
        require_vector(f"joint {self.name!r}, axis", self.axis, (3,))
        if not any(self.axis):
            raise InvalidInput(
                f"joint {self.name!r}, axis", "must not be zero", tuple(self.axis), "Give an axis."
            )

    @property
    def points(self) -> tuple[Point, ...]:
        """The driven point."""
        return (self.point,)

    def parameters(self) -> dict[str, float]:
        """Parameters of the law."""
        return self.angle.parameters()

    def with_parameter(self, parameter: str, value: float) -> Drive:
        """Change the law."""
        return replace(self, angle=replace(self.angle, **{parameter: value}))  # type: ignore[type-var]

    def vectors(self, d: int) -> tuple[tuple[Point, Quantity], ...]:
        """Return the tangent."""
        return ((self.point, Quantity.SLOPE_X),)

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Coefficients:
        """n(t) and its derivatives, with c = (cos, sin) and s = (-sin, cos) in the (u, w) plane."""
        n, d = reference.shape
        c = empty_coefficients(1, n, d, np.result_type(p, reference))
        u, w = self._plane(reference[0])
        theta, theta_1, theta_2, theta_3 = self.angle.derivatives(p, t)
        radial = np.cos(theta) * u + np.sin(theta) * w
        normal = -np.sin(theta) * u + np.cos(theta) * w
        # normal' = -theta' radial, radial' = theta' normal.
        c.linear[0, 0] = (
            normal,
            -theta_1 * radial,
            -theta_2 * radial - theta_1**2 * normal,
            (theta_1**3 - theta_3) * radial - 3 * theta_1 * theta_2 * normal,
        )[order]
        return c

    def _plane(self, tangent: Array) -> tuple[Array, Array]:
        if len(tangent) == 2:
            u = unit(tangent)
            return u, np.array([-u[1], u[0]])
        axis = unit(np.asarray(self.axis, dtype=float))
        u = tangent - np.sum(tangent * axis) * axis
        # Below the square root of round-off what is left of the tangent is noise.
        if np.sum(u.real**2) <= 1e-16 * np.sum(tangent.real**2):
            raise InvalidInput(
                f"joint {self.name!r}, axis",
                "must not run along the beam",
                tuple(self.axis),
                "A drive turns the tangent; give an axis across it.",
            )
        u = unit(u)
        return u, np.cross(axis, u)


@final
@dataclass(frozen=True)
class Guide(Joint):
    """Move a point along a direction by a law of time.

    direction . (r(point) - r_o(point)) = x(t), with r_o the reference configuration. Design
    targets: the parameters of the law.

    Parameters
    ----------
    point : Point
    direction : sequence of float
    travel : Law
    name : str, optional
        By default ``guide(beam@fraction)``.

    Raises
    ------
    InvalidInput
        If the direction is zero.
    """

    point: Point
    direction: Sequence[float]
    travel: Law
    name: str = ""

    driven = True

    def __post_init__(self) -> None:
        """Validate and name."""
        if not self.name:
            object.__setattr__(self, "name", name_at("guide", self.point))
        require_kind(
            f"joint {self.name!r}, travel", self.travel, (Law,), "For example Uniform(speed=2)."
        )
        require_vector(f"joint {self.name!r}, direction", self.direction)
        if not any(self.direction):
            raise InvalidInput(
                f"joint {self.name!r}, direction",
                "must not be zero",
                tuple(self.direction),
                "Give the direction of the motion.",
            )

    @property
    def points(self) -> tuple[Point, ...]:
        """The driven point."""
        return (self.point,)

    def parameters(self) -> dict[str, float]:
        """Parameters of the law."""
        return self.travel.parameters()

    def with_parameter(self, parameter: str, value: float) -> Guide:
        """Change the law."""
        return replace(self, travel=replace(self.travel, **{parameter: value}))  # type: ignore[type-var]

    def vectors(self, d: int) -> tuple[tuple[Point, Quantity], ...]:
        """Position of the point."""
        require_vector(f"joint {self.name!r}, direction", self.direction, (d,))
        return ((self.point, Quantity.POSITION),)

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Coefficients:
        """Direction . (r - r_o) - x(t)."""
        n, d = reference.shape
        c = empty_coefficients(1, n, d, np.result_type(p, reference))
        direction = unit(np.asarray(self.direction, dtype=float))
        c.offset[0] = self.travel.derivatives(p, t)[order]
        if order == 0:
            c.linear[0, 0] = direction
            c.offset[0] += direction @ reference[0]
        return c
