"""Interval arithmetic: bounds of a list of operations whose inputs lie in intervals.

Every operation maps the intervals of its arguments to one that holds all its values there, for many
boxes of inputs at once. Bounds of a sum or a product are too wide where arguments depend on each
other, but never too narrow, up to round-off, however sharply the functions change: a peak between
two samples cannot be missed. An unknown result is the whole real line.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.numerics.operations import ANGLE, POSITIVE, STEP, Operations
from ancfdae.numerics.vector_formulas import positive, step

_HALF_TURN: Final = np.pi


class Interval(NamedTuple):
    """Lower and upper ends of intervals, arrays of one shape."""

    low: Array
    high: Array


def values(operations: Operations, outputs: Array, inputs: Mapping[int, Any]) -> Array:
    """Return values of outputs, shape (len(outputs), k), at k values of their inputs."""
    return np.stack(_walked(operations, outputs, inputs, lambda x: x, _value))


def enclosed(
    operations: Operations, outputs: Array, inputs: Mapping[int, Interval]
) -> tuple[Array, Array]:
    """Return lower and upper bounds of outputs, each (len(outputs), k), in k boxes of inputs."""
    found = _walked(operations, outputs, inputs, lambda x: Interval(x, x), _bounds)
    low, high = (np.stack(x) for x in zip(*found, strict=True))
    return low, high


def _walked(
    operations: Operations,
    outputs: Array,
    inputs: Mapping[int, Any],
    constant: Callable[[Array], Any],
    apply: Callable[..., Any],
) -> list[Any]:
    """Return `outputs` by applying, in their order, the operations that they need."""
    known, flat = dict(inputs), outputs.ravel().tolist()
    first = next(iter(inputs.values()))
    one = np.ones(np.shape(first[0] if isinstance(first, Interval) else first))

    def of(number: int) -> Any:
        if number < 0 and number not in known:
            known[number] = constant(float(operations.value(number)) * one)
        return known[number]

    with np.errstate(all="ignore"):
        for number, function, x, y in operations.rows(outputs):
            known[number] = apply(function, of(x), of(y), x == y)
    return [of(x) for x in flat]


def _value(function: Any, x: Array, y: Array, same: bool) -> Array:
    if function is ANGLE:
        return np.arctan2(x, y)
    if function in _OF_SIGN:
        return np.asarray(_OF_SIGN[function](x))
    return np.asarray(function(x, y) if function in _OF_TWO else function(x))


def _bounds(function: Any, x: Interval, y: Interval, same: bool) -> Interval:
    if function is np.multiply and same:
        return _square(x)
    if function in _OF_TWO:
        low, high = _OF_TWO[function](x, y)
    elif function in _RISING:
        low, high = function(x.low), function(x.high)
    elif function in _OF_SIGN:
        low, high = _OF_SIGN[function](x.low), _OF_SIGN[function](x.high)
    else:
        low, high = _OF_ONE[function](x)
    unknown = np.isnan(low) | np.isnan(high)
    return Interval(np.where(unknown, -np.inf, low), np.where(unknown, np.inf, high))


def _ends(rows: Sequence[Array]) -> Interval:
    return Interval(np.min(rows, axis=0), np.max(rows, axis=0))


def _product(x: Interval, y: Interval) -> Interval:
    return _ends([a * b for a in x for b in y])


def _reciprocal(x: Interval) -> Interval:
    through = (x.low <= 0) & (x.high >= 0)
    low, high = 1 / x.high, 1 / x.low
    return Interval(np.where(through, -np.inf, low), np.where(through, np.inf, high))


def _square(x: Interval) -> Interval:
    low, high = _ends([x.low**2, x.high**2])
    return Interval(np.where((x.low <= 0) & (x.high >= 0), 0.0, low), high)


def _cosh(x: Interval) -> Interval:
    low, high = _ends([np.cosh(x.low), np.cosh(x.high)])
    return Interval(np.where((x.low <= 0) & (x.high >= 0), 1.0, low), high)


def _power(x: Interval, y: Interval) -> Interval:
    """Bound x^c for a constant c that is not an integer, and positive x."""
    return _ends([x.low**y.low, x.high**y.low])


def _wave(x: Interval, shift: float) -> Interval:
    """Bound cos(x - shift) over intervals of x."""
    low, high = x.low - shift, x.high - shift
    least, most = _ends([np.cos(low), np.cos(high)])
    turns_high = np.floor(high / (2 * _HALF_TURN)) > np.floor(low / (2 * _HALF_TURN))
    half = (low - _HALF_TURN) / (2 * _HALF_TURN), (high - _HALF_TURN) / (2 * _HALF_TURN)
    turns_low = np.floor(half[1]) > np.floor(half[0])
    return Interval(np.where(turns_low, -1.0, least), np.where(turns_high, 1.0, most))


def _tan(x: Interval) -> Interval:
    branch = [np.floor(end / _HALF_TURN + 0.5) for end in x]
    apart = branch[0] != branch[1]
    low, high = np.tan(x.low), np.tan(x.high)
    return Interval(np.where(apart, -np.inf, low), np.where(apart, np.inf, high))


def _angle(y: Interval, x: Interval) -> Interval:
    """Bound the angle of (x, y) by its corners, unless the cut or the origin is inside."""
    low, high = _ends([np.arctan2(a, b) for a in y for b in x])
    cut = (x.low <= 0) & (y.low <= 0) & (y.high >= 0)
    return Interval(np.where(cut, -_HALF_TURN, low), np.where(cut, _HALF_TURN, high))


_RISING: Final = (np.sqrt, np.exp, np.log, np.sinh, np.tanh, np.arctan)
_OF_TWO: Final[dict[Any, Callable[[Interval, Interval], Interval]]] = {
    np.add: lambda x, y: Interval(x.low + y.low, x.high + y.high),
    np.subtract: lambda x, y: Interval(x.low - y.high, x.high - y.low),
    np.multiply: _product,
    np.divide: lambda x, y: _product(x, _reciprocal(y)),
    np.power: _power,
    ANGLE: _angle,
}
_OF_SIGN: Final = {POSITIVE: positive, STEP: step}
_OF_ONE: Final[dict[Any, Callable[[Interval], Interval]]] = {
    np.negative: lambda x: Interval(-x.high, -x.low),
    np.sin: lambda x: _wave(x, _HALF_TURN / 2),
    np.cos: lambda x: _wave(x, 0.0),
    np.tan: _tan,
    np.cosh: _cosh,
    np.square: _square,
    np.reciprocal: _reciprocal,
}
