"""Constant linear maps."""

from __future__ import annotations

from typing import final

import numpy as np

from ancfdae.kernels import Csr, csr_rows, csr_rows_transposed
from ancfdae.numerics.arrays import Array


@final
class LinearMap:
    """A constant matrix, shape (n, m), that is only ever multiplied with.

    `csr` are its rows: where they begin, columns and values.
    """

    def __init__(self, csr: Csr, width: int) -> None:
        first, columns, values = csr
        self.csr = first.astype(np.int32, copy=False), columns.astype(np.int32, copy=False), values
        self._width = width

    @staticmethod
    def of(rows: Array, columns: Array, values: Array, shape: tuple[int, int]) -> LinearMap:
        """Return the map with these entries; entries at the same place add."""
        order = np.argsort(rows, kind="stable")
        first = np.append(0, np.cumsum(np.bincount(rows, minlength=shape[0])))
        return LinearMap((first, columns[order], values[order]), shape[1])

    def __call__(self, x: Array) -> Array:
        """Multiply a vector, shape (m,), or each row of an array, (k, m) to (k, n)."""
        return csr_rows(*self.csr, x)

    def transposed(self, x: Array) -> Array:
        """Multiply each row with the transposed (not conjugated) matrix, (k, n) to (k, m)."""
        return csr_rows_transposed(*self.csr, x, self._width)
