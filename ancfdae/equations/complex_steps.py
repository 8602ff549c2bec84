"""Derivatives of a system's values by complex steps, the default of methods not overridden."""

import abc
from collections.abc import Callable
from functools import cached_property
from typing import Self, TypeVar

import numpy as np

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.patterns import SparsityPattern

#: Rule, value and remedy of the error for a `with_values` that ignores its argument.
FORGOTTEN = (
    "must return the system at the values b that it is given",
    "one at others",
    "Hand b on to the constructor, and keep it as self.b, complex or not.",
)


_System = TypeVar("_System", bound="ComplexSteps")


class ComplexSteps(abc.ABC):
    """A system with coordinates and design variables whose values accept complex numbers."""

    n_q: int
    design_names: tuple[str, ...]
    b: Array

    @cached_property
    def n_b(self) -> int:
        """Number of design variables n_b."""
        return len(self.design_names)

    @abc.abstractmethod
    def with_values(self, b: Array) -> Self:
        """Return the same system at other values of the design variables, real or complex."""

    def _at_step(self, i: int) -> Self:
        """Return the system with design variable i perturbed by a small imaginary step."""
        if i not in self._at_steps:
            self._at_steps[i] = at_values(self, self.b + 1j * STEP * np.eye(self.n_b)[i])
        return self._at_steps[i]

    @cached_property
    def _at_steps(self) -> dict[int, Self]:
        return {}

    def _total(self, value: Callable[..., Array], *states: tuple[Array, Array]) -> Array:
        """Return the total design derivative of a value, along given derivatives of states.

        `value(system, *states)` must accept complex numbers; every state, shape (n,), comes with
        its derivative, (n, n_b). The value has shape (m,), the result (m, n_b).
        """
        columns = [
            np.imag(value(self._at_step(i), *(x + 1j * STEP * x_b[:, i] for x, x_b in states)))
            for i in range(self.n_b)
        ]
        if not columns:
            return np.zeros((len(value(self, *(x for x, _ in states))), 0))
        return np.asarray(np.array(columns).T / STEP)

    def _by_coordinate(
        self,
        value: Callable[[Array], Array],
        x: Array,
        pattern: SparsityPattern,
        *beside: Array | None,
    ) -> Array:
        """Return the derivative of a value in x by complex steps, on a pattern, shape (nnz,).

        The imaginary part of the value at x, for complex x, b or other arguments `beside`, is
        subtracted.
        """
        rows = np.array([np.imag(value(y)) for y in x + 1j * STEP * np.eye(self.n_q)])
        if any(y is not None and y.dtype.kind == "c" for y in (self.b, x, *beside)):
            rows -= np.imag(value(x))
        return np.asarray(rows[pattern.columns, pattern.rows] / STEP)


def at_values(system: _System, b: Array) -> _System:
    """Return `system.with_values(b)`; raise InvalidInputError if the result has another b."""
    other = system.with_values(b)
    if not np.array_equal(other.b, b):
        raise InvalidInputError(f"{type(system).__name__}.with_values", *FORGOTTEN)
    return other
