"""Motion laws: a number as a function of time, with three time derivatives."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.design import Designable, numbers
from ancfdae.errors import require_kind
from ancfdae.numerics.arrays import Array


class Law(Designable, abc.ABC):
    """A function of time with parameters that design variables can drive."""

    def __post_init__(self) -> None:
        self.check_fields(type(self).__name__)

    @abc.abstractmethod
    def derivatives(self, p: Array, t: float) -> tuple[Array, Array, Array, Array]:
        """Return value and first three time derivatives at parameters p, possibly complex."""


@final
@dataclass(frozen=True)
class Uniform(Law):
    """x = offset + speed t + acceleration t^2 / 2."""

    speed: float
    offset: float = 0.0
    acceleration: float = 0.0

    design_fields = numbers("speed", "offset", "acceleration")

    def derivatives(self, p: Array, t: float) -> tuple[Array, Array, Array, Array]:
        """Polynomial of degree two."""
        speed, offset, acceleration = p
        zero = 0 * speed
        value = offset + speed * t + acceleration * t**2 / 2
        return value, speed + acceleration * t, acceleration + zero, zero


@final
@dataclass(frozen=True)
class Harmonic(Law):
    """x = offset + amplitude sin(frequency t + phase), with the frequency in rad/s."""

    amplitude: float
    frequency: float
    phase: float = 0.0
    offset: float = 0.0

    design_fields = numbers("amplitude", "frequency", "phase", "offset")

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


def require_law(where: str, value: object) -> None:
    """Raise InvalidInput for what is no law."""
    require_kind(where, value, (Law,), "For example Uniform(speed=2).")
