"""Base class of laws (functions of time): a number with three time derivatives."""

import abc
from typing import Any, final

import numpy as np

from ancfdae.errors.checks import require_kind
from ancfdae.model.design import Designable
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

    @abc.abstractmethod
    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Return the time derivative of this order, 0 to 3; 0 is the value itself.

        `p` has the values of `parameters`, possibly complex, and t is a number or an array of
        instants; the result has the shape of t.
        """

    @final
    def over_time(self, p: Array, t: Array) -> list[Array]:
        """Return the law at times t, shape of t, as a list of one array."""
        return [self.derivative(p, t, 0)]

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
