"""Formulas of NumPy as lists of operations on single numbers, which a kernel evaluates.

Two kinds of tracers write such a list when a formula runs on them. `Listed` stands for a whole
array, in the formulas of loads. `Traced` stands for one number: arrays of dtype object hold
tracers, so that any code of NumPy that moves numbers about and computes with them runs unchanged.

**Derivatives** are more operations of the same list (`Operations.along`). Of an operation
z = f(x, y) it writes z' = f_x x' + f_y y', where x' and y' are numbers of the list as well, zero
for what the direction does not move. What it returns can be differentiated again.
"""

from __future__ import annotations

import linecache
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NoReturn, Protocol, final

import numpy as np

from ancfdae.kernels import OperationList
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.complex_step import FAILURES
from ancfdae.numerics.jets import DERIVATIVES, Carried, without_derivatives

#: Functions that are none of NumPy: the angle of two numbers, what is positive of a number and
#: whether it is.
ANGLE, POSITIVE, STEP = "angle", "positive", "step"
# In the order of `kernels/load_plan.h`.
_OF_TWO = (np.add, np.subtract, np.multiply, np.divide, ANGLE, np.power)
_OF_ONE = (np.negative, np.sqrt, np.exp, np.log, np.sin, np.cos, np.tan, np.sinh, np.cosh, np.tanh)
_CODES: dict[Any, int] = {
    function: code
    for code, function in enumerate(
        (*_OF_TWO, *_OF_ONE, np.arctan, np.square, np.reciprocal, POSITIVE, STEP)
    )
}
# Calls of functions that are no operations, and their results.
_CALL, _RESULT = "call", "result"
_CODES |= {_CALL: len(_CODES), _RESULT: len(_CODES) + 1}
# Whole exponents up to this are written as products: a complex step through `power` would lose its
# imaginary part at negative numbers.
_PRODUCTS = 64
# Added to a root, and to the base of a negative power, in derivatives: 0/0 becomes 0, and
# numbers above 1e-134 (1e-184) stay as they are. The derivative of |v| v at v = 0 is then 0.
_ROOT, _RAISED = 1e-150, 1e-200
# Folders whose lines are not a user's.
_OWN = str(Path(np.__file__).parent), str(Path(__file__).parents[1])


