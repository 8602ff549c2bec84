"""Expression trees: arithmetic on anything that has values and partial derivatives.

Observables and objectives share this tree and differ in their leaves. The derivative of an
expression in its leaves comes from one sweep from the root to the leaves; each operation
contributes its partials, taken by a complex step.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NoReturn, TypeVar, cast, final

import numpy as np

from ancfdae.errors import InvalidInput, require_finite
from ancfdae.numerics.arrays import Array
from ancfdae.observables.functions import Function, analytic

K = TypeVar("K", bound="Expression[Any]")


@final
@dataclass(frozen=True, eq=False)
class Operation:
    """A function of operands: leaves, numbers and other operations.

    Compared by identity, so that trees of any depth can be keys.
    """

    function: Function
    operands: tuple[object, ...]


class Expression(abc.ABC, Generic[K]):
    """Operators of expressions of kind K."""

    @property
    @abc.abstractmethod
    def tree(self) -> object:
        """The expression itself if it is a leaf, else its `Operation`."""

    @abc.abstractmethod
    def of(self, operation: Operation) -> K:
        """Return an operation as an expression of this kind."""

    @abc.abstractmethod
    def accepts(self, other: object) -> bool:
        """Whether the other expression is of this kind."""

    def combined(self, function: Function, operands: Sequence[object]) -> K:
        """Return a function of expressions and numbers.

        Raises
        ------
        InvalidInput
            If an operand is neither an expression of this kind nor a finite number.
        """
        return self.of(Operation(function, tuple(self._node(x) for x in operands)))

    def _node(self, operand: object) -> object:
        if isinstance(operand, Expression) and self.accepts(operand):
            return operand.tree
        where = f"operand of {type(self).__name__}"
        if isinstance(operand, Expression):
            raise InvalidInput(
                where,
                "observables combine with observables and objectives with objectives",
                type(operand).__name__,
                "Turn the observable into an objective, such as Integral(observable).",
            )
        if np.ndim(cast(Any, operand)) > 0:
            got = f"an array of shape {np.shape(cast(Any, operand))}"
            raise InvalidInput(where, "must be a single number", got, "Write one expression each.")
        number = operand.item() if isinstance(operand, np.ndarray) else operand
        require_finite(where, cast(float, number), "Combine with numbers and expressions.")
        return float(cast(float, number))

    def __array_ufunc__(
        self, ufunc: np.ufunc, method: str, *inputs: object, **options: object
    ) -> K:
        """Apply a NumPy function; see `analytic` for those that are refused."""
        return self.combined(analytic(ufunc, method, not options), inputs)

    def __add__(self, other: K | float) -> K:
        return self.combined(analytic(np.add), (self, other))

    def __radd__(self, other: float) -> K:
        return self.combined(analytic(np.add), (other, self))

    def __sub__(self, other: K | float) -> K:
        return self.combined(analytic(np.subtract), (self, other))

    def __rsub__(self, other: float) -> K:
        return self.combined(analytic(np.subtract), (other, self))

    def __mul__(self, other: K | float) -> K:
        return self.combined(analytic(np.multiply), (self, other))

    def __rmul__(self, other: float) -> K:
        return self.combined(analytic(np.multiply), (other, self))

    def __truediv__(self, other: K | float) -> K:
        return self.combined(analytic(np.divide), (self, other))

    def __rtruediv__(self, other: float) -> K:
        return self.combined(analytic(np.divide), (other, self))

    def __pow__(self, other: K | float) -> K:
        return self.combined(analytic(np.power), (self, other))

    def __rpow__(self, other: float) -> K:
        return self.combined(analytic(np.power), (other, self))

    def __neg__(self) -> K:
        return self.combined(analytic(np.negative), (self,))

    def __pos__(self) -> K:
        return self.combined(analytic(np.positive), (self,))

    # `analytic` refuses these and says what to use instead.

    def __abs__(self) -> K:
        return self.combined(analytic(np.absolute), (self,))

    def __floordiv__(self, other: object) -> K:
        return self.combined(analytic(np.floor_divide), (self, other))

    def __mod__(self, other: object) -> K:
        return self.combined(analytic(np.remainder), (self, other))

    def __lt__(self, other: object) -> K:
        return self.combined(analytic(np.less), (self, other))

    def __le__(self, other: object) -> K:
        return self.combined(analytic(np.less_equal), (self, other))

    def __gt__(self, other: object) -> K:
        return self.combined(analytic(np.greater), (self, other))

    def __ge__(self, other: object) -> K:
        return self.combined(analytic(np.greater_equal), (self, other))

    def __bool__(self) -> NoReturn:
        raise InvalidInput(
            "truth of an expression",
            "is not defined, since its value changes over time",
            type(self).__name__,
            "Weight with a smooth function such as 0.5 * (1 + tanh(x / eps)).",
        )


def in_order(tree: object) -> list[object]:
    """Nodes of a tree, each once, operands before operations; without recursion."""
    done: dict[object, None] = {}
    stack = [tree]
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


def leaves(tree: object) -> list[object]:
    """Distinct leaves of a tree."""
    return [node for node in in_order(tree) if not isinstance(node, Operation)]


def evaluated(tree: object, leaf_value: Callable[[Any], Array]) -> dict[object, Array]:
    """Values of all nodes of a tree, in an order that puts the root last."""
    values: dict[object, Array] = {}
    with np.errstate(all="ignore"):
        for node in in_order(tree):
            if isinstance(node, Operation):
                values[node] = node.function(operands_of(node, values))
            else:
                values[node] = leaf_value(node)
    return values


def operands_of(operation: Operation, values: Mapping[object, Array]) -> list[Array]:
    """Values of the operands of an operation."""
    return [np.asarray(x) if isinstance(x, float) else values[x] for x in operation.operands]


def leaf_weights(values: Mapping[object, Array], weight: Array) -> dict[object, Array]:
    """Return the derivatives of sum(weight * root) in the values of the leaves.

    Parameters
    ----------
    values : mapping
        Real values of all nodes as `evaluated` returns them.
    weight : array
        Of the shape of the values. Where it is zero nothing contributes, even if a derivative
        is not finite there.
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
