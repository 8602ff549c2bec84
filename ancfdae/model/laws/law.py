"""Laws (functions of time): a number with three time derivatives.

The base class, elementary laws, smooth passages between values, up to a rate and between laws, and
laws given by a user's function of time, differentiated automatically.
"""

import abc
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np
from numpy.polynomial import Polynomial

from ancfdae.errors.checks import require_function, require_kind, require_positive
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.kernels import OperationList
from ancfdae.model.design import Designable, design_numbers, require_numbers
from ancfdae.numerics.arrays import Array, Numbers
from ancfdae.numerics.complex_step import FAILURES
from ancfdae.numerics.operations import Listed, Operations


class Law(Designable, abc.ABC):
    """A function of time with parameters that design variables can drive.

    The first three derivatives are continuous: a prescribed motion has accelerations, and HHT-I3
    starts with the rate of acceleration. Where one of these derivatives jumps, the motion jumps in
    that derivative, too: a fixed step loses its order there and a controlled step shrinks. A
    piecewise law returns the ends of its pieces (`breakpoints`); steps under error control end
    there.
    """

    def __post_init__(self) -> None:
        self.check_fields(type(self).__name__)
        self.check()

    def check(self) -> None:  # Most laws have nothing to add.
        """Check values of several fields together; most laws have nothing to check.

        Raises
        ------
        InvalidInputError
        """

    @property
    def marked(self) -> bool:
        """Whether `breakpoints` mark all fast changes of the law.

        Steps under error control find pulses of other laws themselves, unless these are shorter
        than 1/16,000 of the run.
        """
        return False

    @abc.abstractmethod
    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Return the time derivative of order 0 to 3 of the law; order 0 is its value.

        `p` holds the values of `parameters`, real or complex, and t is a time or an array of times;
        the result has the shape of t.
        """

    @final
    def over_time(self, p: Array, t: Array, unmarked: bool = False) -> list[Array]:
        """Return the law at times t, shape of t, as a list of one array; none if it is marked."""
        return [] if unmarked and self.marked else [self.derivative(p, t, 0)]

    @final
    def derivatives(self, p: Array, t: Any) -> tuple[Array, Array, Array, Array]:
        """Return the value of the law and its first three time derivatives at t, shape of t."""
        value, *rates = (self.derivative(p, t, order) for order in range(4))
        return value, rates[0], rates[1], rates[2]

    @final
    def at(self, t: Any, order: int = 0) -> Array:
        """Return the value of the law, or a time derivative of it, at times t; shape of t."""
        p = np.array(list(self.parameters().values()), dtype=float)
        return self.derivative(p, np.asarray(t, dtype=float), order)


def require_law(where: str, value: object) -> None:
    """Raise InvalidInputError unless `value` is a `Law`, a function of time."""
    require_kind(where, value, (Law,), "For example ConstantAcceleration(speed=2).")


# -- elementary laws ---------------------------------------------------------------------------


@final
@dataclass(frozen=True)
class Constant(Law):
    """The constant law x = value, in the unit of the quantity that it drives."""

    value: float

    marked = True
    design_fields = design_numbers("value")

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Return the value, or zero for orders 1 to 3, in the shape of t."""
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
        """Return the time derivative of this order of a polynomial of degree two, shape of t."""
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
        """Return the time derivative of this order of a harmonic law, shape of t."""
        amplitude, frequency, phase, offset = p
        wave = (np.sin if order % 2 == 0 else np.cos)(frequency * t + phase)
        sign = -1.0 if order >= 2 else 1.0
        x: Array = sign * amplitude * frequency**order * wave
        return offset + x if order == 0 else x


# -- passages ----------------------------------------------------------------------------------


# The polynomial of lowest degree from 0 to 1 whose first three derivatives vanish at both ends.
_STEP = Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
_ORDERS = {order: _STEP.deriv(order).coef for order in range(4)} | {-1: _STEP.integ().coef}


def passage(begin: complex, duration: complex) -> tuple[float, float]:
    """Return the times at which the fourth derivative of `smooth_step` jumps, its ends; s."""
    return begin.real, (begin + duration).real


