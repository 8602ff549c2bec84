"""Force on a point."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from ancfdae.errors import require_vector
from ancfdae.model.bodies import Point, Quantity
from ancfdae.model.laws import Law
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
    name : str, optional
        By default ``force(beam@fraction)``.
    law : Law, optional
        Factor of the force over time; its parameters are design targets, too.
    """

    point: Point
    force_vector: Sequence[float]
    name: str = ""
    law: Law | None = None

    kind = "force"
    design_fields = (("force_vector", require_vector), LAW)

    def vectors(self, elements: Elements) -> Vectors:
        """Position of the point."""
        return ((self.point, Quantity.POSITION),)
