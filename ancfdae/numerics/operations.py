"""Formulas of NumPy as lists of operations on single numbers, which a kernel evaluates.

Two kinds of tracers write such a list when a formula runs on them. `Listed` stands for a whole
array, in the formulas of loads. `Traced` stands for one number: arrays of dtype object hold
tracers, so that any code of NumPy that moves numbers about and computes with them runs unchanged.

**Derivatives** are more operations of the same list (`Operations.along`). Of an operation
z = f(x, y) it writes z' = f_x x' + f_y y', where x' and y' are numbers of the list as well, zero
for what the direction does not move. What it returns can be differentiated again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn, final

import numpy as np

from ancfdae.kernels import OperationList
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.jets import DERIVATIVES, Carried, without_derivatives

#: The function that is no function of NumPy: the angle of two numbers.
ANGLE = "angle"
# In the order of `kernels/load_plan.h`.
_OF_TWO = (np.add, np.subtract, np.multiply, np.divide, ANGLE, np.power)
_OF_ONE = (np.negative, np.sqrt, np.exp, np.log, np.sin, np.cos, np.tan, np.sinh, np.cosh, np.tanh)
_CODES: dict[Any, int] = {
    function: code
    for code, function in enumerate((*_OF_TWO, *_OF_ONE, np.arctan, np.square, np.reciprocal))
}
# Whole exponents up to this are written as products: a complex step through `power` would lose its
# imaginary part at negative numbers.
_PRODUCTS = 64


@final
class Operations:
    """A list of operations on `n_inputs` inputs and on constants.

    Numbers are inputs, from 0 on, results, from `n_inputs` on, and constants, from -1 down.
    """

    def __init__(self, n_inputs: int) -> None:
        self._n_inputs = n_inputs
        self._constants: list[Any] = []
        self._known: dict[tuple[Any, ...], int] = {}
        self._list: list[tuple[Any, int, int]] = []

    def constant(self, value: Any) -> int:
        """Return the number of a constant."""
        key = "constant", complex(value)
        if key not in self._known:
            self._constants.append(value)
            self._known[key] = -len(self._constants)
        return self._known[key]

    def value(self, number: int) -> Any:
        """Return the value of a constant."""
        return self._constants[-number - 1]

    def apply(self, function: Any, *numbers: int) -> int:
        """Return the number of a result; what is known already is not listed again."""
        key = function, *numbers
        known = self._known.get(key)
        if known is not None:
            return known
        constants = [self.value(n) if n < 0 else None for n in numbers]
        if all(x is not None for x in constants) and function is not ANGLE:
            return self.constant(function(*constants))
        short = _shortened(function, numbers, constants)
        if short is not None:
            return self.constant(0.0) if short == _NOTHING else numbers[short]
        self._list.append((function, numbers[0], numbers[-1]))
        self._known[key] = self._n_inputs + len(self._list) - 1
        return self._known[key]

    def along(self, outputs: Array, *directions: Mapping[int, int]) -> list[Array]:
        """Return numbers of the derivatives of outputs along each direction.

        A direction maps inputs to the numbers at which they change; other inputs are held.
        """
        needed, zero = self._needed(outputs), self.constant(0.0)
        before, found = self._n_inputs, []
        for direction in directions:
            rates = dict(direction)
            for k in needed:
                function, x, y = self._list[k]
                if x not in rates and y not in rates:
                    continue
                dx, dy = rates.get(x, zero), rates.get(y, zero)
                rate = self._rate(function, (x, y, before + k), dx, dy)
                if rate != zero:
                    rates[before + k] = rate
            flat = [rates.get(x, zero) for x in outputs.ravel().tolist()]
            found.append(np.array(flat, dtype=np.int64).reshape(outputs.shape))
        return found

    def _rate(self, function: Any, numbers: tuple[int, int, int], dx: int, dy: int) -> int:
        """Return the derivative of z = f(x, y) from those of x and y."""
        if function is np.negative:
            return self.apply(np.negative, dx)
        x, y, z, x_, y_ = (Traced(self, at) for at in (*numbers, dx, dy))
        if function in _RATES:
            return _RATES[function](x, y, z, x_, y_).at
        first: Traced = DERIVATIVES[function][0](x, z) * x_
        return first.at

    def inputs(self, outputs: Array) -> set[int]:
        """Return the inputs that outputs follow from."""
        rows = (self._list[k] for k in self._needed(outputs))
        used = {x for row in rows for x in row[1:]}.union(outputs.ravel().tolist())
        return {x for x in used if 0 <= x < self._n_inputs}

    def rows(self, outputs: Array) -> list[tuple[int, Any, int, int]]:
        """Return the operations that outputs follow from: numbers, functions and arguments."""
        return [(self._n_inputs + k, *self._list[k]) for k in self._needed(outputs)]

    def _needed(self, outputs: Array) -> list[int]:
        """Return the operations that outputs follow from, in their order."""
        n, found, waiting = self._n_inputs, set[int](), set(outputs.ravel().tolist())
        while waiting:
            k = waiting.pop() - n
            if k >= 0 and k not in found:
                found.add(k)
                waiting.update(self._list[k][1:])
        return sorted(found)

    def arrays(
        self, results: Array, inputs: Sequence[int] | None = None
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Return constants, operations with both their numbers, and results.

        Numbers are counted in the order of inputs, constants and results of operations. Inputs are
        all, or those given; what results do not follow from is left out.
        """
        needed, flat = self._needed(results), results.ravel().tolist()
        rows = [self._list[k] for k in needed]
        used = {x for row in rows for x in row[1:]} | set(flat)
        kept = sorted((x for x in used if x < 0), reverse=True)
        ahead = range(self._n_inputs) if inputs is None else inputs
        numbers = [*ahead, *kept, *(self._n_inputs + k for k in needed)]
        place = {number: i for i, number in enumerate(numbers)}
        triples = [(_CODES[function], place[x], place[y]) for function, x, y in rows]
        op, a, b = np.array(triples, dtype=np.int32).reshape(-1, 3).T
        constants = np.array([self._constants[-x - 1] for x in kept] or np.zeros(0))
        return constants, op, a, b, np.array([place[x] for x in flat], dtype=np.int32)

    def compiled(self, outputs: Array, inputs: Sequence[int]) -> OperationList:
        """Return what evaluates real outputs at given inputs; outputs follow from no other."""
        constants, *indices = self.arrays(outputs, inputs)
        return OperationList(len(inputs), constants.astype(float), *indices)


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
    if function is np.divide and last is not None and last == 1:
        return 0
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
        return self._apply(ANGLE, self, x)

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

        InvalidInputError for a function without derivatives.
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


