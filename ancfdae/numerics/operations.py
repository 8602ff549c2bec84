"""Formulas written with NumPy as lists of scalar operations, which a kernel evaluates.

Two kinds of tracers write such a list when a formula runs on them. `Listed` stands for a whole
array, in the formulas of loads. `Traced` stands for one number: arrays of dtype object hold
tracers, so that any NumPy code that rearranges numbers and computes with them runs unchanged.

**Derivatives** are more operations of the same list (`Operations.along`). For an operation z = f(x,
y) it writes z' = f_x x' + f_y y', where x' and y' are numbers of the list as well, zero for inputs
that the direction does not change. The result can be differentiated again. A kernel stores and
differentiates the list (`kernels/trace.h`).

A *number* of the list is the index of an input, a constant or a result.
"""

from __future__ import annotations

import linecache
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn, Protocol, final

import numpy as np

from ancfdae.kernels import OperationList, OperationTrace
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.complex_step import FAILURES
from ancfdae.numerics.vector_formulas import Carried, StandIn, without_derivatives

#: Functions that are not NumPy's: the angle of two numbers, the positive part of a number (else 0),
#: and 1 for positive numbers (else 0).
ANGLE, POSITIVE, STEP = "angle", "positive", "step"
# Functions of two numbers and of one, in the order of `kernels/load_plan.h`.
_OF_TWO = (np.add, np.subtract, np.multiply, np.divide, ANGLE, np.power)
_OF_ONE = (np.negative, np.sqrt, np.exp, np.log, np.sin, np.cos, np.tan, np.sinh, np.cosh, np.tanh)
_CODES: dict[Any, int] = {
    function: code
    for code, function in enumerate(
        (*_OF_TWO, *_OF_ONE, np.arctan, np.square, np.reciprocal, POSITIVE, STEP)
    )
}
# Codes of calls of functions that are not operations, and of their results.
_CALL, _RESULT = "call", "result"
_CODES |= {_CALL: len(_CODES), _RESULT: len(_CODES) + 1}
_FUNCTIONS = tuple(_CODES)
_ADD, _SUBTRACT, _MULTIPLY, _DIVIDE = (_CODES[x] for x in _OF_TWO[:4])
# Codes of functions that are infinite where a divisor vanishes, and functions that vanish with
# their first number.
_DIVIDING = [_CODES[x] for x in (np.divide, np.reciprocal, np.power, np.tan)]
_OF_BASE = frozenset((np.negative, np.square, np.sqrt, np.power, np.divide))
# Integer exponents up to this are written as products (`kernels/trace.h`).
_PRODUCTS = 64
# How formulas with kinks are written, for messages.
_POSITIVE = "; for kinks write `positive` of ancfdae.extend, |x| as positive(x) + positive(-x)"
# Folders of NumPy and of this package, whose lines of code are not a user's.
_OWN = str(Path(np.__file__).parent), str(Path(__file__).parents[1])


class Callee(Protocol):
    """A function that a list calls: rows of inputs, (k, n), to rows of values, (k, size)."""

    @property
    def size(self) -> int:
        """Number of values that the called function returns."""

    def __call__(self, rows: Array, /) -> Array:
        """Return the values of the function at rows of inputs, shape (k, size)."""

    def rates(
        self, operations: Operations, numbers: Sequence[int], rates: Mapping[int, int]
    ) -> Array | None:
        """Return the numbers, (size,), of rates of the values from rates of inputs, or None.

        None means that no input changes.
        """


