"""Constant linear maps, kept in whichever form multiplies faster."""

from __future__ import annotations

from functools import cached_property
from typing import Any, final

import numpy as np
import scipy

from ancfdae.numerics.arrays import Array

# A sparse product costs 7 us of overhead, a dense one 1 us and 0.2 ns per entry (measured with
# SciPy 1.17 on one core), so up to this many entries the dense form wins.
_DENSE_ENTRIES = 30_000


@final
class LinearMap:
    """A constant matrix, shape (n, m), that is only ever multiplied with."""

    def __init__(self, matrix: scipy.sparse.csr_array) -> None:
        self._small = matrix.shape[0] * matrix.shape[1] <= _DENSE_ENTRIES
        self._form = matrix.toarray() if self._small else matrix

    @cached_property
    def _transposed(self) -> Any:
        return np.ascontiguousarray(self._form.T) if self._small else self._form.T.tocsr()

    @staticmethod
    def of(rows: Array, columns: Array, values: Array, shape: tuple[int, int]) -> LinearMap:
        """Return the map with these entries; entries at the same place are summed."""
        return LinearMap(scipy.sparse.csr_array((values, (rows, columns)), shape=shape))

    def __call__(self, x: Array) -> Array:
        """Multiply a vector, shape (m,)."""
        return np.asarray(self._form @ x)

    def columns(self, x: Array) -> Array:
        """Multiply the columns of an array, shape (m, k)."""
        return np.asarray(self._form @ x)

    def rows(self, x: Array) -> Array:
        """Multiply each row of an array, shape (k, m) to (k, n)."""
        return np.asarray((self._form @ x.T).T)

    def rows_transposed(self, x: Array) -> Array:
        """Multiply each row with the transposed matrix, shape (k, n) to (k, m)."""
        return np.asarray((self._transposed @ x.T).T)

    def transposed(self, x: Array) -> Array:
        """Multiply with the transposed (not conjugated) matrix."""
        return np.asarray(self._transposed @ x)
