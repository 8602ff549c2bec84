"""Force on a point."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from ancfdae.errors import require_vector
from ancfdae.model.bodies import Point, Quantity
from ancfdae.model.loads.load import LAW, ConstantLoad
from ancfdae.model.parts import Elements, Vectors


@final
@dataclass(frozen=True)
class PointForce(ConstantLoad):
    """A force on a point, fixed in direction (eq. 11).

    Design targets: ``force_x``, ``force_y``(, ``force_z``).

    Parameters
    ----------
    point : Point
    force_vector : sequence of float
        N.
    """

    point: Point
    force_vector: Sequence[float]

    kind = "force"
    design_fields = (("force_vector", require_vector), LAW)

    def vectors(self, elements: Elements) -> Vectors:
        """Position of the point."""
        return ((self.point, Quantity.POSITION),)
