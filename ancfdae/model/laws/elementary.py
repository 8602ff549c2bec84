"""Elementary laws: a number that stays, uniform motion, harmonic oscillation."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.model.design import design_numbers
from ancfdae.model.laws.law import Law
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Constant(Law):
    """The constant law x = value."""

    value: float

    design_fields = design_numbers("value")

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Time derivative of a given order: the value, and zero from order 1 on."""
        return p[0] * np.full_like(t, order == 0, dtype=float)


@final
@dataclass(frozen=True)
class ConstantAcceleration(Law):
    """x = offset + speed t + acceleration t^2 / 2."""

    speed: float
    offset: float = 0.0
    acceleration: float = 0.0

    design_fields = design_numbers("speed", "offset", "acceleration")

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Time derivative of a given order of a polynomial of degree two."""
        speed, offset, acceleration = p
        x: Array = offset + speed * t + acceleration * t**2 / 2
        return (x, speed + acceleration * t, acceleration + 0 * x, 0 * x)[order]


@final
@dataclass(frozen=True)
class Harmonic(Law):
    """x = offset + amplitude sin(frequency t + phase), with the frequency in rad/s."""

    amplitude: float
    frequency: float
    phase: float = 0.0
    offset: float = 0.0

    design_fields = design_numbers("amplitude", "frequency", "phase", "offset")

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Time derivative of a given order of amplitude times sine or cosine."""
        amplitude, frequency, phase, offset = p
        wave = (np.sin if order % 2 == 0 else np.cos)(frequency * t + phase)
        sign = -1.0 if order >= 2 else 1.0
        x: Array = sign * amplitude * frequency**order * wave
        return offset + x if order == 0 else x
