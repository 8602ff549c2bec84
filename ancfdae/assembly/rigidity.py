"""What keeps a rigid body rigid: its directions stay orthonormal."""

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.model.joints import Equations, Joint
from ancfdae.model.joints.joint import empty_coefficients
from ancfdae.model.parts import Elements, FrameDirection, Vectors
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Rigidity(Joint):
    """Keep the directions of a body orthonormal: (d_i . d_j - delta_ij) / (1 + delta_ij) = 0.

    Three equations in the plane and six in space, by the name of ``rigid(body)``.
    """

    beam: str

    kind = "rigid"

    def vectors(self, elements: Elements) -> Vectors:
        """Return the directions."""
        return tuple(FrameDirection(self.beam, k + 1) for k in range(elements.d))

    def coefficients(self, p: Array, reference: Array) -> Equations:
        """Entries i <= j of d_i . d_j."""
        i, j = np.triu_indices(reference.shape[1])
        rows = np.arange(len(i))
        c = empty_coefficients(len(i), p, reference)
        c.bilinear[rows, i, j] = c.bilinear[rows, j, i] = 1.0
        c.offset[:] = 0.5 * (i == j)
        return c
