"""Prescribed turning of a section, against ground or another section."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.bodies import Point
from ancfdae.elements import BeamElement
from ancfdae.errors import InvalidInput, require_direction
from ancfdae.joints.frames import (
    OUT_OF_PLANE,
    across,
    axis_torque,
    flat_angle,
    place_shapes,
    sections,
    spanned,
    unit,
)
from ancfdae.joints.joint import SECTION, Equations, Joint, empty_coefficients, spanning
from ancfdae.laws import Law
from ancfdae.laws.law import require_law
from ancfdae.numerics.arrays import Array
from ancfdae.parts import Vectors


@final
@dataclass(frozen=True)
class Drive(Joint):
    """Turn the section of a beam at a point by a law of time: a driven crank, a motor in an elbow.

    The angle is that from the reference configuration, in rad, about an axis that stays, or against
    the section of `other`, which carries the axis along. Sections turn, not centre lines: a beam
    that shears transmits a moment through its sections. An element without a section turns its
    tangent instead, against ground only. In space another joint must keep the axis (`Revolute`).
    Design targets: the parameters of the law, and ``axis_x`` ... where the axis is given.

    Parameters
    ----------
    point : Point
    angle : Law
    axis : sequence of float, optional
        Axis of the turning in space, not zero; z by default. Not in the plane.
    other : Point, optional
        Point of another beam, whose section the angle counts from; without it from ground.
    name : str, optional
        By default ``drive(beam@fraction)``.
    """

    point: Point
    angle: Law
    axis: Sequence[float] | None = None
    other: Point | None = None
    name: str = ""

    kind = "drive"
    takes_part = SECTION
    design_fields = (("angle", require_law), ("axis", require_direction))
    driven = True

    def vectors(self, element: BeamElement) -> Vectors:
        """Return the slopes: those that span the section, all where there is another."""
        if self.other is not None:
            return super().vectors(element)[2:]
        return tuple((self.point, q) for q in spanning(element))

    def coefficients(self, p: Array, reference: Array, t: float, order: int) -> Equations:
        """Return the turn of the section, less the angle, and right angles that carry a torque."""
        law, axis = self.split(p)
        axis = self._axis(axis, reference)
        turning = _turning(self.angle.derivatives(law, t))[order]
        if self.other is None:
            return self._against_ground(p, reference, axis, turning, order)
        return self._against_section(p, reference, axis, turning, order)

    def _against_ground(
        self, p: Array, slopes: Array, a: Array, turning: Array, order: int
    ) -> Equations:
        """Sum over the axes w of the section of F w . R(theta) m_w, m_w = (a - 1/2 (a . n) n) x w.

        In the reference a turn phi of the section changes F w . m_w by a . phi in all (theory.md).
        """
        d, (cosine, sine) = slopes.shape[1], turning
        n, axes, weights = spanned(slopes)
        twisting = d == 3 and abs((a @ n).real) > OUT_OF_PLANE
        c = empty_coefficients(1, p, slopes, flat_angle(self.point) if twisting else ())
        for w, own in zip(axes, weights, strict=True):
            m = np.cross(a - (a @ n) / 2 * n, w)
            along = (a @ m) * a
            direction = cosine * (m - along) + sine * np.cross(a, m) + (order == 0) * along
            c.linear[0] += np.outer(own, direction[:d])
        if twisting and order == 0:
            product = np.outer(*weights)
            c.bilinear[1] = product + product.T
        return c

    def _against_section(
        self, p: Array, reference: Array, a: Array, turning: Array, order: int
    ) -> Equations:
        """1/2 (F e_1 . F' R e_2 - F e_2 . F' R e_1) less the shear of both, R = R(theta)."""
        d, (own, other) = reference.shape[1], sections(self.points, reference)
        space = a[:d] if d == 3 else None
        shapes = () if space is None else axis_torque(own, space) + axis_torque(other, space)
        c = empty_coefficients(1, p, reference, shapes)
        e_1, e_2 = np.eye(2) if space is None else across(space)
        for e, e_cos, e_sin in ((e_1, e_2, -e_1), (e_2, -e_1, -e_2)):
            turned = (turning[0] * e_cos + turning[1] * e_sin) / 2
            other.meet(c, 0, own.carried(e), turned)
        if order == 0:
            own.take_out_shear(c, 0, a, 1.0)
            other.take_out_shear(c, 0, a, -1.0)
            place_shapes(c, (own, other))
        return c

    def _axis(self, axis: Array | None, reference: Array) -> Array:
        if axis is None:
            return np.array([0.0, 0.0, 1.0])
        if reference.shape[1] == 3:
            return unit(axis)
        raise InvalidInput(
            f"joint {self.name!r}, axis",
            "is a choice of spatial scenes only",
            self.axis,
            "Leave it out: in the plane it is z.",
        )


def _turning(theta: tuple[Array, Array, Array, Array]) -> Array:
    """Return the cosine and the sine of an angle with three time derivatives, shape (4, 2)."""
    angle, w, w_1, w_2 = theta
    e, e_n = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    # e' = w e_n, e_n' = -w e.
    return np.array([e, w * e_n, w_1 * e_n - w**2 * e, (w_2 - w**3) * e_n - 3 * w * w_1 * e])