# -- single numbers ----------------------------------------------------------------------------


@final
class NotTraceable(Exception):
    """Raised by a tracer where a formula needs a number; it says what was asked."""


@final
class Traced:
    """A number whose operations are listed; arrays of NumPy of dtype object hold such numbers.

    NumPy calls methods of the names of its functions on the entries of such arrays.
    """

    __slots__ = ("_operations", "at")
    #: Kind of the arrays that hold it, so that `np.result_type` knows.
    dtype = np.dtype(object)

    def __init__(self, operations: Operations, at: int) -> None:
        self._operations, self.at = operations, at

    @staticmethod
    def array(operations: Operations, at: Array) -> Array:
        """Return an array of tracers of numbers of the list."""
        out = np.empty(at.shape, dtype=object)
        out.ravel()[:] = [Traced(operations, x) for x in at.ravel().tolist()]
        return out

    @staticmethod
    def numbers(operations: Operations, values: Any) -> Array:
        """Return the numbers of an array or of lists of tracers and constants."""
        x = np.asarray(values)
        flat = [_number(operations, y) for y in x.ravel().tolist()]
        return np.array(flat, dtype=np.int64).reshape(x.shape)

    def _of(self, function: Any, *others: Any) -> Any:
        if isinstance(others[0], np.ndarray) or isinstance(others[-1], np.ndarray):
            return NotImplemented  # Arrays take their entries one by one.
        operations = self._operations
        numbers = (_number(operations, x) for x in others)
        return Traced(operations, operations.apply(function, *numbers))

    @property
    def value(self) -> float:
        """The value of a constant."""
        return self._operations.value(self.at)

    # Arithmetic.

    def __add__(self, other: Any) -> Any:
        return self._of(np.add, self, other)

    def __radd__(self, other: Any) -> Any:
        return self._of(np.add, other, self)

    def __sub__(self, other: Any) -> Any:
        return self._of(np.subtract, self, other)

    def __rsub__(self, other: Any) -> Any:
        return self._of(np.subtract, other, self)

    def __mul__(self, other: Any) -> Any:
        return self._of(np.multiply, self, other)

    def __rmul__(self, other: Any) -> Any:
        return self._of(np.multiply, other, self)

    def __truediv__(self, other: Any) -> Any:
        return self._of(np.divide, self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self._of(np.divide, other, self)

    def __neg__(self) -> Any:
        return self._of(np.negative, self)

    def __pos__(self) -> Any:
        return self

    def __pow__(self, exponent: Any) -> Any:
        if isinstance(exponent, Traced):
            return (exponent * self.log()).exp()
        if isinstance(exponent, np.ndarray):
            return NotImplemented
        n = float(exponent)
        if n == 0.5:
            return self.sqrt()
        if not n.is_integer() or abs(n) > _PRODUCTS:
            return self._of(np.power, self, n)
        if n < 0:
            return 1.0 / self ** (-n)
        if n < 2:
            return self if n == 1 else Traced(self._operations, self._operations.constant(1.0))
        half = self ** (n // 2)
        whole = half._of(np.square, half)
        return whole * self if n % 2 else whole

    def __rpow__(self, base: Any) -> Any:
        return (self * np.log(float(base))).exp()

    # Functions.

    def sqrt(self) -> Traced:  # noqa: D102 - NumPy's names, here and below
        return self._of(np.sqrt, self)

    def exp(self) -> Traced:  # noqa: D102
        return self._of(np.exp, self)

    def log(self) -> Traced:  # noqa: D102
        return self._of(np.log, self)

    def sin(self) -> Traced:  # noqa: D102
        return self._of(np.sin, self)

    def cos(self) -> Traced:  # noqa: D102
        return self._of(np.cos, self)

    def tan(self) -> Traced:  # noqa: D102
        return self._of(np.tan, self)

    def sinh(self) -> Traced:  # noqa: D102
        return self._of(np.sinh, self)

    def cosh(self) -> Traced:  # noqa: D102
        return self._of(np.cosh, self)

    def tanh(self) -> Traced:  # noqa: D102
        return self._of(np.tanh, self)

    def arctan(self) -> Traced:  # noqa: D102
        return self._of(np.arctan, self)

    def arctan2(self, x: Any) -> Traced:  # noqa: D102
        return self._of(ANGLE, self, x)

    def arcsin(self) -> Traced:  # noqa: D102
        return self.arctan2(((1.0 - self) * (1.0 + self)).sqrt())

    def arccos(self) -> Traced:  # noqa: D102
        return ((1.0 - self) * (1.0 + self)).sqrt().arctan2(self)

    def hypot(self, other: Any) -> Traced:  # noqa: D102
        return (self * self + other * other).sqrt()

    # Numbers are real.

    @property
    def real(self) -> Traced:
        """The number."""
        return self

    @property
    def imag(self) -> float:
        """Zero."""
        return 0.0

    def conjugate(self) -> Traced:
        """Return the number."""
        return self

    # What needs its value.

    def __bool__(self) -> bool:
        _refuse("a decision (`if`, `and`, `while`) that depends on the state or on b")

    def __float__(self) -> float:
        _refuse(
            "a number where the state or b only have a symbol: writing into an array of floats "
            "(make it by np.zeros(n, dtype=q.dtype), or return np.array([...])), float(x), or a "
            "function that is not NumPy's (math.sin)"
        )

    __int__ = __index__ = __complex__ = __float__

    def __abs__(self) -> Traced:
        _refuse("abs, which has a kink")

    def __lt__(self, other: object) -> bool:
        _refuse("a comparison of the state or of b (also within np.where, maximum, clip)")

    __le__ = __gt__ = __ge__ = __eq__ = __ne__ = __lt__
    __hash__ = None  # type: ignore[assignment]


def _refuse(what: str) -> NoReturn:
    raise NotTraceable(what)


def _number(operations: Operations, x: Any) -> int:
    """Return the number of a tracer or of a real constant."""
    if isinstance(x, Traced):
        return x.at
    if isinstance(x, complex):
        _refuse("a complex number")
    return operations.constant(float(x))


#: Derivatives of operations of two numbers x and y with the result z, from those of x and y.
_RATES: dict[Any, Callable[[Any, Any, Any, Any, Any], Any]] = {
    np.add: lambda x, y, z, dx, dy: dx + dy,
    np.subtract: lambda x, y, z, dx, dy: dx - dy,
    np.multiply: lambda x, y, z, dx, dy: dx * y + x * dy,
    np.divide: lambda x, y, z, dx, dy: (dx - z * dy) / y,
    ANGLE: lambda x, y, z, dx, dy: (y * dx - x * dy) / (x * x + y * y),
    # Its exponent is a constant.
    np.power: lambda x, y, z, dx, dy: y * x ** (y.value - 1) * dx,
}