class Callee(Protocol):
    """A function that a list calls: rows of inputs, (k, n), give rows of values, (k, size)."""

    @property
    def size(self) -> int:
        """How many numbers it returns."""

    def __call__(self, rows: Array, /) -> Array:
        """Return the values of rows of inputs, shape (k, size)."""

    def rates(
        self, operations: Operations, numbers: Sequence[int], rates: Mapping[int, int]
    ) -> Array | None:
        """Return numbers of the derivatives from rates of the inputs; None if nothing moves."""


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
        self._calls: list[tuple[Callee, tuple[int, ...]]] = []
        #: Roots and powers with broken exponents, with the line of the user's code that takes each.
        self.roots: dict[int, str] = {}

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
        if all(x is not None for x in constants) and function not in (ANGLE, POSITIVE, STEP):
            return self.constant(function(*constants))
        short = _shortened(function, numbers, constants)
        if short is not None:
            return self.constant(0.0) if short == _NOTHING else numbers[short]
        self._list.append((function, numbers[0], numbers[-1]))
        self._known[key] = self._n_inputs + len(self._list) - 1
        return self._known[key]

    def call(self, function: Callee, numbers: Sequence[int]) -> Array:
        """Return the numbers of what a function returns, (size,)."""
        key = _CALL, id(function), *numbers
        at = self._known.get(key)
        if at is None:
            at = self._known[key] = self._n_inputs + len(self._list)
            index = len(self._calls)
            self._calls.append((function, tuple(numbers)))
            self._list.append((_CALL, index, index))
            self._list += [(_RESULT, at, i) for i in range(function.size)]
        return np.arange(at + 1, at + 1 + function.size)

    def _operands(self, k: int) -> Sequence[int]:
        """Return the numbers that operation k takes."""
        function, x, y = self._list[k]
        if function == _CALL:
            return self._calls[x][1]
        return (x,) if function == _RESULT else (x, y)

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
                if function == _CALL:
                    callee, numbers = self._calls[x]
                    moved = callee.rates(self, numbers, rates)
                    flat = [] if moved is None else moved.tolist()
                    rates |= {before + k + 1 + i: y for i, y in enumerate(flat) if y != zero}
                    continue
                if function == _RESULT or (x not in rates and y not in rates):
                    continue
                dx, dy = rates.get(x, zero), rates.get(y, zero)
                rate = self._rate(function, (x, y, before + k), dx, dy)
                if rate != zero:
                    rates[before + k] = rate
            flat = [rates.get(x, zero) for x in outputs.ravel().tolist()]
            found.append(np.array(flat, dtype=np.int64).reshape(outputs.shape))
        return found

    def partials(self, output: int) -> dict[int, int]:
        """Return the numbers of the partials of one output, by the inputs that it follows from.

        Written from the output back to the inputs: a few times as many operations as the output
        has, for any number of inputs. Where the list calls functions, along one input after the
        other.
        """
        one, zero, outputs = self.constant(1.0), self.constant(0.0), np.array([output])
        if self.calls(outputs):
            used = sorted(self.inputs(outputs))
            columns = self.along(outputs, *({x: one} for x in used))
            return {x: int(y[0]) for x, y in zip(used, columns, strict=True)}
        weights = {output: one}
        for k in reversed(self._needed(outputs)):
            z = self._n_inputs + k
            function, x, y = self._list[k]
            weight = weights.pop(z, None)
            both = ((x, one, zero), (y, zero, one))
            for operand, dx, dy in both if function in _OF_TWO else both[:1]:
                if weight is not None and operand >= 0:
                    slope = self._rate(function, (x, y, z), dx, dy)
                    term = self.apply(np.multiply, weight, slope)
                    weights[operand] = self.apply(np.add, weights.get(operand, zero), term)
        return weights

    def _rate(self, function: Any, numbers: tuple[int, int, int], dx: int, dy: int) -> int:
        """Return the derivative of z = f(x, y) from those of x and y."""
        if function is np.negative:
            return self.apply(np.negative, dx)
        if function is POSITIVE:
            return self.apply(np.multiply, self.apply(STEP, numbers[0]), dx)
        if function is STEP:
            return self.constant(0.0)
        x, y, z, x_, y_ = (Traced(self, at) for at in (*numbers, dx, dy))
        if function in _RATES:
            return _RATES[function](x, y, z, x_, y_).at
        first: Traced = DERIVATIVES[function][0](x, z) * x_
        return first.at

    def inputs(self, outputs: Array) -> set[int]:
        """Return the inputs that outputs follow from."""
        operands = chain.from_iterable(map(self._operands, self._needed(outputs)))
        used = {*operands, *outputs.ravel().tolist()}
        return {x for x in used if 0 <= x < self._n_inputs}

    def calls(self, outputs: Array) -> bool:
        """Whether outputs follow from a call."""
        return any(self._list[k][0] == _CALL for k in self._needed(outputs))

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
                waiting.update(self._operands(k))
        return sorted(found)

    def arrays(
        self, results: Array, inputs: Sequence[int] | None = None
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Return constants, operations with both their numbers, and results; of formulas of loads.

        Numbers are counted in the order of inputs, constants and results of operations. Inputs are
        all, or those given; what results do not follow from is left out.
        """
        return self._placed(results, inputs)[:-2]

    def order(self, numbers: Array, results: Array) -> list[int]:
        """Return the places, ascending, of numbers among the operations that results need."""
        places = {self._n_inputs + k: place for place, k in enumerate(self._needed(results))}
        return sorted(places[x] for x in numbers.ravel().tolist() if x in places)

    def _placed(
        self, results: Array, inputs: Sequence[int] | None
    ) -> tuple[Array, Array, Array, Array, Array, Array, tuple[Callee, ...]]:
        """Return `arrays`, and calls with their functions (`kernels/load_plan.h`)."""
        needed, flat = self._needed(results), results.ravel().tolist()
        used = {*chain.from_iterable(map(self._operands, needed)), *flat}
        kept = sorted((x for x in used if x < 0), reverse=True)
        ahead = range(self._n_inputs) if inputs is None else inputs
        numbers = [*ahead, *kept, *(self._n_inputs + k for k in needed)]
        place = {number: i for i, number in enumerate(numbers)}
        triples, calls, functions = list[tuple[int, int, int]](), list[int](), list[Callee]()
        for k in needed:
            function, x, y = self._list[k]
            if function == _CALL:
                callee, given = self._calls[x]
                triples.append((_CODES[_CALL], len(calls), len(functions)))
                functions.append(callee)
                first = self._n_inputs + k + 1
                to = (place.get(i, -1) for i in range(first, first + callee.size))
                calls += [len(given), callee.size, *(place[i] for i in given), *to]
            else:
                triples.append((_CODES[function], place[x], place[x if function == _RESULT else y]))
        op, a, b = np.array(triples, dtype=np.int32).reshape(-1, 3).T
        constants = np.array([self._constants[-x - 1] for x in kept] or np.zeros(0))
        outputs, of_calls = (np.array(x, dtype=np.int32) for x in ([place[x] for x in flat], calls))
        return constants, op, a, b, outputs, of_calls, tuple(functions)

    def compiled(self, outputs: Array, inputs: Sequence[int]) -> OperationList:
        """Return what evaluates real outputs at given inputs; outputs follow from no other."""
        constants, op, a, b, to, calls, functions = self._placed(outputs, inputs)
        n = len(inputs)
        return OperationList(n, constants.astype(float), op, a, b, to, calls, functions)


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

    def positive(self) -> Listed:
        """Return the array where it is positive, else 0."""
        return self._apply(POSITIVE, self)

    def step(self) -> Listed:
        """Return 1 where it is positive, else 0."""
        return self._apply(STEP, self)

    def joined(self, parts: Sequence[Any], join: Callable[[Sequence[Array]], Array]) -> Listed:
        """Return the entries of several arrays as one array."""
        return Listed(self._operations, join([self.numbers(x) for x in parts]))

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
        if plain and ufunc is np.arctan2:
            return self._apply(ANGLE, *inputs)
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
    """A number whose operations are listed; `Symbols` are arrays of such numbers.

    NumPy calls methods of the names of its functions on the entries of such arrays.
    """

    __slots__ = ("at", "operations")
    #: Kind of the arrays that hold it, so that `np.result_type` knows.
    dtype = np.dtype(object)

    def __init__(self, operations: Operations, at: int) -> None:
        self.operations, self.at = operations, at

    @staticmethod
    def array(operations: Operations, at: Array) -> Array:
        """Return an array of tracers of numbers of the list."""
        out = np.empty(at.shape, dtype=object)
        out.ravel()[:] = [Traced(operations, x) for x in at.ravel().tolist()]
        return out.view(Symbols)

    @staticmethod
    def numbers(operations: Operations, values: Any) -> Array:
        """Return the numbers of an array or of lists of tracers and constants."""
        x = np.asarray(values)
        flat = [_number(operations, y) for y in x.ravel().tolist()]
        return np.array(flat, dtype=np.int64).reshape(x.shape)

    def _of(self, function: Any, *others: Any) -> Any:
        if isinstance(others[0], np.ndarray) or isinstance(others[-1], np.ndarray):
            return NotImplemented  # Arrays take their entries one by one.
        operations = self.operations
        numbers = (_number(operations, x) for x in others)
        return Traced(operations, operations.apply(function, *numbers))

    @property
    def value(self) -> float:
        """The value of a constant."""
        return self.operations.value(self.at)

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
            return self._noted(self._of(np.power, self, n))
        if n < 0:
            return 1.0 / self ** (-n)
        if n < 2:
            return self if n == 1 else Traced(self.operations, self.operations.constant(1.0))
        half = self ** (n // 2)
        whole = half._of(np.square, half)
        return whole * self if n % 2 else whole

    def __rpow__(self, base: Any) -> Any:
        return (self * np.log(float(base))).exp()

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        """Apply a function of NumPy to this number and others, which may be plain."""
        return _applied(ufunc, method, inputs, kwargs)

    # Functions.

    def sqrt(self) -> Traced:  # noqa: D102 - NumPy's names, here and below
        return self._noted(self._of(np.sqrt, self))

    def _noted(self, root: Traced) -> Traced:
        """Note the line of the user's code that takes a root."""
        frame = sys._getframe(2)
        while frame.f_back is not None and frame.f_code.co_filename.startswith(_OWN):
            frame = frame.f_back
        name, line = frame.f_code.co_filename, frame.f_lineno
        text = linecache.getline(name, line).strip()
        self.operations.roots[root.at] = f"line {line} of {Path(name).name}, `{text}`"
        return root

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


#: What ends a trace.
TRACE_FAILURES = (NotTraceable, *FAILURES)


def told(error: Exception) -> str:
    """Return the line of a user's code at which tracing ended, and why."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [x for x in frames if not x.filename.startswith(_OWN)]
    known = isinstance(error, NotTraceable)
    why = f"asks for {error}" if known else f"fails on symbols ({type(error).__name__}: {error})"
    if not lines:
        return why
    last = lines[-1]
    return f"line {last.lineno} of {Path(last.filename).name}, `{last.line}`, {why}."


class Symbols(np.ndarray):
    """An array of dtype object with entries that are `Traced` or plain numbers."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        """Apply a function of NumPy to this array and others, which may hold plain numbers."""
        return _applied(ufunc, method, inputs, kwargs)


# Functions that NumPy looks for among the methods of entries, which plain numbers do not have.
_METHODS = frozenset(f for f in _CODES if isinstance(f, np.ufunc) and f.__name__ in vars(Traced))
_METHODS |= {np.arctan2, np.arcsin, np.arccos, np.hypot}


def _applied(ufunc: np.ufunc, method: str, inputs: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    """Return a function of NumPy of arrays of symbols."""
    if ufunc in _METHODS:
        operations = next(
            y.operations
            for x in inputs
            for y in np.asarray(x).ravel().tolist()
            if isinstance(y, Traced)
        )
        inputs = [Traced.array(operations, Traced.numbers(operations, x)) for x in inputs]
    plain = [np.asarray(x).view(np.ndarray) for x in inputs]
    if "out" in kwargs:
        kwargs["out"] = tuple(x.view(np.ndarray) for x in kwargs["out"])
    found = getattr(ufunc, method)(*plain, **kwargs)
    return found.view(Symbols) if isinstance(found, np.ndarray) else found


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
    np.power: lambda x, y, z, dx, dy: y * (x if y.value > 1 else x + _RAISED) ** (y.value - 1) * dx,
    np.sqrt: lambda x, y, z, dx, dy: 0.5 / (z + _ROOT) * dx,
}
