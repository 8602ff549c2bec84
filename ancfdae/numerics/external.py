"""User functions that formulas call as they are (a table, a tyre model), with derivatives.

A list of operations (`ancfdae.numerics.operations`) calls such a function f of n numbers for its
value. Derivatives along directions d are calls as well:

    f'(x) d                  partials of the user times d, or a complex step of f
    f''(x) (d, e), ...       partials of these partials, or means over circles in the complex plane

Partials of a user are a formula: they are traced, and called if that fails. At complex numbers x +
i y, where y is a perturbation, a function with partials of its own is f(x) + i f'(x) y.

Higher derivatives of analytic functions follow from their values on a circle (Cauchy): the
coefficient of z^r in f is the mean of f(z) z^-r over a circle |z| = rho. From N points its error is
(rho/R)^N with the radius R of convergence, and round-off over rho^r. A circle is small enough if
the coefficient of half the order N is small; of these circles the one with the least round-off is
used.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import Any, final

import numpy as np

from ancfdae.errors.checks import require_count, require_function
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.complex_step import FAILURES, scaled_derivative
from ancfdae.numerics.operations import NotTraceable, Operations, Traced
from ancfdae.numerics.vector_formulas import Carried

# Number of points on a circle, and its upper half, which suffices: f(conj z) = conj f(z).
_POINTS = 16
_UPPER = np.exp(2j * np.pi * np.arange(_POINTS // 2 + 1) / _POINTS)
# First radius, for functions that vary over arguments of the order of one; factor between radii,
# and largest number of radii.
_RADIUS, _FACTOR, _TRIALS = 0.125, 4.0, 8
# Largest ratio of the middle coefficient to the largest one, in powers of the radius.
_SMALL = 1e-7


def coefficient(f: Callable[[complex], Array], order: int) -> Array:
    """Return f^(r)(0) / r! for r = `order` <= 4, of the shape of f, which is real at real numbers.

    If f is analytic on no circle tried, the circle with the smallest middle coefficient is used.
    """
    best, error, least, radius = np.zeros(()), np.array(np.inf), np.inf, _RADIUS
    with np.errstate(all="ignore"):
        for _ in range(_TRIALS):
            upper = np.array([f(radius * z) for z in _UPPER.tolist()])
            values = np.concatenate([upper, np.conj(upper[-2:0:-1])])
            parts = np.fft.fft(values, axis=0).real / _POINTS
            size = np.max(np.abs(parts), axis=0)
            middle = np.abs(parts[_POINTS // 2 - 1 : _POINTS // 2 + 1]).max(axis=0)
            share = np.max(middle / np.where(size > 0, size, 1.0), initial=0.0)
            found, round_off = parts[order] / radius**order, size / radius**order
            if share <= _SMALL:
                better = round_off < 0.5 * error
                best, error = np.where(better, found, best), np.minimum(error, round_off)
                if _SMALL < least < np.inf or not np.any(better):
                    break  # Shrunk so far, or round-off is least.
                least, radius = 0.0, radius * _FACTOR
            elif least <= _SMALL:
                break
            else:
                if share < least or np.ndim(best) == 0:
                    best, least = found, min(share, 1.0)
                radius /= _FACTOR
    return best


@final
class ExternalFunction:
    """A function of numbers for the formulas of a system, called where it cannot be traced.

    Parameters
    ----------
    function : callable
        Smooth function of n numbers that returns a number, or `size` numbers. Without `derivative`
        it must accept complex numbers, and is differentiated by complex steps.
    derivative : callable, optional
        Takes the same numbers and returns the partials, shape (n,), or (size, n); a number if both
        are one. Second derivatives follow from its operations if it is written in functions of
        NumPy, from its own `derivative` if it is an `ExternalFunction`, and else from differences,
        good to about 1e-10.
    size : int, optional
        Length of the array that the function returns; by default it returns a number.

    Raises
    ------
    InvalidInputError
        If the function is not callable, or later, if it or its derivative returns another number of
        values, or if it has no derivative and rejects complex numbers.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        derivative: Callable[..., Any] | None = None,
        *,
        size: int | None = None,
    ) -> None:
        require_function("ExternalFunction, function", function)
        if derivative is not None:
            require_function("ExternalFunction, derivative", derivative)
        if size is not None:
            require_count("ExternalFunction.size", size, "Omit it for one value.")
        self.function, self.derivative, self.size = function, derivative, size
        self._called: dict[int, Called] = {}

    def __call__(self, *x: Any) -> Any:
        """Return the value at numbers or symbols; for arrays, entry by entry."""
        if any(isinstance(y, Carried) for y in x):
            raise InvalidInputError(
                f"ExternalFunction({_name(self.function)})",
                "must be called in a formula of a FormulaSystem, a FormulaJoint or an observable",
                "a formula of a load, a law or another joint",
                "Write it out with functions of NumPy there.",
            )
        arrays = np.broadcast_arrays(*(np.asarray(y) for y in x))
        rows = np.stack(arrays, axis=-1).reshape(-1, len(x))
        called = self._called.setdefault(len(x), Called(_Rows(self, len(x)), self.size or 1, self))
        if rows.dtype == object:
            values = np.array([_traced(called, row) for row in rows])
        else:
            values = called(rows)
        shape = arrays[0].shape + (() if self.size is None else (self.size,))
        return values.reshape(shape)[()]

    def partials(self, n: int, x: Sequence[Any] | Array) -> Array:
        """Return the user's partials at n numbers or symbols, shape (size or 1, n)."""
        assert self.derivative is not None
        found = np.asarray(self.derivative(*x))
        if found.size != (self.size or 1) * n:
            where, shape = _name(self.derivative), (self.size or 1, n)
            raise InvalidInputError(
                f"{where}, derivative",
                f"must return partials of shape {shape}",
                found.shape,
                "Return a row of partials for each value.",
            )
        return found.reshape(self.size or 1, n)


