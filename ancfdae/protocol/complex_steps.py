"""Derivatives of a system's values by complex steps: how all that is not written follows."""

from __future__ import annotations

import abc
from collections.abc import Callable
from functools import cached_property
from typing import Any, Self

import numpy as np

from ancfdae.errors import InvalidInput
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import Pattern

#: What is wrong with a `with_values` that does not hand its argument on.
FORGOTTEN = (
    "must return the system at the values b that it is given",
    "one at others",
    "Hand b on to the constructor, and keep it as self.b, complex or not.",
)


class ComplexSteps(abc.ABC):
    """What has coordinates and design variables, and values that accept complex numbers."""

    n_q: int
    design_names: tuple[str, ...]
    b: Array

    @cached_property
    def n_b(self) -> int:
        """Number of design variables."""
        return len(self.design_names)

    @abc.abstractmethod
    def with_values(self, b: Array) -> Self:
        """Return the same system at other values of the design variables, real or complex."""

    def at_values(self, b: Array) -> Self:
        """Return `with_values`; raise InvalidInput if it forgets them."""
        other = self.with_values(b)
        if not np.array_equal(other.b, b):
            raise InvalidInput(f"{type(self).__name__}.with_values", *FORGOTTEN)
        return other

    def moved(self, i: int) -> Self:
        """Return the system with design variable i moved by a small imaginary step."""
        if i not in self._moved:
            self._moved[i] = self.at_values(self.b + 1j * STEP * np.eye(self.n_b)[i])
        return self._moved[i]

    @cached_property
    def _moved(self) -> dict[int, Self]:
        return {}

    def along(self, value: Callable[..., Array], *states: tuple[Array, Array]) -> Array:
        """Differentiate in the design variables along given derivatives of states.

        `value(system, *states)` is exact in complex numbers; every state, shape (n,), comes with
        its derivative, (n, n_b). The result has the shape of the value + (n_b,).
        """
        columns = [
            np.imag(value(self.moved(i), *(x + 1j * STEP * x_b[:, i] for x, x_b in states)))
            for i in range(self.n_b)
        ]
        if not columns:
            return np.zeros((*np.shape(value(self, *(x for x, _ in states))), 0))
        return np.asarray(np.stack(columns, axis=-1) / STEP)

    def _by_coordinate(self, value: Callable[[Array], Array], x: Array, pattern: Pattern) -> Array:
        """Differentiate in the numbers of x; what is imaginary already does not count."""
        still = np.imag(value(x))
        columns = [np.imag(value(x + 1j * STEP * e)) - still for e in np.eye(self.n_q)]
        matrix = np.stack(columns, axis=-1) / STEP
        return np.asarray(matrix[pattern.rows, pattern.columns])

    def _by_number(self, value: Callable[[Any], Array]) -> Array:
        """Differentiate at zero in one number."""
        return np.asarray(np.imag(value(1j * STEP)) / STEP)
