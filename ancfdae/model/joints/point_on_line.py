"""Point on a line fixed to ground: a massless slider."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from ancfdae.errors import require_direction, require_vector
from ancfdae.model.bodies import Point
from ancfdae.model.drawing import Sign
from ancfdae.model.joints.frames import across
from ancfdae.model.joints.joint import Equations, Joint, empty_coefficients
from ancfdae.numerics.arrays import Array


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
    point : Point
    direction : sequence of float
        Not zero.
    through : sequence of float, optional
        A point of the line; by default where `point` is in the reference configuration.
    """

    point: Point
    direction: Sequence[float]
    through: Sequence[float] | None = None

    kind = "line"
    sign = Sign("point on a line", "d")
    way_field = "direction"
    design_fields = (("direction", require_direction), ("through", require_vector))

    def coefficients(self, p: Array, reference: Array) -> Equations:
        """n_j . (r - through)."""
        c = empty_coefficients(reference.shape[1] - 1, p, reference)
        direction, through = self.split(p)
        c.linear[:, 0] = across(direction)
        c.offset[:] = c.linear[:, 0] @ (reference[0] if through is None else through)
        return c
