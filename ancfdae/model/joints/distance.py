"""Distance between two points: a massless rigid link."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors import require_positive, require_vector
from ancfdae.model.bodies import Point
from ancfdae.model.drawing import Sign, Stroke
from ancfdae.model.joints.joint import Equations, Joint, empty_coefficients
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Distance(Joint):
    """Keep two points, or a point and the ground, at a distance.

    (|r(point) - r(other)|^2 / L - L) / 2 = 0; its multiplier is the force in the link, positive in
    tension; N. Design targets: ``length``, and ``ground_x`` ... where `ground` is given.

    Parameters
    ----------
    point : Point
    length : float
        Length L of the link; positive.
    other : Point, optional
    ground : sequence of float, optional
        Position on the ground; just one of `other` and `ground` must be given.
    """

    point: Point
    length: float
    other: Point | None = None
    ground: Sequence[float] | None = None

    kind = "link"
    sign = Sign("link", ".", filled=True)
    stroke = Stroke.LINK
    design_fields = (("length", require_positive), ("ground", require_vector))
    needs_other_end = True

    def coefficients(self, p: Array, reference: Array) -> Equations:
        """(|U_0 - U_1|^2 / L - L) / 2."""
        n, c = len(reference), empty_coefficients(1, p, reference)
        L, ground = self.split(p)
        c.bilinear[0] = np.array([[1, -1], [-1, 1]])[:n, :n] / L
        c.offset[0] = L / 2
        if ground is not None:
            c.linear[0, 0] = -ground / L
            c.offset[0] -= np.sum(ground * ground) / (2 * L)
        return c
