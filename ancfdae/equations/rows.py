"""Values of a user's function at many complex states, in one call where it works on arrays.

A function of q, shape (n,), that is written in elementary operations on q[0], q[1], ... takes an
array (n, k) just as well and returns k values beside each other. Whether it does shows in every
call: one of the states in turn is evaluated alone, and the imaginary parts, which derivatives are
made of, must agree. A function that fails is evaluated state by state from then on.
"""

from collections.abc import Callable
from typing import final

import numpy as np

from ancfdae.numerics.arrays import Array
from ancfdae.numerics.contour import FAILURES

# Relative difference that is round-off.
_ROUND_OFF = 1e-9


@final
class RowCalls:
    """Evaluates functions of one system at rows of states; numbers like t are shared."""

    def __init__(self, sizes: set[int]) -> None:
        # With as many states as coordinates an array of constants would pass for one of states.
        self._sizes, self._alone, self._calls = sizes, set[str](), 0

    def of(self, function: Callable[..., Array], x: Array, *shared: Array | complex) -> Array:
        """Return function(row, *shared) for every row of x, shape (k, *shape of the value)."""
        name = function.__name__
        together = None
        if name not in self._alone:
            together = self._together(function, x, shared)
        if together is not None:
            return together
        self._alone.add(name)
        return np.array([function(row, *shared) for row in x])

    def _together(
        self, function: Callable[..., Array], x: Array, shared: tuple[Array | complex, ...]
    ) -> Array | None:
        rows, k = x, len(x)
        while len(rows) in self._sizes:
            rows = np.concatenate([rows, x[:1]])
        self._calls += 1
        row = self._calls % k
        alone = np.asarray(function(x[row], *shared))
        try:
            values = np.asarray(function(rows.T, *shared))
        except FAILURES:
            return None
        if values.shape != (*alone.shape, len(rows)):
            return None
        imaginary = values.imag
        gap = np.abs(imaginary[..., row] - alone.imag).max(initial=0.0)
        if not gap <= _ROUND_OFF * np.abs(imaginary).max(initial=0.0):
            return None
        return np.moveaxis(values, -1, 0)[:k]
