"""Prescribed motions: the turning of a section, or the place of a point along a line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.bodies import Point
from ancfdae.elements import BeamElement
from ancfdae.errors import InvalidInput, require_direction
from ancfdae.joints.frames import unit
from ancfdae.joints.joint import Equations, Joint, empty_coefficients, spanning
from ancfdae.laws import Law
from ancfdae.laws.law import require_law
from ancfdae.numerics.arrays import Array
from ancfdae.parts import Vectors


@final
@dataclass(frozen=True)
class Drive(Joint):
    """Turn the section of a beam at a point by a law of time (a driven crank).

    With n the normal of the section in the reference configuration, b the combination of the
    section's slopes that equals a x n over its length there, a the axis (in the plane b = r_y): b
    stays perpendicular to d(theta), which is a x b of the reference turned about the axis by theta,
    in rad from the reference configuration. A beam that shears transmits a moment through its
    sections, not through the direction of its centre line at a point. An element without a section
    turns its tangent instead. Design targets: the parameters of the law, and ``axis_x`` ... where
    the axis is given.

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

    kind = "drive"
    design_fields = (("angle", require_law), ("axis", require_direction))
    driven = True

    def vectors(self, element: BeamElement) -> Vectors:
        """Return the slopes that span the section."""
        return tuple((self.point, q) for q in spanning(element))

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Equations:
        """d(theta) and its derivatives, times the weights of the slopes in b."""
        c = empty_coefficients(1, p, reference)
        law, axis = self.split(p)
        weights, b, d = self._material_direction(reference, axis)
        theta, theta_1, theta_2, theta_3 = self.angle.derivatives(law, t)
        # a x d = -b.
        turned = np.cos(theta) * d - np.sin(theta) * b
        normal = -np.sin(theta) * d - np.cos(theta) * b
        # turned' = theta' normal, normal' = -theta' turned.
        direction = (
            turned,
            theta_1 * normal,
            theta_2 * normal - theta_1**2 * turned,
            (theta_3 - theta_1**3) * normal - 3 * theta_1 * theta_2 * turned,
        )[order]
        c.linear[0] = weights[:, None] * direction
        return c

    def _material_direction(self, slopes: Array, axis: Array | None) -> tuple[Array, Array, Array]:
        """Return weights of the slopes in b, b of the reference, and a x b."""
        if slopes.shape[1] == 2:
            if axis is not None:
                raise InvalidInput(
                    f"joint {self.name!r}, axis",
                    "is a choice of spatial scenes only",
                    self.axis,
                    "Leave it out: in the plane it is z.",
                )
            b = unit(slopes[0])
            return np.array([1.0]), b, np.array([-b[1], b[0]])
        axis = np.array([0.0, 0.0, 1.0]) if axis is None else unit(axis)
        across = np.cross(axis, unit(np.cross(*slopes)))
        # Below the square root of round-off what is left across the axis is noise.
        if np.sum(across.real**2) <= 1e-16:
            raise InvalidInput(
                f"joint {self.name!r}, axis",
                "must not run along the beam",
                tuple(axis.real),
                "Give an axis in the section, or across it at most in part.",
            )
        b = unit(across)
        return np.linalg.solve(slopes @ slopes.T, slopes @ b), b, np.cross(axis, b)


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
