"""Forces that are given: on a point, along a beam, turning with a section."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

from ancfdae.errors.checks import require_vector
from ancfdae.model.bodies import MaterialPoint, Quantity
from ancfdae.model.loads.load import LAW_FIELD, ConstantLoad, Load
from ancfdae.model.parts import CentreLine, Elements, Vectors
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.jets import concatenate, direction


@final
@dataclass(frozen=True)
class PointForce(ConstantLoad):
    """A force on a point, fixed in direction (eq. 11).

    Design targets: ``force_x``, ``force_y``(, ``force_z``).

    Parameters
    ----------
    point : MaterialPoint
    force_vector : sequence of float
        N.
    """

    point: MaterialPoint
    force_vector: Sequence[float]

    kind = "force"
    design_fields = (("force_vector", require_vector), LAW_FIELD)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vector that the force acts on: the position of the point."""
        return ((self.point, Quantity.POSITION),)


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
    design_fields = (("force_per_length", require_vector), LAW_FIELD)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the integral of the position over the centre line."""
        return (CentreLine(self.beam),)


@final
@dataclass(frozen=True)
class FollowerForce(Load):
    """A force with given components along the section's axes.

    F = sum_k f_k r_k / |r_k| over the slope vectors r_k of the point. Design targets:
    ``force_x`` (along the beam), ``force_y``(, ``force_z``).

    Parameters
    ----------
    point : MaterialPoint
    force_components : sequence of float
        Components along tangent, height axis(, width axis); N.
    """

    point: MaterialPoint
    force_components: Sequence[float]

    sharp = False
    kind = "follower"
    design_fields = (("force_components", require_vector), LAW_FIELD)

    def vectors(self, elements: Elements) -> Vectors:
        """Return the vectors that the force depends on: position and slopes of the point."""
        return tuple((self.point, quantity) for quantity in list(Quantity)[: elements.d + 1])

    def force(self, U: Any, V: Any, p: Array, U_o: Array) -> Any:
        """F on the position, none on the slopes."""
        axes = direction(U[..., 1:, :])[1]
        F = (self.split(p)[0][:, None] * axes).sum(axis=-2, keepdims=True)
        return concatenate([F, 0.0 * axes])