def _name(function: Any) -> str:
    return str(getattr(function, "__name__", type(function).__name__))


def _traced(called: Called, row: Array) -> Array:
    (operations,) = {id(y.operations): y.operations for y in row if isinstance(y, Traced)}.values()
    numbers = Traced.numbers(operations, row).tolist()
    return Traced.array(operations, operations.call(called, numbers))


@final
@dataclass(frozen=True)
class _Rows:
    """An `ExternalFunction` of n numbers as a function of a row (n,), with values (size,)."""

    of: ExternalFunction
    n: int

    def __call__(self, x: Array) -> Array:
        found = np.asarray(self.of.function(*x))
        if found.size != (self.of.size or 1):
            raise InvalidInputError(
                f"ExternalFunction({_name(self.of.function)})",
                f"must return {self.of.size or 'one'} number(s), as `size` says",
                found.shape,
                "Give the length of the array that it returns as `size`.",
            )
        return found.reshape(-1)

    @property
    def name(self) -> str:
        return _name(self.of.function)


@final
@dataclass(frozen=True)
class _Partials:
    """The user's partials of a function as a function of a row of numbers, (size n,)."""

    of: ExternalFunction

    def __call__(self, x: Array) -> Array:
        return self.of.partials(len(x), x.tolist()).ravel()


