"""A user's function of time."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.errors.checks import require_function
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.model.design import require_numbers
from ancfdae.model.laws.law import Law
from ancfdae.numerics.arrays import Array, Numbers
from ancfdae.numerics.complex_step import FAILURES, require_derivative
from ancfdae.numerics.jets import Jet

# Instants of all sizes at which a function is tried; where it is not finite it is not judged.
_TRIED = np.array([0.0, 1e-6, 1e-4, 1e-2, 1.0, 1e2])


def _require_values(where: str, value: Any) -> None:
    if not isinstance(value, tuple) or value:
        require_numbers(where, value)


@final
@dataclass(frozen=True)
class UserLaw(Law):
    """A function of time of a user's own, x = function(t, value[0], value[1], ...).

    Its time derivatives are formed by the rules of differentiation, exactly: it consists of
    arithmetic and NumPy's exp, log, sqrt, sin, cos, tan, sinh, cosh, tanh, arctan, square and
    reciprocal. It works on arrays of instants and takes complex values. A function without
    derivatives is refused. Design targets: ``value[0]``, ``value[1]`` ...

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

    def derivative(self, p: Array, t: Any, order: int) -> Array:
        """Time derivative of a given order, by Taylor arithmetic of the function."""
        t = np.asarray(t)
        x = self.function(Jet(t, np.ones_like(t), *(0 * t for _ in range(order - 1))), *p)
        # A jet of order zero would take another way through the function.
        value = x.derivatives[order] if isinstance(x, Jet) else x * (order == 0)
        return np.asarray(value + 0 * t)

    def check(self) -> None:
        """Raise InvalidInputError unless the law is a function with its derivatives."""
        where = "UserLaw, function"
        require_function(where, self.function)
        p = np.array(self.values, dtype=float)
        with np.errstate(all="ignore"):
            try:
                values = self.derivative(p, _TRIED, 0)
                self.derivatives(p, _TRIED)
                plain = self.function(_TRIED, *p) + 0 * _TRIED
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
                    "must have the same values for numbers and for Taylor series",
                    f"{plain} and {values}",
                    "Write it with arithmetic and NumPy's elementary functions only.",
                )
            for order in range(4 if len(p) else 0):
                self._check_parameters(where, p, order)

    def _check_parameters(self, where: str, p: Array, order: int) -> None:
        def value(*x: Array) -> Array:
            return self.derivative(np.array(x), _TRIED, order)

        for k in range(len(p)):
            dx = [np.asarray((abs(x) or 1.0) * (i == k)) for i, x in enumerate(p)]
            require_derivative(where, value, list(p), dx)
