"""Formulas of vectors: stand-ins for arrays in them, and helpers for shape (..., n_vectors, d).

A formula that is written with these helpers runs on arrays of numbers, and on `Carried` arrays,
which list its operations or bound its values.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import Array

# Functions of one number that have derivatives, as listed in messages.
_KNOWN = "exp, log, sqrt, sin, cos, tan, sinh, cosh, tanh, square, reciprocal, arctan"


class StandIn(abc.ABC):
    """Stand-in for numbers in a formula, with functions that NumPy does not have."""

    __slots__ = ()

    @abc.abstractmethod
    def angle(self, x: Any) -> Any:
        """Return the angle of the vectors (x, self); rad."""

    @abc.abstractmethod
    def positive(self) -> Any:
        """Return the numbers where they are positive, else 0."""

    @abc.abstractmethod
    def step(self) -> Any:
        """Return 1 where the numbers are positive, else 0."""


class Carried(NDArrayOperatorsMixin, StandIn):
    """Stand-in for an array in a formula: NumPy's operations on it return further stand-ins."""

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, ...]:
        """Shape of the array that this object stands for."""

    @abc.abstractmethod
    def sum(self, axis: int, keepdims: bool = False) -> Any:
        """Return the sum of the array over an axis, as `numpy.sum` does."""

    @abc.abstractmethod
    def joined(self, parts: Sequence[Any], join: Callable[[Sequence[Array]], Array]) -> Any:
        """Apply a NumPy function such as np.stack to arrays, at least one of them a stand-in.

        The function places entries and does not calculate with them.
        """

    def __array_function__(
        self, function: Any, types: Any, args: tuple[Any, ...], named: dict[str, Any]
    ) -> Any:
        """Apply a NumPy function of whole arrays; InvalidInputError for all but a few functions.

        Other functions would treat the stand-in as an array of one entry.
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
    """Return the error for a NumPy function through which no derivative is carried."""
    return InvalidInputError(
        f"numpy.{ufunc.__name__}",
        "must have derivatives where a law, a force or a joint is made of it",
        "a function that has none here",
        f"Use arithmetic and {_KNOWN} of NumPy, for the size of x np.sqrt(x**2 + e**2) with a "
        "small e; laws in pieces are joined by Transition.",
    )


# -- vectors, (..., n_vectors, d) --------------------------------------------------------------


def dot(a: Any, b: Any) -> Any:
    """Return a . b over the last axis, which is kept, shape (..., 1)."""
    return (a * b).sum(axis=-1, keepdims=True)


def cross(a: Any, b: Any) -> Any:
    """Return a x b of spatial vectors, (..., 3)."""
    return a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT]


def direction(e: Any) -> tuple[Any, Any]:
    """Return the lengths l of vectors e, shape (..., 1), and the unit vectors e / l."""
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
    """Return several lists of vectors as one, shape (..., n_1 + n_2 + ..., d)."""
    return np.concatenate(parts, axis=-2)


# Of arrays of symbols, entry by entry.
_POSITIVE_ENTRIES = np.frompyfunc(positive, 1, 1)
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
