"""Point mass: a mass lumped at a point of a beam or a body."""

from dataclasses import dataclass
from typing import final

from ancfdae.errors.checks import require_positive
from ancfdae.model.bodies import MaterialPoint
from ancfdae.model.elements import Quantity
from ancfdae.model.parts import Elements, Part, Vectors


@final
@dataclass(frozen=True)
class PointMass(Part):
    """A point mass on a beam or a rigid body; it has no coordinates of its own.

    With r = L q its position, it adds m L^T L to the mass matrix; gravity acts on it. Design
    target: ``mass``.

    Parameters
    ----------
    point : MaterialPoint
    mass : float
        Mass m, positive; kg.
    """

    point: MaterialPoint
    mass: float

    role = "body"
    kind = "mass"
    design_fields = (("mass", require_positive),)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vector that the mass acts on: the position of the point."""
        return ((self.point, Quantity.POSITION),)
