"""Formulas of vectors: what stands for an array in them, and helpers for (..., n_vectors, d).

A formula that is written with these runs on arrays of numbers, and on `Carried` arrays, which
list its operations or bound its values.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import Array

# Functions of one number that have derivatives, for messages.
_KNOWN = "exp, log, sqrt, sin, cos, tan, sinh, cosh, tanh, square, reciprocal, arctan"


class StandIn(abc.ABC):
    """Stand-in for numbers in a formula, with functions that NumPy does not have."""

    __slots__ = ()

    @abc.abstractmethod
    def angle(self, x: Any) -> Any:
        """Return the angle of (x, self)."""

    @abc.abstractmethod
    def positive(self) -> Any:
        """Return the numbers where they are positive, else 0."""

    @abc.abstractmethod
    def step(self) -> Any:
        """Return 1 where they are positive, else 0."""


class Carried(NDArrayOperatorsMixin, StandIn):
    """Stand-in for an array in a formula: NumPy's operations on it return more of its kind."""

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, ...]:
        """Shape of the array that this object stands for."""

    @abc.abstractmethod
    def sum(self, axis: int, keepdims: bool = False) -> Any:
        """Return the sum over an axis."""

    @abc.abstractmethod
    def joined(self, parts: Sequence[Any], join: Callable[[Sequence[Array]], Array]) -> Any:
        """Apply a function of NumPy to a sequence of arrays, at least one of this kind.

        The function places entries and does not calculate with them, as np.stack does.
        """

    def __array_function__(
        self, function: Any, types: Any, args: tuple[Any, ...], named: dict[str, Any]
    ) -> Any:
        """Apply a function of NumPy on whole arrays; InvalidInputError for all but a few.

        Others would take it for an array of one entry, and calculate entry by entry.
        """
        if function in _JOINS:
            return self.joined(args[0], lambda x: np.asarray(function(x, *args[1:], **named)))
        if function is np.shape:
            return self.shape
        if function is np.zeros_like:
            return np.zeros(self.shape)
        along = named.get("axis") is not None and named.keys() <= {"axis", "keepdims"}
        if function is np.sum and len(args) == 1 and along:
            return self.sum(**named)
        raise InvalidInputError(
            f"numpy.{function.__name__}",
            "must be a function that formulas of vectors know",
            "one that they do not",
            "Write it with arithmetic, elementary functions, np.sum over an axis, np.stack and "
            "np.concatenate, or with dot and cross of ancfdae.extend: the length of e is "
            "np.sqrt(dot(e, e)).",
        )


_JOINS = (np.concatenate, np.stack, np.vstack, np.hstack)


def without_derivatives(ufunc: np.ufunc) -> InvalidInputError:
    """Return the error for a function that nothing here is carried through."""
    return InvalidInputError(
        f"numpy.{ufunc.__name__}",
        "must have derivatives where a law, a force or a joint is made of it",
        "a function that has none here",
        f"Use arithmetic and {_KNOWN} of NumPy, for the size of x np.sqrt(x**2 + e**2) with a "
        "small e; laws in pieces are joined by Transition.",
    )


# -- vectors, (..., n_vectors, d) --------------------------------------------------------------


def dot(a: Any, b: Any) -> Any:
    """Return a . b over the last axis, which is kept."""
    return (a * b).sum(axis=-1, keepdims=True)


def cross(a: Any, b: Any) -> Any:
    """Return a x b of spatial vectors."""
    return a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT]


def direction(e: Any) -> tuple[Any, Any]:
    """Return the length l of vectors, shape (..., 1), and n = e / l."""
    l = np.sqrt(dot(e, e))
    return l, e / l


def angle(y: Any, x: Any) -> Any:
    """Return the angle of (x, y), rad; complex x and y must be real except for a tiny step."""
    if isinstance(y, StandIn):
        return y.angle(x)
    size = x.real**2 + y.real**2
    turned = (x.real * y.imag - y.real * x.imag) / size
    value = np.arctan2(y.real, x.real)
    return value + 1j * turned if np.iscomplexobj(x) or np.iscomplexobj(y) else value


def positive(x: Any) -> Any:
    """Return x where its real part is positive, else 0, for numbers, arrays and symbols.

    The derivative is 1 or 0; at x = 0, where none exists, it is 0. Formulas with kinks are written
    with it: |x| = positive(x) + positive(-x), the larger of x and y = y + positive(x - y).
    """
    if isinstance(x, StandIn):
        return x.positive()
    if isinstance(x, np.ndarray) and x.dtype == object:
        return _POSITIVE_ENTRIES(x)
    return np.where(np.real(x) <= 0, 0.0, x)[()]


def step(x: Any) -> Any:
    """Return 1 where the real part of x is positive, else 0."""
    return x.step() if isinstance(x, StandIn) else np.where(np.real(x) <= 0, 0.0, 1.0)


def concatenate(parts: Sequence[Any]) -> Any:
    """Return one list of vectors out of several, (..., n_1 + n_2 + ..., d)."""
    return np.concatenate(parts, axis=-2)


# Of arrays of symbols, entry by entry.
_POSITIVE_ENTRIES = np.frompyfunc(positive, 1, 1)
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