@final
class Operations:
    """A list of operations on `n_inputs` inputs and on constants, written by a kernel.

    Inputs have the numbers from 0 on, results from `n_inputs` on, and constants from -1 down.
    """

    def __init__(self, n_inputs: int) -> None:
        self._n_inputs = n_inputs
        #: The list of operations in the kernel (`kernels/trace.h`).
        self.trace = OperationTrace(n_inputs)
        self._calls: list[tuple[Callee, tuple[int, ...]]] = []
        self._called: dict[tuple[int, ...], int] = {}
        #: Numbers of roots and powers with fractional exponents, with the file and the line of the
        #: user's code.
        self.roots: dict[int, tuple[str, int]] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Return the operations as rows, from which `__setstate__` writes them again."""
        operations, constants = self.trace.sizes()
        return {
            "n_inputs": self._n_inputs,
            "constants": [self.value(-1 - i) for i in range(constants)],
            "rows": self.trace.rows(_numbers(self._n_inputs + np.arange(operations))).tolist(),
            "calls": self._calls,
            "roots": self.roots,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Write the list again: the same operations in the same order have the same numbers."""
        Operations.__init__(self, state["n_inputs"])
        for value in state["constants"]:
            self.constant(value)
        for _, code, x, y in state["rows"]:
            if code == _CODES[_CALL]:
                self.call(*state["calls"][x])
            elif code != _CODES[_RESULT]:
                self.trace.apply(code, x, y)
        self.roots = state["roots"]

    def constant(self, value: Any) -> int:
        """Return the number of a constant, which is added to the list if it is new."""
        x = complex(value)
        return self.trace.constant(x.real, x.imag)

    def value(self, number: int) -> Any:
        """Return the value of the constant with this number in the list."""
        real, imaginary = self.trace.value(number)
        return complex(real, imaginary) if imaginary else real

    def apply(self, function: Any, *numbers: int) -> int:
        """Return the number of a result; an operation that is in the list is not added again."""
        return self.trace.apply(_CODES[function], numbers[0], numbers[-1])

    def call(self, function: Callee, numbers: Sequence[int]) -> Array:
        """Return the numbers, (size,), of the values that a call of the function returns."""
        key = id(function), *numbers
        at = self._called.get(key)
        if at is None:
            self._calls.append((function, tuple(numbers)))
            at = self._called[key] = self.trace.call(_numbers(numbers), function.size)
        return np.arange(at + 1, at + 1 + function.size)

    def along(self, outputs: Array, *directions: Mapping[int, int]) -> list[Array]:
        """Return numbers of the derivatives of outputs along each direction.

        A direction maps inputs to the numbers of their rates; other inputs are fixed.
        """
        rates = np.full((len(directions), self._n_inputs), self.constant(0.0), dtype=np.int32)
        for row, direction in zip(rates, directions, strict=True):
            row[list(direction)] = list(direction.values())
        found = self.trace.along(_numbers(outputs), rates, self._rates_of_call)
        return list(found.astype(np.int64).reshape(len(directions), *outputs.shape))

    def _rates_of_call(self, index: int, moved: Array) -> Array:
        """Return rates, (size,), of the results of a call from rates of inputs; (0,) for zero."""
        function, numbers = self._calls[index]
        found = function.rates(self, numbers, dict(zip(numbers, moved.tolist(), strict=True)))
        return _numbers([] if found is None else found)

    def partials(self, output: int) -> dict[int, int]:
        """Return the numbers of the partials of one output, by the inputs on which it depends.

        They are written from the output back to the inputs (reverse mode): a few times as many
        operations as the output has, for any number of inputs. If the list calls functions, one
        input after another is differentiated forward.
        """
        outputs = np.array([output])
        used = sorted(self.inputs(outputs))
        if self.calls(outputs):
            columns = self.along(outputs, *({x: self.constant(1.0)} for x in used))
            return {x: int(y[0]) for x, y in zip(used, columns, strict=True)}
        partials = self.trace.partials(output).tolist()
        return {x: partials[x] for x in used}

    def inputs(self, outputs: Array) -> set[int]:
        """Return the inputs of the list on which outputs depend."""
        return set(self.trace.inputs(_numbers(outputs)).tolist())

    def calls(self, outputs: Array) -> bool:
        """Return whether outputs depend on a call of a function."""
        return bool(np.any(self.trace.rows(_numbers(outputs))[:, 1] == _CODES[_CALL]))

    def rows(self, outputs: Array) -> list[tuple[int, Any, int, int]]:
        """Return the operations on which outputs depend: numbers, functions and arguments."""
        rows = self.trace.rows(_numbers(outputs)).tolist()
        return [(number, _FUNCTIONS[code], x, y) for number, code, x, y in rows]

    def divisors(self, outputs: Array) -> Array:
        """Return the numbers of the divisors on which outputs depend, (n,), ascending.

        Products and quotients are given by their factors, roots and powers by their bases, the
        divisor of a tangent is the cosine. Constants and functions without zeros are left out.
        """
        rows = self.trace.rows(_numbers(outputs))
        if not np.isin(rows[:, 1], _DIVIDING).any():
            return np.zeros(0, np.int64)
        made = {number: (_FUNCTIONS[code], x, y) for number, code, x, y in rows.tolist()}
        waiting, found = list[int](), set[int]()
        for function, x, y in made.values():
            if function is np.divide:
                waiting.append(y)
            elif function is np.reciprocal or (function is np.power and self.value(y).real < 0):
                waiting.append(x)
            elif function is np.tan:
                waiting.append(self.apply(np.cos, x))
        while waiting:
            number = waiting.pop()
            function, x, y = made.get(number, (None, 0, 0))
            if function is np.multiply:
                waiting += [x, y]
            elif function in _OF_BASE:
                waiting.append(x)
            elif number >= 0 and function not in (np.exp, np.cosh):
                found.add(number)
        return np.array(sorted(found), dtype=np.int64)

    def arrays(self, results: Array) -> tuple[Array, ...]:
        """Return constants, operations with both arguments, and results, for formulas of loads.

        Inputs, constants and results of operations are numbered in this order. Operations that no
        result needs are left out.
        """
        ahead = _numbers(np.arange(self._n_inputs))
        constants, *arrays = self.trace.placed(_numbers(results), ahead)[:5]
        return constants if np.any(constants.imag) else constants.real.copy(), *arrays

    def order(self, numbers: Array, results: Array) -> list[int]:
        """Return the ascending positions of `numbers` among the operations that results need."""
        needed = self.trace.rows(_numbers(results))[:, 0].tolist()
        places = {number: place for place, number in enumerate(needed)}
        return sorted(places[x] for x in numbers.ravel().tolist() if x in places)

    def compiled(self, outputs: Array, inputs: Sequence[int] | Array) -> OperationList:
        """Return a list that evaluates real outputs, which depend on the given inputs alone."""
        placed = self.trace.placed(_numbers(outputs), _numbers(inputs))
        constants, op, a, b, to, calls, functions = placed
        called = tuple(self._calls[i][0] for i in functions.tolist())
        real = constants.real.copy()
        return OperationList(len(inputs), real, op, a, b, to, calls, called)


