"""Formulas of NumPy as lists of operations on single numbers, which a kernel evaluates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.numerics.jets import Carried, without_derivatives

#: In the order of `kernels/load_plan.h`; the one left out is the angle of two numbers.
_ANGLE = "angle"
_OF_TWO = (np.add, np.subtract, np.multiply, np.divide, _ANGLE, np.power)
_OF_ONE = (np.negative, np.sqrt, np.exp, np.log, np.sin, np.cos, np.tan, np.sinh, np.cosh, np.tanh)
_CODES: dict[Any, int] = {
    function: code
    for code, function in enumerate((*_OF_TWO, *_OF_ONE, np.arctan, np.square, np.reciprocal))
}


@final
class Operations:
    """A list of operations on `n_inputs` inputs and on constants.

    Numbers are inputs, from 0 on, results, from `n_inputs` on, and constants, from -1 down.
    """

    def __init__(self, n_inputs: int) -> None:
        self._n_inputs = n_inputs
        self._constants: list[Any] = []
        self._known: dict[tuple[Any, ...], int] = {}
        self._list: list[tuple[int, int, int]] = []

    def constant(self, value: Any) -> int:
        """Return the number of a constant."""
        key = "constant", complex(value)
        if key not in self._known:
            self._constants.append(value)
            self._known[key] = -len(self._constants)
        return self._known[key]

    def apply(self, function: Any, *numbers: int) -> int:
        """Return the number of the result of a function of numbered operands.

        An operation that is in the list already is not listed again; one on constants is computed.
        """
        constants = [self._constants[-n - 1] if n < 0 else None for n in numbers]
        if all(x is not None for x in constants) and function is not _ANGLE:
            return self.constant(function(*constants))
        short = _shortened(function, numbers, constants)
        if short is not None:
            return self.constant(0.0) if short == _NOTHING else numbers[short]
        key = function, *numbers
        if key not in self._known:
            self._list.append((_CODES[function], numbers[0], numbers[-1]))
            self._known[key] = self._n_inputs + len(self._list) - 1
        return self._known[key]

    def arrays(self, results: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return constants, operations with both their numbers, and results.

        Numbers are counted in the order of inputs, constants and results of operations.
        """
        n, ahead = self._n_inputs, len(self._constants)

        def counted(numbers: Array) -> Array:
            behind = np.where(numbers < n, numbers, numbers + ahead)
            return np.where(numbers < 0, n - 1 - numbers, behind).astype(np.int32)

        op, a, b = np.array(self._list, dtype=np.int64).reshape(-1, 3).T
        constants = np.array(self._constants or np.zeros(0))
        return constants, op.astype(np.int32), counted(a), counted(b), counted(results)


_NOTHING = -1


def _shortened(function: Any, numbers: Sequence[int], constants: Sequence[Any]) -> int | None:
    """Return which argument is the result already, or that it is zero; None if neither."""
    first, last = constants[0], constants[-1]
    if function is np.multiply:
        for one, other in ((first, 1), (last, 0)):
            if one is not None and one == 0:
                return _NOTHING
            if one is not None and one == 1:
                return other
    if function is np.add and first is not None and first == 0:
        return 1
    if function in (np.add, np.subtract) and last is not None and last == 0:
        return 0
    if function is np.divide and first is not None and first == 0:
        return _NOTHING
    return None


@final
class Listed(Carried):
    """An array of numbers whose operations are listed, those that jets have."""

    def __init__(self, operations: Operations, at: Array) -> None:
        self._operations, self.at = operations, at

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array of operation numbers."""
        return self.at.shape

    def __getitem__(self, key: Any) -> Listed:
        return Listed(self._operations, self.at[key])

    def sum(self, axis: int, keepdims: bool = False) -> Listed:
        """Return the sum over an axis."""
        first, *others = np.moveaxis(self.at, axis, 0)
        total = Listed(self._operations, np.asarray(first))
        for other in others:
            total = total._apply(np.add, total, Listed(self._operations, np.asarray(other)))
        return total[np.newaxis].moved(axis, self.at.ndim) if keepdims else total

    def moved(self, axis: int, n: int) -> Listed:
        """Return the array of n axes whose first one comes at another place."""
        return Listed(self._operations, np.moveaxis(self.at, 0, axis % n))

    def angle(self, x: Any) -> Listed:
        """Return the angle of (x, self)."""
        return self._apply(_ANGLE, self, x)

    def joined(self, parts: Sequence[Any]) -> Listed:
        """Return lists as one list of vectors."""
        return Listed(self._operations, np.concatenate([self.numbers(x) for x in parts], axis=-2))

    def numbers(self, x: Any) -> Array:
        """Return the numbers of an array, whose entries are constants unless it is of this kind."""
        if isinstance(x, Listed):
            return x.at
        values = np.asarray(x)
        constants = [self._operations.constant(value) for value in values.ravel().tolist()]
        return np.array(constants, dtype=np.int64).reshape(values.shape)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        """List a function of NumPy.

        InvalidInput for a function without derivatives.
        """
        plain = method == "__call__" and not kwargs
        if plain and ufunc is np.matmul:
            a, b = (Listed(self._operations, self.numbers(x)) for x in inputs)
            return (a[..., :, :, None] * b[..., None, :, :]).sum(axis=-2)
        if plain and ufunc is np.positive:
            return self
        if plain and ufunc is np.power and isinstance(inputs[1], Listed):
            return np.exp(inputs[1] * self._apply(np.log, inputs[0]))
        if plain and ufunc in _CODES:
            return self._apply(ufunc, *inputs)
        raise without_derivatives(ufunc)

    def _apply(self, function: Any, *inputs: Any) -> Listed:
        arrays = np.broadcast_arrays(*(self.numbers(x) for x in inputs))
        rows = zip(*(x.ravel().tolist() for x in arrays), strict=True)
        results = [self._operations.apply(function, *row) for row in rows]
        return Listed(self._operations, np.array(results, dtype=np.int64).reshape(arrays[0].shape))
