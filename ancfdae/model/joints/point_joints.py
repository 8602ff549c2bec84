"""Joints of points: coincidence, a distance, a line."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors.checks import require_direction, require_positive, require_vector
from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.drawing import Sign, Stroke
from ancfdae.model.joints.frames import across
from ancfdae.model.joints.joint import Joint, JointEquations, empty_equations, place_coincidence
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Pin(Joint):
    """Hold a point of a beam to ground or to a point of another beam.

    The constraint is r(point) - r(other) = 0, or r(point) - ground = 0. Design targets:
    ``ground_x``, ``ground_y``(, ``ground_z``) to ground.

    Parameters
    ----------
    point : MaterialPoint
    other : MaterialPoint, optional
        Point of another beam; without it the joint holds to ground.
    ground : sequence of float, optional
        Position on the ground; by default where the point is in the reference configuration, also
        where other design variables move it, until a target such as ``ground_x`` writes it.
    """

    point: MaterialPoint
    other: MaterialPoint | None = None
    ground: Sequence[float] | None = None

    kind = "pin"
    sign = Sign("pin", "o")
    design_fields = (("ground", require_vector),)
    holds_position = True

    @property
    def by_slopes(self) -> bool:
        """To ground the place of the point matters as well."""
        return self.other is not None

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients of r(point) - r(other), or of r(point) - ground."""
        n, d = reference.shape
        c = empty_equations(d, p, reference)
        place_coincidence(c, n, reference, *self.split(p))
        return c


#: The spherical joint: another name of `Pin`, which holds a point and leaves all rotations free.
Spherical = Pin


@final
@dataclass(frozen=True)
class Distance(Joint):
    """Keep two points, or a point and the ground, at a distance.

    (|r(point) - r(other)|^2 / L - L) / 2 = 0; its multiplier is the force in the link, positive in
    tension; N. Design targets: ``length``, and ``ground_x`` ... where `ground` is given.

    Parameters
    ----------
    point : MaterialPoint
    length : float
        Length L of the link; positive.
    other : MaterialPoint, optional
    ground : sequence of float, optional
        Position on the ground; just one of `other` and `ground` must be given.
    """

    point: MaterialPoint
    length: float
    other: MaterialPoint | None = None
    ground: Sequence[float] | None = None

    kind = "link"
    sign = Sign("link", ".", filled=True)
    stroke = Stroke.LINK
    design_fields = (("length", require_positive), ("ground", require_vector))
    needs_other_end = True

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """(|U_0 - U_1|^2 / L - L) / 2."""
        n, c = len(reference), empty_equations(1, p, reference)
        L, ground = self.split(p)
        c.bilinear[0] = np.array([[1, -1], [-1, 1]])[:n, :n] / L
        c.offset[0] = L / 2
        if ground is not None:
            c.linear[0, 0] = -ground / L
            c.offset[0] -= np.sum(ground * ground) / (2 * L)
        return c


@final
@dataclass(frozen=True)
class PointOnLine(Joint):
    """Keep a point on a straight line.

    n_j . (r(point) - through) = 0 for the d - 1 directions n_j across the line: in the plane the
    direction turned by +90 degrees, in space n_1 as near as possible to the axis of space that is
    most across, the first of equals, and n_2 = direction x n_1. The force on the point is the sum
    of -lam_j n_j. Design targets: ``direction_x`` ..., and ``through_x`` ... where `through` is
    given.

    Parameters
    ----------
    point : MaterialPoint
    direction : sequence of float
        Direction of the line, not zero; its length has no effect (dimensionless).
    through : sequence of float, optional
        A point of the line; by default where `point` is in the reference configuration.
    """

    point: MaterialPoint
    direction: Sequence[float]
    through: Sequence[float] | None = None

    kind = "line"
    sign = Sign("point on a line", "d")
    way_field = "direction"
    design_fields = (("direction", require_direction), ("through", require_vector))

    def coefficients(self, p: Array, reference: Array) -> JointEquations:
        """Return the coefficients of n_j . (r - through) = 0, one row per direction across."""
        c = empty_equations(reference.shape[1] - 1, p, reference)
        direction, through = self.split(p)
        c.linear[:, 0] = across(direction)
        c.offset[:] = c.linear[:, 0] @ (reference[0] if through is None else through)
        return c