def smooth_step(t: Any, begin: complex, duration: complex, order: int) -> Array:
    """Return S = 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7, or a time derivative of it.

    s = (t - begin)/duration, limited to [0, 1]. `order` is 0 to 3, or -1 for the integral of S from
    `begin`.
    """
    s = (t - begin) / duration
    held = np.where(s.real < 0, 0.0, np.where(s.real > 1, 1.0, s))
    # By Horner's rule: a call of Polynomial costs ten times as much for one time.
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
        Values before and after the passage, in the unit of the driven quantity.
    duration : float
        Duration of the passage, positive; s.
    begin : float, optional
        Start of the passage; s.
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
        """Return start and end of the passage; s."""
        _, _, duration, begin = p
        return passage(begin, duration)

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Return the time derivative of this order of the smooth step, shape of t."""
        initial, final, duration, begin = p
        x: Array = (final - initial) * smooth_step(t, begin, duration, order)
        return initial + x if order == 0 else x


@final
@dataclass(frozen=True)
class RunUp(Law):
    """A run-up: constant before, at a constant rate after, such as the angle of a motor.

    The rate is that of a `SmoothStep` from zero to `rate`, so that at the end of the passage
    x = initial + rate duration/2.

    Parameters
    ----------
    rate : float
        Rate after the run-up, in the unit of the driven quantity per s.
    duration : float
        Duration of the run-up, positive; s.
    initial : float, optional
        Value before the run-up, in the unit of the driven quantity.
    begin : float, optional
        Start of the run-up; s.
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
        """Return start and end of the run-up; s."""
        _, duration, _, begin = p
        return passage(begin, duration)

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Return the time derivative of this order of the run-up, shape of t."""
        rate, duration, initial, begin = p
        x: Array = rate * smooth_step(t, begin, duration, order - 1)
        return initial + x if order == 0 else x


@final
@dataclass(frozen=True)
class Transition(Law):
    """One law before, another after: x = (1 - S) before + S after.

    S passes from 0 to 1 as a `SmoothStep` does, so that three derivatives are continuous. `before`
    and `after` may be transitions themselves. Design targets: those of the two laws as
    ``before_...`` and ``after_...``, ``duration`` and ``begin``.

    Parameters
    ----------
    before, after : Law
    duration : float
        Duration of the passage, positive; s.
    begin : float
        Start of the passage; s.
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
        """Return the numbers of a field by target name; those of a law begin with the field."""
        values = super().numbers_of(name)
        if not isinstance(getattr(self, name), Law):
            return values
        return {f"{name}_{key}": value for key, value in values.items()}

    @property
    def marked(self) -> bool:
        """Whether the breakpoints of both laws mark all their fast changes."""
        return self.before.marked and self.after.marked

    def breakpoints(self, p: Array) -> tuple[float, ...]:
        """Return the breakpoints of both laws, and start and end of the passage; s."""
        *_, duration, begin = p
        return *super().breakpoints(p), *passage(begin, duration)

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Return the time derivative of this order of the transition by Leibniz' rule, at t."""
        before, after, duration, begin = self.split(p)
        x = self.before.derivative(before, t, order)
        for k in range(order + 1):
            rate = order - k
            apart = self.after.derivative(after, t, rate) - self.before.derivative(before, t, rate)
            x = x + math.comb(order, k) * smooth_step(t, begin, duration, k) * apart
        return x


# Order of the highest time derivative that joints need; magnitude above which one counts as
# infinite.
_TRACED, _LARGEST = 3, 1e100
# Times of all sizes at which a function is tried, s; values that are not finite are not compared.
_TRIED = np.array([0.0, 1e-6, 1e-4, 1e-2, 1.0, 1e2])


def _require_values(where: str, value: Any) -> None:
    if not isinstance(value, tuple) or value:
        require_numbers(where, value)


@final
@dataclass(frozen=True)
class UserLaw(Law):
    """A user-defined function of time, x = function(t, value[0], value[1], ...).

    Its time derivatives are formed by the rules of differentiation, exactly: it consists of
    arithmetic and NumPy's exp, log, sqrt, sin, cos, tan, sinh, cosh, tanh, arctan, square and
    reciprocal. It works on arrays of times. A function without derivatives is rejected. Design
    targets: ``value[0]``, ``value[1]`` ...

    Parameters
    ----------
    function : callable
    values : sequence of float, optional
        Further arguments of the function, after the time, each in a unit of your choice.
    """

    function: Callable[..., Any]
    values: Numbers = ()

    design_fields = (("values", _require_values),)
    indexed_fields: ClassVar[Mapping[str, str]] = {"values": "value"}

    @cached_property
    def _lists(self) -> tuple[OperationList, ...]:
        """Operation lists, in t and the values, of the function and its three time derivatives."""
        inputs = range(1 + len(self.values))
        operations = Operations(len(inputs))
        t, *p = (Listed(operations, np.array([i])) for i in inputs)
        of_order = [t.numbers(self.function(t, *p))]
        for _ in range(_TRACED):
            of_order += operations.along(of_order[-1], {0: operations.constant(1.0)})
        return tuple(operations.compiled(numbers, inputs) for numbers in of_order)

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Return the time derivative of this order by the list of operations, shape of t."""
        t = np.asarray(t)
        values = self._lists[order].values(t.reshape(-1, 1), p)
        # Lists replace 1/0 in derivatives by large numbers.
        values[np.abs(values) > _LARGEST] = np.inf
        return values.reshape(t.shape)

    def check(self) -> None:
        """Raise InvalidInputError unless the function can be differentiated in time."""
        where = "UserLaw, function"
        require_function(where, self.function)
        p = np.array(self.values, dtype=float)
        with np.errstate(all="ignore"):
            try:
                values = self.derivative(p, _TRIED, 0)
                plain = self.function(_TRIED, *p) + 0 * _TRIED
                plain = np.where(np.abs(plain) > _LARGEST, np.inf, plain)
            except FAILURES as error:
                if isinstance(error, InvalidInputError):
                    raise
                raise InvalidInputError(
                    where,
                    "must have derivatives in time",
                    f"{type(error).__name__}: {error}",
                    "Write it for arrays, with arithmetic and NumPy's elementary functions.",
                ) from error
            if not np.allclose(values, plain, rtol=1e-9, atol=0.0, equal_nan=True):
                raise InvalidInputError(
                    where,
                    "must have the same values for numbers and for symbols",
                    f"{plain} and {values}",
                    "Write it with arithmetic and NumPy's elementary functions only.",
                )
