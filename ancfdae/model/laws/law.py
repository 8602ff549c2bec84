"""Laws (functions of time): a number with three time derivatives.

The base class, elementary laws, and smooth passages between values, up to a rate and between laws.
"""

import abc
import math
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.polynomial import Polynomial

from ancfdae.errors.checks import require_kind, require_positive
from ancfdae.model.design import Designable, design_numbers
from ancfdae.numerics.arrays import Array


class Law(Designable, abc.ABC):
    """A function of time with parameters that design variables can drive.

    The first three derivatives are continuous: a prescribed motion has accelerations, and HHT-I3
    starts with their rate. At a kink, where one of them jumps, the motion jumps in that derivative
    too; a fixed step loses its order there and a controlled one shrinks. A law made of pieces tells
    their ends (`breakpoints`): controlled steps end there, and miss none.
    """

    def __post_init__(self) -> None:
        self.check_fields(type(self).__name__)
        self.check()

    def check(self) -> None:  # Most laws have nothing to add.
        """Refuse values that do not fit together.

        Raises
        ------
        InvalidInputError
        """

    @property
    def marked(self) -> bool:
        """Whether its `breakpoints` mark all that is fast in it.

        Steps under error control find pulses of other laws themselves, unless they are shorter than
        1/16,000 of the run.
        """
        return False

    @abc.abstractmethod
    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Return the time derivative of this order, 0 to 3; 0 is the value itself.

        `p` has the values of `parameters`, possibly complex, and t is a number or an array of
        instants; the result has the shape of t.
        """

    @final
    def over_time(self, p: Array, t: Array, unmarked: bool = False) -> list[Array]:
        """Return the law at times t, shape of t, as a list of one array; none if it is marked."""
        return [] if unmarked and self.marked else [self.derivative(p, t, 0)]

    @final
    def derivatives(self, p: Array, t: Any) -> tuple[Array, Array, Array, Array]:
        """Return value and first three time derivatives."""
        value, *rates = (self.derivative(p, t, order) for order in range(4))
        return value, rates[0], rates[1], rates[2]

    @final
    def at(self, t: Any, order: int = 0) -> Array:
        """Return the value, or a time derivative, at instants."""
        p = np.array(list(self.parameters().values()), dtype=float)
        return self.derivative(p, np.asarray(t, dtype=float), order)


def require_law(where: str, value: object) -> None:
    """Raise InvalidInputError unless `value` is a `Law`, a function of time."""
    require_kind(where, value, (Law,), "For example ConstantAcceleration(speed=2).")


# -- elementary laws ---------------------------------------------------------------------------


@final
@dataclass(frozen=True)
class Constant(Law):
    """The constant law x = value."""

    value: float

    marked = True
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

    marked = True
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

    marked = True
    design_fields = design_numbers("amplitude", "frequency", "phase", "offset")

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Time derivative of a given order of amplitude times sine or cosine."""
        amplitude, frequency, phase, offset = p
        wave = (np.sin if order % 2 == 0 else np.cos)(frequency * t + phase)
        sign = -1.0 if order >= 2 else 1.0
        x: Array = sign * amplitude * frequency**order * wave
        return offset + x if order == 0 else x


# -- passages ----------------------------------------------------------------------------------


# The polynomial of least degree from 0 to 1 whose first three derivatives vanish at both ends.
_STEP = Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
_ORDERS = {order: _STEP.deriv(order).coef for order in range(4)} | {-1: _STEP.integ().coef}


def passage(begin: complex, duration: complex) -> tuple[float, float]:
    """Return the instants at which the fourth derivative of `smooth_step` jumps."""
    return begin.real, (begin + duration).real


def smooth_step(t: Any, begin: complex, duration: complex, order: int) -> Array:
    """Return 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7, s = (t - begin)/duration held between 0 and 1.

    Its time derivative of this order, 0 to 3, or -1 for its integral from `begin`.
    """
    s = (t - begin) / duration
    held = np.where(s.real < 0, 0.0, np.where(s.real > 1, 1.0, s))
    # By Horner's rule: a call of Polynomial costs ten times as much at one instant.
    first, *others = _ORDERS[order][::-1].tolist()
    x: Array = first + 0.0 * held
    for coefficient in others:
        x = x * held + coefficient
    if order == -1:
        x = x + np.where(s.real > 1, s - 1.0, 0.0)
    return x / duration**order


