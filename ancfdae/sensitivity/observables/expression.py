"""Expression trees: arithmetic on objects that have values and partial derivatives.

Observables and objectives share this tree and differ in their leaves. The derivative of an
expression in its leaves comes from one sweep from the root to the leaves; each operation
contributes its partials, taken by a complex step.

For real x and a tiny step eps, Im f(x + i eps) / eps is f'(x) to round-off if f is analytic at x.
NumPy continues some functions to where they are not real, sqrt(-1) = i, and there the quotient is
no derivative. A complex operand therefore stands for a small interval around its real part: where
the function is not finite on all of it, the result is NaN.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NoReturn, TypeVar, cast, final

import numpy as np

from ancfdae.errors.checks import require_finite
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.complex_step import FAILURES

# NumPy functions that are analytic on the whole real line, or infinite at their poles.
_WHOLE = (
    *(np.add, np.subtract, np.multiply, np.divide, np.negative, np.positive),
    *(np.square, np.reciprocal, np.sin, np.cos, np.tan, np.arctan),
    *(np.sinh, np.cosh, np.tanh, np.arcsinh, np.exp, np.exp2, np.expm1),
)
# NumPy functions that are real on a part of the real line only.
_EDGED = (
    *(np.power, np.sqrt, np.log, np.log2, np.log10),
    *(np.arcsin, np.arccos, np.arccosh, np.arctanh),
)
_COMPARE = "Weight with 0.5 * (1 + tanh((x - limit) / eps))."
_STEPS = "Leave it out: it has no derivative where it jumps."
_REPAIRS = {
    "absolute": "Use sqrt(x**2 + eps**2).",
    "fabs": "Use sqrt(x**2 + eps**2).",
    "maximum": "Use 0.5 * (x + y + sqrt((x - y)**2 + eps**2)), or SmoothMaximum over time.",
    "minimum": "Use 0.5 * (x + y - sqrt((x - y)**2 + eps**2)), or SmoothMaximum over time.",
    "sign": "Use tanh(x / eps).",
    "heaviside": "Use 0.5 * (1 + tanh(x / eps)).",
    "hypot": "Use sqrt(x**2 + y**2).",
    "cbrt": "Use x**(1 / 3).",
    "log1p": "Use log(1 + x).",
    **dict.fromkeys(("less", "less_equal", "greater", "greater_equal"), _COMPARE),
    **dict.fromkeys(("equal", "not_equal", "isfinite", "isnan", "logical_not"), _COMPARE),
    **dict.fromkeys(("floor", "ceil", "trunc", "rint"), _STEPS),
    **dict.fromkeys(("floor_divide", "remainder", "fmod", "divmod"), _STEPS),
}


@final
@dataclass(frozen=True)
class Function:
    """A function of arrays, element by element, with its partial derivatives.

    It is `edged` if it may be real on a part of the real line only, and `by_user` if a user wrote
    it, so that its derivative is checked.
    """

    name: str
    call: Callable[..., Array]
    edged: bool
    by_user: bool = False

    def __call__(self, operands: Sequence[Array]) -> Array:
        """Return the value; NaN where complex operands meet the edge of the real domain."""
        y: Array = np.asarray(self.call(*operands))
        moving = [k for k, x in enumerate(operands) if np.iscomplexobj(x)]
        if not (self.edged and moving):
            return y
        real = [np.real(x) for x in operands]
        for k in moving:
            for side in (-np.inf, np.inf):
                near = [*real[:k], np.nextafter(real[k], side), *real[k + 1 :]]
                y = np.where(np.isfinite(self.call(*near)), y, complex(np.nan, np.nan))
        return y

    def slope(self, operands: Sequence[Array], k: int) -> Array:
        """Return the partial derivative in operand k at real operands, element by element."""
        moved = [x + 1j * STEP if i == k else x for i, x in enumerate(operands)]
        slope: Array = self(moved).imag / STEP
        return slope


def angle_of(y: Array, x: Array) -> Array:
    """Return the angle of the vector (x, y) from -pi to pi, rad; analytic in complex x and y."""
    turn: Array = np.arctan2(np.real(y), np.real(x))
    if not (np.iscomplexobj(y) or np.iscomplexobj(x)):
        return turn
    c, s = np.cos(turn), np.sin(turn)
    angle: Array = turn + np.arctan((c * y - s * x) / (c * x + s * y))
    return angle


_FUNCTIONS = {
    ufunc: Function(ufunc.__name__, ufunc, edged)
    for ufuncs, edged in ((_WHOLE, False), (_EDGED, True))
    for ufunc in ufuncs
} | {np.arctan2: Function("arctan2", angle_of, edged=False)}


def analytic(ufunc: np.ufunc, method: str = "__call__", plain: bool = True) -> Function:
    """Return a NumPy function as a `Function` for expressions.

    Raises InvalidInputError for functions that are not analytic, methods such as ``reduce``, and
    calls that are not `plain` but have options such as ``where``.
    """
    name = f"numpy.{ufunc.__name__}"
    if ufunc not in _FUNCTIONS:
        raise InvalidInputError(
            name,
            "must have a derivative and accept complex numbers to stand in an expression",
            "a function that does not",
            _REPAIRS.get(ufunc.__name__, "Use elementary functions, or apply(function, x)."),
        )
    if method != "__call__" or not plain:
        got = f"{ufunc.__name__}.{method}" if method != "__call__" else "options"
        raise InvalidInputError(
            name, "must simply be called on an expression", got, "Write the expression out."
        )
    return _FUNCTIONS[ufunc]


def require_vectorised(where: str, rows: Callable[[slice], Array], count: int) -> Array:
    """Return the values of a function at `count` time points, (count,).

    `rows` returns them at a slice of the time points. Raises InvalidInputError unless the function
    works on arrays, each time point by itself.
    """
    repair = "Return one number per instant, from that instant alone."
    try:
        y, last = np.asarray(rows(slice(None))), np.asarray(rows(slice(count - 1, count)))
    except FAILURES as error:
        got = f"{type(error).__name__}: {error}"
        raise InvalidInputError(where, "must work on arrays over time", got, repair) from error
    if y.shape != (count,) or y.dtype.kind not in "iufc":
        got = f"shape {y.shape} and type {y.dtype}"
        raise InvalidInputError(where, f"must return numbers of shape ({count},)", got, repair)
    if last.shape != (1,) or not _same(last[0], y[-1]):
        got = "a value that depends on the other instants"
        raise InvalidInputError(where, "must work instant by instant", got, repair)
    return y


def _same(x: Any, y: Any) -> bool:
    """Return whether two numbers of NumPy agree to 1e-9, are one infinity, or are both NaN."""
    return bool(x == y or abs(x - y) <= 1e-9 * abs(y) < np.inf or (x != x and y != y))


# -- expressions -------------------------------------------------------------------------------


K = TypeVar("K", bound="Expression[Any]")


def _binary(ufunc: np.ufunc) -> Callable[[Expression[K], K | float], K]:
    """Return an operator method that applies a NumPy function to self and other (`analytic`)."""

    def operator(self: Expression[K], other: K | float) -> K:
        return self.combined(analytic(ufunc), (self, other))

    return operator


def _reflected(ufunc: np.ufunc) -> Callable[[Expression[K], float], K]:
    """Return an operator method that applies a NumPy function to other and self."""

    def operator(self: Expression[K], other: float) -> K:
        return self.combined(analytic(ufunc), (other, self))

    return operator


def _unary(ufunc: np.ufunc) -> Callable[[Expression[K]], K]:
    """Return an operator method that applies a NumPy function to self (see `analytic`)."""

    def operator(self: Expression[K]) -> K:
        return self.combined(analytic(ufunc), (self,))

    return operator


class Expression(abc.ABC, Generic[K]):
    """A leaf or an `Operation` of an expression tree, with the operators of its kind K."""

    @abc.abstractmethod
    def of(self, function: Function, operands: tuple[object, ...]) -> K:
        """Return the operation `function` of operands as an expression of this kind."""

    @abc.abstractmethod
    def accepts(self, other: object) -> bool:
        """Return whether `other` is an expression of this kind."""

    def combined(self, function: Function, operands: Sequence[object]) -> K:
        """Return a function of expressions of this kind and finite numbers; others are rejected."""
        where, accepted = f"operand of {type(self).__name__}", list[object]()
        for operand in operands:
            if isinstance(operand, Expression):
                if not self.accepts(operand):
                    raise InvalidInputError(
                        where,
                        "observables combine with observables and objectives with objectives",
                        type(operand).__name__,
                        "Turn the observable into an objective, such as Integral(observable).",
                    )
                accepted.append(operand)
                continue
            if np.ndim(cast(Any, operand)) > 0:
                got = f"an array of shape {np.shape(cast(Any, operand))}"
                repair = "Write one expression each."
                raise InvalidInputError(where, "must be a single number", got, repair)
            number = operand.item() if isinstance(operand, np.ndarray) else operand
            require_finite(where, cast(float, number), "Combine with numbers and expressions.")
            accepted.append(float(cast(float, number)))
        return self.of(function, tuple(accepted))

    def __array_ufunc__(
        self, ufunc: np.ufunc, method: str, *inputs: object, **options: object
    ) -> K:
        """Apply a NumPy function; `analytic` rejects those without a derivative."""
        return self.combined(analytic(ufunc, method, not options), inputs)

    __add__, __radd__ = _binary(np.add), _reflected(np.add)
    __sub__, __rsub__ = _binary(np.subtract), _reflected(np.subtract)
    __mul__, __rmul__ = _binary(np.multiply), _reflected(np.multiply)
    __truediv__, __rtruediv__ = _binary(np.divide), _reflected(np.divide)
    __pow__, __rpow__ = _binary(np.power), _reflected(np.power)
    __neg__, __pos__ = _unary(np.negative), _unary(np.positive)

    # `analytic` rejects these functions and names a smooth alternative.
    __abs__ = _unary(np.absolute)
    __floordiv__, __mod__ = _binary(np.floor_divide), _binary(np.remainder)
    __lt__, __le__ = _binary(np.less), _binary(np.less_equal)
    __gt__, __ge__ = _binary(np.greater), _binary(np.greater_equal)

    def __bool__(self) -> NoReturn:
        raise InvalidInputError(
            "truth of an expression",
            "an observable must not be used as a condition, because its value changes over time",
            type(self).__name__,
            "Weight with a smooth function such as 0.5 * (1 + tanh(x / eps)).",
        )


@dataclass(frozen=True, eq=False)
class Operation:
    """A function of operands, which are expressions and numbers.

    Compared by identity, so that trees of any depth can be keys of a dictionary.
    """

    function: Function
    operands: tuple[object, ...]


def in_order(root: object) -> list[object]:
    """Return the nodes of an expression, each once, operands before operations.

    Trees may be deep, so there is no recursion.
    """
    done: dict[object, None] = {}
    stack = [root]
    while stack:
        node = stack[-1]
        missing = []
        if isinstance(node, Operation):
            missing = [x for x in node.operands if not isinstance(x, float) and x not in done]
        if missing:
            stack.extend(missing)
        else:
            done[stack.pop()] = None
    return list(done)


def leaves(root: object) -> list[object]:
    """Return the distinct leaves of an expression."""
    return [node for node in in_order(root) if not isinstance(node, Operation)]


def evaluated(root: object, leaf_value: Callable[[Any], Array]) -> dict[object, Array]:
    """Return the values of all nodes of an expression by node, the expression last."""
    values: dict[object, Array] = {}
    with np.errstate(all="ignore"):
        for node in in_order(root):
            if isinstance(node, Operation):
                values[node] = node.function(operands_of(node, values))
            else:
                values[node] = leaf_value(node)
    return values


def operands_of(operation: Operation, values: Mapping[object, Array]) -> list[Array]:
    """Return the values of the operands of an operation, from the `values` of all nodes."""
    return [np.asarray(x) if isinstance(x, float) else values[x] for x in operation.operands]


def leaf_weights(values: Mapping[object, Array], weight: Array) -> dict[object, Array]:
    """Return the derivatives of sum(weight * root) in the values of the leaves, by leaf.

    `values` holds the real values of all nodes, as `evaluated` returns them. Where the weight is
    zero the derivative is zero, even if a partial derivative is not finite there.
    """
    nodes = list(values)
    weights: dict[object, Array] = {nodes[-1]: weight}
    with np.errstate(all="ignore"):
        for node in reversed(nodes):
            if not isinstance(node, Operation):
                continue
            arguments, outer = operands_of(node, values), weights[node]
            for k, operand in enumerate(node.operands):
                if isinstance(operand, float):
                    continue
                inner = np.where(outer == 0, 0.0, outer * node.function.slope(arguments, k))
                weights[operand] = weights[operand] + inner if operand in weights else inner
    return {node: w for node, w in weights.items() if not isinstance(node, Operation)}
