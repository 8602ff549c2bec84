"""Constant linear maps."""

from __future__ import annotations

from typing import final

import scipy

from ancfdae.kernels import csr_rows, csr_rows_transposed
from ancfdae.numerics.arrays import Array


@final
class LinearMap:
    """A constant matrix, shape (n, m), that is only ever multiplied with; `csr` are its arrays."""

    def __init__(self, matrix: scipy.sparse.csr_array) -> None:
        first, columns = (x.astype("int32", copy=False) for x in (matrix.indptr, matrix.indices))
        self.csr = first, columns, matrix.data
        self._width = matrix.shape[1]

    @staticmethod
    def of(rows: Array, columns: Array, values: Array, shape: tuple[int, int]) -> LinearMap:
        """Return the map with these entries; entries at the same place are summed."""
        return LinearMap(scipy.sparse.csr_array((values, (rows, columns)), shape=shape))

    def __call__(self, x: Array) -> Array:
        """Multiply a vector, shape (m,), or each row of an array, (k, m) to (k, n)."""
        return csr_rows(*self.csr, x)

    def transposed(self, x: Array) -> Array:
        """Multiply each row with the transposed (not conjugated) matrix, (k, n) to (k, m)."""
        return csr_rows_transposed(*self.csr, x, self._width)
