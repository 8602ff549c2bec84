"""Constant force on a point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from ancfdae.bodies import Point, Quantity
from ancfdae.elements import BeamElement
from ancfdae.errors import require_vector
from ancfdae.loads.load import ConstantLoad
from ancfdae.parts import Vectors


@final
@dataclass(frozen=True)
class PointForce(ConstantLoad):
    """A force of constant size and direction on a point (eq. 11).

    Design targets: ``force_x``, ``force_y``(, ``force_z``).

    Parameters
    ----------
    point : Point
    force_vector : sequence of float
        N.
    name : str, optional
        By default ``force(beam@fraction)``.
    """

    point: Point
    force_vector: Sequence[float]
    name: str = ""

    kind = "force"
    design_fields = (("force_vector", require_vector),)

    def vectors(self, element: BeamElement) -> Vectors:
        """Position of the point."""
        return ((self.point, Quantity.POSITION),)