def _numbers(numbers: Any) -> Array:
    """Return numbers of a list as the integers that kernels take, (k,)."""
    return np.asarray(numbers, dtype=np.int32).ravel()


@final
class Listed(Carried):
    """An array in a formula whose operations are written to a list."""

    def __init__(self, operations: Operations, at: Array) -> None:
        self._operations, self.at = operations, at

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array whose operations are listed."""
        return self.at.shape

    def __getitem__(self, key: Any) -> Listed:
        return Listed(self._operations, self.at[key])

    def sum(self, axis: int, keepdims: bool = False) -> Listed:
        """Return the sum of the array over an axis, as `numpy.sum` does."""
        first, *others = np.moveaxis(self.at, axis, 0)
        total = Listed(self._operations, np.asarray(first))
        for other in others:
            total = total._apply(np.add, total, Listed(self._operations, np.asarray(other)))
        return total[np.newaxis].moved(axis, self.at.ndim) if keepdims else total

    def moved(self, axis: int, n: int) -> Listed:
        """Return the array of n axes whose first axis is moved to position `axis`."""
        return Listed(self._operations, np.moveaxis(self.at, 0, axis % n))

    def angle(self, x: Any) -> Listed:
        """Return the angle of the vectors (x, self), entry by entry; rad."""
        return self._apply(ANGLE, self, x)

    def positive(self) -> Listed:
        """Return the array with entries that are not positive replaced by 0."""
        return self._apply(POSITIVE, self)

    def step(self) -> Listed:
        """Return an array with 1 where entries are positive, else 0."""
        return self._apply(STEP, self)

    def joined(self, parts: Sequence[Any], join: Callable[[Sequence[Array]], Array]) -> Listed:
        """Return the entries of several arrays as one array, in the order of `join`."""
        return Listed(self._operations, join([self.numbers(x) for x in parts]))

    def numbers(self, x: Any) -> Array:
        """Return the operation numbers of an array; entries of a plain array become constants."""
        if isinstance(x, Listed):
            return x.at
        values = np.asarray(x)
        constants = [self._operations.constant(value) for value in values.ravel().tolist()]
        return np.array(constants, dtype=np.int64).reshape(values.shape)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        """Add a function of NumPy to the list.

        Raises InvalidInputError for a function without derivatives.
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
    """Raised by a tracer where a formula needs the value of a number; the message says which."""


