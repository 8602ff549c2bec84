"""Harmonic oscillation."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ancfdae.model.design import numbers
from ancfdae.model.laws.law import Law
from ancfdae.numerics.arrays import Array


@final
@dataclass(frozen=True)
class Harmonic(Law):
    """x = offset + amplitude sin(frequency t + phase), with the frequency in rad/s."""

    amplitude: float
    frequency: float
    phase: float = 0.0
    offset: float = 0.0

    design_fields = numbers("amplitude", "frequency", "phase", "offset")

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Sine and cosine."""
        amplitude, frequency, phase, offset = p
        wave = (np.sin if order % 2 == 0 else np.cos)(frequency * t + phase)
        sign = -1.0 if order >= 2 else 1.0
        x: Array = sign * amplitude * frequency**order * wave
        return offset + x if order == 0 else x
