"""Constant force on a point."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity, name_at
from ancfdae.design import replaced_component, vector_parameters
from ancfdae.errors import require_vector
from ancfdae.loads.load import CentreLine, Load
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class PointForce(Load):
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

    constant = True

    def __post_init__(self) -> None:
        """Validate and name."""
        if not self.name:
            object.__setattr__(self, "name", name_at("force", self.point))
        require_vector(f"load {self.name!r}, force_vector", self.force_vector)

    def parameters(self) -> dict[str, float]:
        """Components of the force."""
        return vector_parameters("force", self.force_vector)

    def with_parameter(self, parameter: str, value: float) -> PointForce:
        """Change a component."""
        force = replaced_component("force", self.force_vector, parameter, value)
        return replace(self, force_vector=force)

    def uses_velocity(self, driven: Collection[str]) -> bool:
        """Never."""
        return False

    def vectors(self) -> tuple[tuple[Point, Quantity] | CentreLine, ...]:
        """Position of the point."""
        return ((self.point, Quantity.POSITION),)

    def force(self, U: Array, V: Array, p: Array) -> Array:
        """F = p."""
        return np.broadcast_to(p, np.broadcast_shapes(U.shape, p.shape))

    def force_rate(self, U: Array, V: Array, Z: Array, p: Array) -> Array:
        """Zero."""
        return np.zeros_like(U)