@final
class Traced(StandIn):
    """A number in a formula whose operations are written to a list; `Symbols` are arrays of these.

    NumPy calls methods with the names of its functions on the entries of such arrays.
    """

    __slots__ = ("at", "operations")
    #: Type of the arrays that hold tracers, for `np.result_type`.
    dtype = np.dtype(object)

    def __init__(self, operations: Operations, at: int) -> None:
        self.operations, self.at = operations, at

    @staticmethod
    def array(operations: Operations, at: Array) -> Array:
        """Return an array of tracers of the numbers `at` of the list."""
        out = np.empty(at.shape, dtype=object)
        out.ravel()[:] = [Traced(operations, x) for x in at.ravel().tolist()]
        return out.view(Symbols)

    @staticmethod
    def numbers(operations: Operations, values: Any) -> Array:
        """Return the operation numbers of an array or of lists of tracers and constants."""
        x = np.asarray(values)
        flat = [_number(operations, y) for y in x.ravel().tolist()]
        return np.array(flat, dtype=np.int64).reshape(x.shape)

    def _with(self, code: int, other: Any, reflected: bool = False) -> Any:
        """Return an operation on this and another number, which comes first if `reflected`."""
        operations, x = self.operations, self.at
        if type(other) is Traced:
            y = other.at
        elif isinstance(other, np.ndarray):
            return NotImplemented  # NumPy then applies the operation entry by entry.
        else:
            y = _number(operations, other)
        at = operations.trace.apply(code, *((y, x) if reflected else (x, y)))
        return Traced(operations, at)

    def _of(self, code: int) -> Traced:
        """Return the result of an operation on this number alone."""
        return Traced(self.operations, self.operations.trace.apply(code, self.at, self.at))

    # Arithmetic.

    def __add__(self, other: Any) -> Any:
        return self._with(_ADD, other)

    def __radd__(self, other: Any) -> Any:
        return self._with(_ADD, other, reflected=True)

    def __sub__(self, other: Any) -> Any:
        return self._with(_SUBTRACT, other)

    def __rsub__(self, other: Any) -> Any:
        return self._with(_SUBTRACT, other, reflected=True)

    def __mul__(self, other: Any) -> Any:
        return self._with(_MULTIPLY, other)

    def __rmul__(self, other: Any) -> Any:
        return self._with(_MULTIPLY, other, reflected=True)

    def __truediv__(self, other: Any) -> Any:
        return self._with(_DIVIDE, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self._with(_DIVIDE, other, reflected=True)

    def __neg__(self) -> Any:
        return self._of(_CODES[np.negative])

    def __pos__(self) -> Any:
        return self

    def __pow__(self, exponent: Any) -> Any:
        if isinstance(exponent, Traced):
            return (exponent * self.log()).exp()
        if isinstance(exponent, np.ndarray):
            return NotImplemented
        n = float(exponent)
        power = Traced(self.operations, self.operations.trace.power(self.at, n))
        whole = n.is_integer() and abs(n) <= _PRODUCTS
        return power if whole else self._noted(power)

    def __rpow__(self, base: Any) -> Any:
        return (self * np.log(float(base))).exp()

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        """Apply a function of NumPy to this number and others, which may be plain numbers."""
        if len(inputs) == 1 and ufunc in _METHODS and method == "__call__" and not kwargs:
            return getattr(self, ufunc.__name__)()
        return _applied(ufunc, method, inputs, kwargs)

    # Functions.

    def sqrt(self) -> Traced:  # noqa: D102 - NumPy's names, here and below
        return self._noted(self._of(_CODES[np.sqrt]))

    def _noted(self, root: Traced) -> Traced:
        """Store the line of the user's code that takes this root, for messages."""
        frame = sys._getframe(2)
        while frame.f_back is not None and frame.f_code.co_filename.startswith(_OWN):
            frame = frame.f_back
        self.operations.roots[root.at] = frame.f_code.co_filename, frame.f_lineno
        return root

    def exp(self) -> Traced:  # noqa: D102
        return self._of(_CODES[np.exp])

    def log(self) -> Traced:  # noqa: D102
        return self._of(_CODES[np.log])

    def sin(self) -> Traced:  # noqa: D102
        return self._of(_CODES[np.sin])

    def cos(self) -> Traced:  # noqa: D102
        return self._of(_CODES[np.cos])

    def tan(self) -> Traced:  # noqa: D102
        return self._of(_CODES[np.tan])

    def sinh(self) -> Traced:  # noqa: D102
        return self._of(_CODES[np.sinh])

    def cosh(self) -> Traced:  # noqa: D102
        return self._of(_CODES[np.cosh])

    def tanh(self) -> Traced:  # noqa: D102
        return self._of(_CODES[np.tanh])

    def arctan(self) -> Traced:  # noqa: D102
        return self._of(_CODES[np.arctan])

    def angle(self, x: Any) -> Any:
        """Return the angle of the vector (x, self); rad."""
        return self._with(_CODES[ANGLE], x)

    arctan2 = angle

    def positive(self) -> Traced:
        """Return the number if it is positive, else 0."""
        return self._of(_CODES[POSITIVE])

    def step(self) -> Traced:
        """Return 1 if the number is positive, else 0."""
        return self._of(_CODES[STEP])

    def arcsin(self) -> Traced:  # noqa: D102
        return self.arctan2(((1.0 - self) * (1.0 + self)).sqrt())

    def arccos(self) -> Traced:  # noqa: D102
        return ((1.0 - self) * (1.0 + self)).sqrt().arctan2(self)

    def hypot(self, other: Any) -> Traced:  # noqa: D102
        return (self * self + other * other).sqrt()

    # Tracers stand for real numbers.

    @property
    def real(self) -> Traced:
        """Real part of the traced number: the number itself."""
        return self

    @property
    def imag(self) -> float:
        """Imaginary part of the traced number: zero."""
        return 0.0

    def conjugate(self) -> Traced:
        """Return the traced number itself, since it is real."""
        return self

    # Operations that need the value of the number are rejected.

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
        _refuse(f"abs, which has a kink{_POSITIVE}")

    def __lt__(self, other: object) -> bool:
        _refuse(
            f"a comparison of the state or of b (also within np.where, maximum, clip){_POSITIVE}"
        )

    __le__ = __gt__ = __ge__ = __eq__ = __ne__ = __lt__
    __hash__ = None  # type: ignore[assignment]


#: Exceptions that end the tracing of a formula.
TRACE_FAILURES = (NotTraceable, *FAILURES)


def line_of(place: tuple[str, int]) -> str:
    """Return a line of a user's code, given by its file and its number, in words."""
    name, line = place
    return f"line {line} of {Path(name).name}, `{linecache.getline(name, line).strip()}`"


def told(error: Exception) -> str:
    """Return the line of a user's code at which tracing ended, and the reason."""
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


# Functions that NumPy calls as methods of the entries; plain numbers lack these methods.
_METHODS = frozenset(f for f in _CODES if isinstance(f, np.ufunc) and f.__name__ in vars(Traced))
_METHODS |= {np.arctan2, np.arcsin, np.arccos, np.hypot}
# Functions of scalars that need no arrays.
_OF_NUMBERS = _METHODS | {np.add, np.subtract, np.multiply, np.divide}


def _applied(ufunc: np.ufunc, method: str, inputs: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    """Return a NumPy function of arrays of symbols as an array of symbols, or as a tracer."""
    single = not any(isinstance(x, np.ndarray | list | tuple) for x in inputs)
    if single and method == "__call__" and not kwargs and ufunc in _OF_NUMBERS:
        operations = next(x.operations for x in inputs if type(x) is Traced)
        first, *others = (Traced(operations, _number(operations, x)) for x in inputs)
        if ufunc in _METHODS:
            return getattr(first, ufunc.__name__)(*others)
        return first._with(_CODES[ufunc], others[0])
    if ufunc in _METHODS:
        operations = next(
            y.operations
            for x in inputs
            for y in np.asarray(x).ravel().tolist()
            if type(y) is Traced
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
    """Return the operation number of a tracer or of a real constant."""
    if type(x) is Traced:
        return x.at
    if isinstance(x, complex):
        _refuse("a complex number")
    return operations.trace.constant(float(x), 0.0)
