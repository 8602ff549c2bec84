"""Power of a load: F . V, the forces on its vectors times their rates."""

from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.assembly.load_input import LoadInput
from ancfdae.numerics.arrays import STEP, Array


@final
@dataclass(frozen=True, eq=False)
class LoadWork:
    """Power of one load with its partials, complex steps of a few vectors."""

    item: LoadInput
    n_b: int

    def value(self, t: Array, q: Array, v: Array) -> Array:
        """Return the power, shape (k,)."""
        return self._power(self.item, t, q, v)

    def partials(self, t: Array, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return partial derivatives with respect to q, v and b; shape (k, n) each."""
        item, b = self.item, np.zeros((len(t), self.n_b))
        U, V = item.vectors.of(q), item.vectors.of(v)
        shape = U.shape[1:]
        # All directions at once, in a leading axis.
        step = 1j * STEP * np.eye(U[0].size).reshape(-1, 1, *shape)
        on_U, on_V = (
            np.moveaxis(_product(item, *moved, t).imag / STEP, 0, -1).reshape(len(t), *shape)
            for moved in ((U + step, V + 0 * step), (U + 0 * step, V + step))
        )
        for i in item.active:
            b[:, i] = self._power(item.moved(i), t, q, v).imag / STEP
        return item.vectors.lift(on_U), item.vectors.lift(on_V), b

    def _power(self, item: LoadInput, t: Array, q: Array, v: Array) -> Array:
        return _product(item, item.vectors.of(q), item.vectors.of(v), t)


def _product(item: LoadInput, U: Array, V: Array, t: Array) -> Array:
    """F . V over the leading axes."""
    factor = np.broadcast_to(item.factor(t, 0), U.shape[:-2])
    return np.asarray(factor * np.sum(item.force(U, V) * V, axis=(-2, -1)))
