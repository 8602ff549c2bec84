"""Motion laws: a number as a function of time, with three time derivatives."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors import require_finite
from ancfdae.numerics.arrays import Array


class Law(abc.ABC):
    """A function of time with parameters that design variables can drive."""

    @abc.abstractmethod
    def parameters(self) -> dict[str, float]:
        """Return the parameters by name, in a fixed order."""

    @abc.abstractmethod
    def derivatives(self, p: Array, t: float) -> tuple[Array, Array, Array, Array]:
        """Return value and first three time derivatives at parameters p, possibly complex."""


@final
@dataclass(frozen=True)
class Uniform(Law):
    """x = offset + speed t + acceleration t^2 / 2.

    Parameters
    ----------
    speed : float
    offset, acceleration : float
    """

    speed: float
    offset: float = 0.0
    acceleration: float = 0.0

    def __post_init__(self) -> None:
        """Validate."""
        for name, value in self.parameters().items():
            require_finite(f"Uniform.{name}", value)

    def parameters(self) -> dict[str, float]:
        """Speed, offset, acceleration."""
        return {"speed": self.speed, "offset": self.offset, "acceleration": self.acceleration}

    def derivatives(self, p: Array, t: float) -> tuple[Array, Array, Array, Array]:
        """Polynomial of degree two."""
        speed, offset, acceleration = p
        zero = 0 * speed
        value = offset + speed * t + acceleration * t**2 / 2
        return value, speed + acceleration * t, acceleration + zero, zero


@final
@dataclass(frozen=True)
class Harmonic(Law):
    """x = offset + amplitude sin(frequency t + phase).

    Parameters
    ----------
    amplitude : float
    frequency : float
        Angular frequency; rad/s.
    phase, offset : float
    """

    amplitude: float
    frequency: float
    phase: float = 0.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        """Validate."""
        for name, value in self.parameters().items():
            require_finite(f"Harmonic.{name}", value)

    def parameters(self) -> dict[str, float]:
        """Amplitude, frequency, phase, offset."""
        return {
            "amplitude": self.amplitude,
            "frequency": self.frequency,
            "phase": self.phase,
            "offset": self.offset,
        }

    def derivatives(self, p: Array, t: float) -> tuple[Array, Array, Array, Array]:
        """Sine and cosine."""
        amplitude, frequency, phase, offset = p
        s, c = np.sin(frequency * t + phase), np.cos(frequency * t + phase)
        return (
            offset + amplitude * s,
            amplitude * frequency * c,
            -amplitude * frequency**2 * s,
            -amplitude * frequency**3 * c,
        )
