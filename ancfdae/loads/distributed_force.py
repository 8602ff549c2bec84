"""Constant force per length along the centre line of a beam."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.bodies import Point, Quantity
from ancfdae.design import replaced_component, vector_parameters
from ancfdae.errors import require_vector
from ancfdae.loads.load import CentreLine, Load
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class DistributedForce(Load):
    """A force of constant size and direction per unit of reference length.

    Design targets: ``force_x``, ``force_y``(, ``force_z``).

    Parameters
    ----------
    beam : str
        Name of the beam.
    force_per_length : sequence of float
        N/m.
    name : str, optional
        By default ``line-load(beam)``.
    """

    beam: str
    force_per_length: Sequence[float]
    name: str = ""

    constant = True

    def __post_init__(self) -> None:
        """Validate and name."""
        if not self.name:
            object.__setattr__(self, "name", f"line-load({self.beam})")
        require_vector(f"load {self.name!r}, force_per_length", self.force_per_length)

    def parameters(self) -> dict[str, float]:
        """Components of the force per length."""
        return vector_parameters("force", self.force_per_length)

    def with_parameter(self, parameter: str, value: float) -> DistributedForce:
        """Change a component."""
        force = replaced_component("force", self.force_per_length, parameter, value)
        return replace(self, force_per_length=force)

    def uses_velocity(self, driven: Collection[str]) -> bool:
        """Never."""
        return False

    def vectors(self) -> tuple[tuple[Point, Quantity] | CentreLine, ...]:
        """Return the integral of the position over the centre line."""
        return (CentreLine(self.beam),)

    def force(self, U: Array, V: Array, p: Array) -> Array:
        """F = p."""
        return np.broadcast_to(p, np.broadcast_shapes(U.shape, p.shape))

    def force_rate(self, U: Array, V: Array, Z: Array, p: Array) -> Array:
        """Zero."""
        return np.zeros_like(U)
