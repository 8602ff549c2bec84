"""Uniform and uniformly accelerated motion."""

from dataclasses import dataclass
from typing import Any, final

from ancfdae.model.design import numbers
from ancfdae.model.laws.law import Law
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Uniform(Law):
    """x = offset + speed t + acceleration t^2 / 2."""

    speed: float
    offset: float = 0.0
    acceleration: float = 0.0

    design_fields = numbers("speed", "offset", "acceleration")

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Polynomial of degree two."""
        speed, offset, acceleration = p
        x: Array = offset + speed * t + acceleration * t**2 / 2
        return (x, speed + acceleration * t, acceleration + 0 * x, 0 * x)[order]