@final
@dataclass(frozen=True)
class SmoothStep(Law):
    """From one value to another between two times, constant before and after.

    With s = (t - begin)/duration, held between 0 and 1:
    x = initial + (final - initial) (35 s^4 - 84 s^5 + 70 s^6 - 20 s^7). Three derivatives are
    continuous.

    Parameters
    ----------
    initial, final : float
        Values before and after the passage; the unit of what the law drives.
    duration : float
        Positive; s.
    begin : float, optional
        s.
    """

    initial: float
    final: float
    duration: float
    begin: float = 0.0

    marked = True
    design_fields = (
        *design_numbers("initial", "final"),
        ("duration", require_positive),
        *design_numbers("begin"),
    )

    def breakpoints(self, p: Array) -> tuple[float, ...]:
        """Begin and end of the passage."""
        _, _, duration, begin = p
        return passage(begin, duration)

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Polynomial of degree seven on the way."""
        initial, final, duration, begin = p
        x: Array = (final - initial) * smooth_step(t, begin, duration, order)
        return initial + x if order == 0 else x


@final
@dataclass(frozen=True)
class RunUp(Law):
    """At rest before, with a constant rate after: the angle of a motor that runs up and is held.

    The rate is that of a `SmoothStep` from zero to `rate`, so that at the end of the passage
    x = initial + rate duration/2.

    Parameters
    ----------
    rate : float
        Rate after the run-up; the unit of what the law drives per s.
    duration : float
        Duration of the run-up, positive; s.
    initial : float, optional
        Value before the run-up; the unit of what the law drives.
    begin : float, optional
        s.
    """

    rate: float
    duration: float
    initial: float = 0.0
    begin: float = 0.0

    marked = True
    design_fields = (
        *design_numbers("rate"),
        ("duration", require_positive),
        *design_numbers("initial", "begin"),
    )

    def breakpoints(self, p: Array) -> tuple[float, ...]:
        """Begin and end of the passage."""
        _, duration, _, begin = p
        return passage(begin, duration)

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Time derivative of a given order of the integral of the smooth step in the rate."""
        rate, duration, initial, begin = p
        x: Array = rate * smooth_step(t, begin, duration, order - 1)
        return initial + x if order == 0 else x


@final
@dataclass(frozen=True)
class Transition(Law):
    """One law before, another after: x = (1 - S) before + S after.

    S passes from 0 to 1 as a `SmoothStep` does, so that three derivatives are continuous. A law in
    more pieces is a change of a change. Design targets: ``before_...`` and ``after_...`` with the
    names of both laws' own, ``duration`` and ``begin``.

    Parameters
    ----------
    before, after : Law
    duration : float
        Of the passage, positive; s.
    begin : float
        s.
    """

    before: Law
    after: Law
    duration: float
    begin: float

    design_fields = (
        ("before", require_law),
        ("after", require_law),
        ("duration", require_positive),
        *design_numbers("begin"),
    )

    def numbers_of(self, name: str) -> dict[str, float]:
        """Return the numbers of a field by name; a law's begin with the name of the field."""
        values = super().numbers_of(name)
        if not isinstance(getattr(self, name), Law):
            return values
        return {f"{name}_{key}": value for key, value in values.items()}

    @property
    def marked(self) -> bool:
        """Whether the breakpoints of both laws mark all that is fast in them."""
        return self.before.marked and self.after.marked

    def breakpoints(self, p: Array) -> tuple[float, ...]:
        """Breakpoints of the laws before and after, and the ends of the passage between them; s."""
        *_, duration, begin = p
        return *super().breakpoints(p), *passage(begin, duration)

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Time derivative of a given order, in the unit of what the law drives: Leibniz' rule."""
        before, after, duration, begin = self.split(p)
        x = self.before.derivative(before, t, order)
        for k in range(order + 1):
            rate = order - k
            apart = self.after.derivative(after, t, rate) - self.before.derivative(before, t, rate)
            x = x + math.comb(order, k) * smooth_step(t, begin, duration, k) * apart
        return x