@final
class Called:
    """A function, or its derivative along `order` directions, as a list of operations calls it.

    It takes rows of x and of the directions behind it, (k, n (1 + order)), and returns (k, size).
    `real` partials of a user are differentiated by differences if they reject complex numbers.
    """

    def __init__(
        self,
        function: Callable[[Array], Array],
        size: int,
        external: ExternalFunction | None = None,
        order: int = 0,
        real: bool = False,
    ) -> None:
        self.function, self.size, self._external = function, size, external
        self._order, self._real = order, real

    @cached_property
    def next(self) -> Called:
        """The derivative of this called function along one more direction."""
        return Called(self.function, self.size, self._external, self._order + 1, self._real)

    @cached_property
    def _of_partials(self) -> Called:
        """The user's partials as a called function, where they cannot be traced."""
        assert self._external is not None
        n = self.function.n  # type: ignore[attr-defined]
        return Called(_Partials(self._external), self.size * n, real=True)

    @property
    def _by_partials(self) -> bool:
        return self._external is not None and self._external.derivative is not None

    # -- as operations ---------------------------------------------------------------------------

    def rates(
        self, operations: Operations, numbers: Sequence[int], rates: Mapping[int, int]
    ) -> Array | None:
        """Return the numbers, (size,), of rates of the values from rates of inputs, or None.

        None means that no input changes.
        """
        x, *along = self._parts(list(numbers))
        zero, found = operations.constant(0.0), list[Array]()
        dx, *moved = ([rates.get(y, zero) for y in part] for part in (x, *along))
        if any(y != zero for y in dx):
            if self._by_partials:
                partials = self._partials(operations, x)
                found.append(partials @ Traced.array(operations, np.array(dx)))
            else:
                directions = sorted([*along, dx])
                found.append(self._symbols(operations, self.next, x, directions))
        for i, d in enumerate(moved):
            if any(y != zero for y in d):
                directions = sorted([*along[:i], d, *along[i + 1 :]])
                found.append(self._symbols(operations, self, x, directions))
        return Traced.numbers(operations, sum(found[1:], found[0])) if found else None

    @staticmethod
    def _symbols(
        operations: Operations, of: Called, x: Sequence[int], directions: Sequence[Sequence[int]]
    ) -> Array:
        numbers = [*x, *(y for d in directions for y in d)]
        return Traced.array(operations, operations.call(of, numbers))

    def _partials(self, operations: Operations, x: Sequence[int]) -> Array:
        """Return symbols of the user's partials, (size, n); called if they cannot be traced."""
        assert self._external is not None
        symbols = Traced.array(operations, np.array(x))
        try:
            return np.asarray(self._external.partials(len(x), symbols), dtype=object)
        except InvalidInputError:
            raise
        except (NotTraceable, *FAILURES):
            called = self._symbols(operations, self._of_partials, x, [])
            return called.reshape(self.size, len(x))

    def _parts(self, row: Any) -> list[Any]:
        n = len(row) // (1 + self._order)
        return [row[i * n : (i + 1) * n] for i in range(1 + self._order)]

    # -- as numbers ------------------------------------------------------------------------------

    def __call__(self, rows: Array) -> Array:
        """Return the values at the rows, real or complex, shape (k, size)."""
        values = np.empty((len(rows), self.size), dtype=rows.dtype)
        for value, row in zip(values, rows, strict=True):
            x, *along = self._parts(row)
            value[:] = self._at(x, along)
        return values

    def _at(self, x: Array, along: list[Array]) -> Array:
        if x.dtype == complex and (along or self._by_partials or self._real):
            return self._perturbed(x, along)
        if not along:
            return self.function(x)
        if not all(map(np.any, along)):
            return np.zeros(self.size)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", np.exceptions.ComplexWarning)
                if len(along) > 1:
                    return self._on_circles(x, along)
                return np.asarray(np.imag(self.function(x + 1j * STEP * along[0])) / STEP)
        except (TypeError, np.exceptions.ComplexWarning) as error:
            if self._real:
                *others, d = along
                size = _size(x, d)
                return scaled_derivative(lambda s: self._at(x + s * size * d, others)) / size
            raise InvalidInputError(
                str(getattr(self.function, "name", "a function that formulas call")),
                "must accept complex numbers if it comes without derivatives",
                f"{type(error).__name__}: {error}",
                "Call it as ExternalFunction(function, derivative) (docs/own-systems.md).",
            ) from error

    def _on_circles(self, x: Array, along: list[Array]) -> Array:
        """Return a derivative along r directions from sums and differences of them, (size,).

        The part of f that is linear in each direction is the mean of s_2 ... s_r c_r over all signs
        s, where c_r is the coefficient of z^r in f(x + z (d_1 + s_2 d_2 + ... + s_r d_r)).
        """
        sizes = np.array([_size(x, d) for d in along])
        first, *others = np.array(along) * sizes[:, None]
        total = np.zeros(self.size)
        for signs in product((1.0, -1.0), repeat=len(others)):
            d = first + sum(s * y for s, y in zip(signs, others, strict=True))
            if np.any(d):
                f = partial(self._moved, x, d)
                total += np.prod(signs) * coefficient(f, len(along))
        return total / (2.0 ** len(others) * np.prod(sizes))

    def _moved(self, x: Array, d: Array, z: complex) -> Array:
        return self.function(x + z * d)

    def _perturbed(self, x: Array, along: list[Array]) -> Array:
        """Return the value, (size,), at complex numbers whose imaginary parts are perturbations."""
        real, *directions = (y.real for y in (x, *along))
        value = self._at(real, directions)
        if self._by_partials:
            change = self._external.partials(len(x), real) @ x.imag  # type: ignore[union-attr]
        else:
            change = np.zeros(self.size)
            if np.any(x.imag):
                change = change + self.next._at(real, [*directions, x.imag])
            for i, d in enumerate(along):
                if np.any(d.imag):
                    moved = [*directions[:i], d.imag, *directions[i + 1 :]]
                    change = change + self._at(real, moved)
        return np.asarray(value + 1j * change)


def _size(x: Array, d: Array) -> float:
    """Return the largest entry of x that changes along the direction d, over max |d|."""
    return float(np.max(np.abs(x[d != 0])) or 1.0) / float(np.max(np.abs(d)))
