"""Prescribed motions: the turning of a section, or the place of a point along a line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity
from ancfdae.errors import InvalidInput, require_direction
from ancfdae.joints.frames import unit
from ancfdae.joints.joint import Equations, Joint, empty_coefficients
from ancfdae.joints.laws import Law, require_law
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Drive(Joint):
    """Turn the tangent of a beam at a point by a law of time (a driven crank).

    With u the tangent in the reference configuration, freed of its part along the axis, and
    w = axis x u, the tangent r_x stays perpendicular to n = -sin(theta) u + cos(theta) w: the
    equation n(t) . r_x = 0, theta in rad from the reference configuration. Design targets: the
    parameters of the law, and ``axis_x`` ... where the axis is given.

    Parameters
    ----------
    point : Point
    angle : Law
    axis : sequence of float, optional
        Axis of the turning in space, not zero; z by default. Not in the plane.
    name : str, optional
        By default ``drive(beam@fraction)``.
    """

    point: Point
    angle: Law
    axis: Sequence[float] | None = None
    name: str = ""

    takes_part = (Quantity.SLOPE_X,)
    kind = "drive"
    design_fields = (("angle", require_law), ("axis", require_direction))
    driven = True

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Equations:
        """n(t) and its derivatives, with c = (cos, sin) and s = (-sin, cos) in the (u, w) plane."""
        c = empty_coefficients(1, p, reference)
        law, axis = self.split(p)
        u, w = self._plane(reference[0], axis)
        theta, theta_1, theta_2, theta_3 = self.angle.derivatives(law, t)
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

    def _plane(self, tangent: Array, axis: Array | None) -> tuple[Array, Array]:
        if len(tangent) == 2:
            if axis is not None:
                raise InvalidInput(
                    f"joint {self.name!r}, axis",
                    "is a choice of spatial scenes only",
                    self.axis,
                    "Leave it out: in the plane it is z.",
                )
            u = unit(tangent)
            return u, np.array([-u[1], u[0]])
        axis = np.array([0.0, 0.0, 1.0]) if axis is None else unit(axis)
        u = tangent - np.sum(tangent * axis) * axis
        # Below the square root of round-off what is left of the tangent is noise.
        if np.sum(u.real**2) <= 1e-16 * np.sum(tangent.real**2):
            raise InvalidInput(
                f"joint {self.name!r}, axis",
                "must not run along the beam",
                tuple(axis.real),
                "A drive turns the tangent; give an axis across it.",
            )
        u = unit(u)
        return u, np.cross(axis, u)


@final
@dataclass(frozen=True)
class Guide(Joint):
    """Move a point along a direction by a law of time.

    direction . (r(point) - r_o(point)) = x(t), with r_o the reference configuration. Design
    targets: ``direction_x`` ... and the parameters of the law.

    Parameters
    ----------
    point : Point
    direction : sequence of float
        Not zero.
    travel : Law
    name : str, optional
        By default ``guide(beam@fraction)``.
    """

    point: Point
    direction: Sequence[float]
    travel: Law
    name: str = ""

    kind = "guide"
    design_fields = (("direction", require_direction), ("travel", require_law))
    driven = True

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Equations:
        """Direction . (r - r_o) - x(t)."""
        c = empty_coefficients(1, p, reference)
        direction, law = self.split(p)
        c.offset[0] = self.travel.derivatives(law, t)[order]
        if order == 0:
            c.linear[0, 0] = unit(direction)
            c.offset[0] += c.linear[0, 0] @ reference[0]
        return c
