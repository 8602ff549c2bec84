"""Values with their derivatives carried through formulas: an independent implementation for tests.

A jet is (x, x', x'', ...). Products follow Leibniz' rule, functions of one argument the chain rule

    f(x)' = f' x',  f(x)'' = f'' x'^2 + f' x'',  f(x)''' = f''' x'^3 + 3 f'' x' x'' + f' x'''.

Entries may be complex, so that a complex step in a parameter gives derivatives of derivatives. The
package differentiates lists of operations instead (`ancfdae.numerics.operations`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, final

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.numerics.vector_formulas import Carried, angle, step, without_derivatives

#: First three derivatives of functions of one number, each from the argument x and the value y.
DERIVATIVES: dict[np.ufunc, tuple[Callable[[Any, Any], Any], ...]] = {
    np.exp: (lambda x, y: y, lambda x, y: y, lambda x, y: y),
    np.log: (lambda x, y: 1 / x, lambda x, y: -1 / x**2, lambda x, y: 2 / x**3),
    np.sqrt: (lambda x, y: 0.5 / y, lambda x, y: -0.25 / y**3, lambda x, y: 0.375 / y**5),
    np.sin: (lambda x, y: np.cos(x), lambda x, y: -y, lambda x, y: -np.cos(x)),
    np.cos: (lambda x, y: -np.sin(x), lambda x, y: -y, lambda x, y: np.sin(x)),
    np.tan: (
        lambda x, y: 1 + y**2,
        lambda x, y: 2 * y * (1 + y**2),
        lambda x, y: (2 + 6 * y**2) * (1 + y**2),
    ),
    np.sinh: (lambda x, y: np.cosh(x), lambda x, y: y, lambda x, y: np.cosh(x)),
    np.cosh: (lambda x, y: np.sinh(x), lambda x, y: y, lambda x, y: np.sinh(x)),
    np.tanh: (
        lambda x, y: 1 - y**2,
        lambda x, y: -2 * y * (1 - y**2),
        lambda x, y: (6 * y**2 - 2) * (1 - y**2),
    ),
    np.square: (lambda x, y: 2 * x, lambda x, y: 2 + 0 * x, lambda x, y: 0 * x),
    np.reciprocal: (lambda x, y: -(y**2), lambda x, y: 2 * y**3, lambda x, y: -6 * y**4),
    np.arctan: (
        lambda x, y: 1 / (1 + x**2),
        lambda x, y: -2 * x / (1 + x**2) ** 2,
        lambda x, y: (6 * x**2 - 2) / (1 + x**2) ** 3,
    ),
}
_LINEAR = (np.add, np.subtract, np.negative, np.positive)


@final
class Jet(Carried):
    """A value and its first time derivatives, up to three; jets that meet have equally many."""

    def __init__(self, *derivatives: Array) -> None:
        self.derivatives = derivatives

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the value and of each derivative."""
        return np.shape(self.derivatives[0])

    def map(self, linear: Callable[[Array], Array]) -> Jet:
        """Return the jet of a linear function of the value."""
        return Jet(*(linear(x) for x in self.derivatives))

    def __getitem__(self, key: Any) -> Jet:
        return self.map(lambda x: x[key])

    def sum(self, axis: int, keepdims: bool = False) -> Jet:
        """Return the sum over an axis."""
        return self.map(lambda x: np.asarray(x.sum(axis=axis, keepdims=keepdims)))

    def angle(self, x: Any) -> Jet:
        """Return the angle of (x, self), two jets."""
        (x_0, *x_1), (y_0, *y_1) = x.derivatives, self.derivatives
        if not x_1:
            return Jet(angle(y_0, x_0))
        low_x, low_y = Jet(*x.derivatives[:-1]), Jet(*self.derivatives[:-1])
        rate = (low_x * Jet(*y_1) - low_y * Jet(*x_1)) / (low_x * low_x + low_y * low_y)
        return Jet(angle(y_0, x_0), *rate.derivatives)

    def positive(self) -> Jet:
        """Return the value where it is positive, else 0; its derivative at 0 is 0."""
        return self.map(lambda x: np.where(self.derivatives[0].real <= 0, 0.0, x))

    def step(self) -> Jet:
        """Return 1 where the value is positive, else 0, with derivatives of 0."""
        x, *others = self.derivatives
        return Jet(step(x), *(0 * y for y in others))

    def joined(self, parts: Sequence[Any], join: Callable[[Sequence[Array]], Array]) -> Jet:
        """Return jets whose derivatives are joined one by one."""
        rows = [
            x.derivatives if isinstance(x, Jet) else self._entries(np.asarray(x)) for x in parts
        ]
        shapes = [np.shape(row[0]) for row in rows]
        return Jet(
            *(
                join([np.broadcast_to(x, shape) for x, shape in zip(each, shapes, strict=True)])
                for each in zip(*rows, strict=True)
            )
        )

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Jet:
        """Apply a function of NumPy.

        InvalidInputError for a function without derivatives here.
        """
        plain = method == "__call__" and not kwargs
        if plain and ufunc in _LINEAR:
            return Jet(*map(ufunc, *(self._entries(x) for x in inputs)))
        if plain and ufunc in (np.multiply, np.matmul):
            return _product(ufunc, *inputs)
        if plain and ufunc is np.divide:
            x, y = inputs
            # The reciprocal of a whole number, which NumPy takes as a whole number, is zero.
            return _product(np.multiply, x, np.reciprocal(y) if isinstance(y, Jet) else 1.0 / y)
        if plain and ufunc is np.power:
            return self._power(*inputs)
        if plain and ufunc is np.arctan2 and all(isinstance(x, Jet) for x in inputs):
            return inputs[0].angle(inputs[1])
        if plain and ufunc in DERIVATIVES:
            x = inputs[0].derivatives[0]
            y, order = ufunc(x), len(self.derivatives) - 1
            return self._chain(y, tuple(f(x, y) for f in DERIVATIVES[ufunc][:order]))
        raise without_derivatives(ufunc)

    def _entries(self, x: Any) -> tuple[Any, ...]:
        """Return x as a jet's derivatives; a constant has zeros."""
        if isinstance(x, Jet):
            return x.derivatives
        return (x, *(np.zeros(()) for _ in self.derivatives[1:]))

    def _power(self, x: Any, n: Any) -> Jet:
        if isinstance(n, Jet):
            return np.exp(n * np.log(x))
        a = x.derivatives[0]
        factors = (n, n * (n - 1), n * (n - 1) * (n - 2))
        # A factor of zero leaves nothing of a power that may be infinite.
        terms = (c * a ** (n - k) if np.any(c) else 0 * a for k, c in enumerate(factors, start=1))
        return x._chain(a**n, tuple(terms))

    def _chain(self, y: Array, f: tuple[Array, ...]) -> Jet:
        """Return the jet of a function with value y and derivatives f at this one."""
        x = self.derivatives[1:]
        whole = [y]
        if len(x) > 0:
            whole.append(f[0] * x[0])
        if len(x) > 1:
            whole.append(f[1] * x[0] ** 2 + f[0] * x[1])
        if len(x) > 2:
            whole.append(f[2] * x[0] ** 3 + 3 * f[1] * x[0] * x[1] + f[0] * x[2])
        return Jet(*whole)


def _product(product: np.ufunc, x: Any, y: Any) -> Jet:
    """Return a product by Leibniz' rule; one factor may be constant."""
    if not isinstance(x, Jet):
        return y.map(lambda b: product(x, b))
    if not isinstance(y, Jet):
        return x.map(lambda a: product(a, y))
    a, b = x.derivatives, y.derivatives
    whole = [product(a[0], b_n) for b_n in b]
    for n in range(1, len(a)):
        for k in range(1, n + 1):
            whole[n] = whole[n] + math.comb(n, k) * product(a[k], b[n - k])
    return Jet(*whole)
