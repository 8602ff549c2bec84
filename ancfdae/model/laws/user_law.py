"""Laws given by a user's function of time, differentiated automatically."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from ancfdae.errors.checks import require_function
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.kernels import OperationList
from ancfdae.model.design import require_numbers
from ancfdae.model.laws.law import Law
from ancfdae.numerics.arrays import Array, Numbers
from ancfdae.numerics.complex_step import FAILURES
from ancfdae.numerics.operations import Listed, Operations

# Order of the highest time derivative that joints need; magnitude above which one counts as
# infinite.
_ORDERS, _LARGEST = 3, 1e100
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
        for _ in range(_ORDERS):
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
