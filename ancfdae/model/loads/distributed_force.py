"""Force per length along the centre line of a beam."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from ancfdae.errors import require_vector
from ancfdae.model.loads.load import LAW, ConstantLoad
from ancfdae.model.parts import CentreLine, Elements, Vectors


@final
@dataclass(frozen=True)
class DistributedForce(ConstantLoad):
    """A force fixed in direction per unit of reference length.

    Design targets: ``force_x``, ``force_y``(, ``force_z``).

    Parameters
    ----------
    beam : str
        Name of the beam.
    force_per_length : sequence of float
        N/m.
    """

    beam: str
    force_per_length: Sequence[float]

    kind = "line-load"
    design_fields = (("force_per_length", require_vector), LAW)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the integral of the position over the centre line."""
        return (CentreLine(self.beam),)
