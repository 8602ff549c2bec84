"""Which right angles of sections joints hold already, or need not hold."""

from collections.abc import Container
from typing import final

import numpy as np

from ancfdae.assembly.layout import Layout
from ancfdae.model.elements import Quantity
from ancfdae.model.joints import RightAngle
from ancfdae.numerics.arrays import Array

_FLAT = frozenset((Quantity.SLOPE_Y, Quantity.SLOPE_Z))
# Places along an element that are nearer than this share of its length hold the same.
_NEAR = 1e-6


@final
class HeldAngles:
    """The right angles of all sections that joints have named so far.

    Slopes of a section vary linearly along an element, and so does the change of its right angle:
    two sections of an element hold that of every third. Bodies that are `rigid` keep their shape by
    themselves; of an element without a section nothing is asked.
    """

    def __init__(self, layout: Layout, rigid: Container[str] = ()) -> None:
        self._layout, self._rigid = layout, rigid
        self._named: set[RightAngle] = set()
        self._flat: dict[str, Array] = {}

    def add(self, angle: RightAngle) -> bool:
        """Name one more, and tell whether it needs an equation."""
        if angle.fraction is None or angle.beam in self._rigid or angle in self._named:
            return False
        beam = self._layout.beam(angle.beam)
        if Quantity.SLOPE_Y not in beam.element.quantities:
            return False
        self._named.add(angle)
        if angle.slopes != _FLAT:
            return True
        element, xi = beam.locate(angle.fraction, angle.before)
        weights = np.zeros((1, beam.element_count + 1))
        weights[0, element], weights[0, element + 1] = 1 - xi, xi
        held = self._flat.get(angle.beam, weights[:0])
        both = np.vstack([held, weights])
        if np.linalg.matrix_rank(both, tol=_NEAR) == len(held):
            return False
        self._flat[angle.beam] = both
        return True
