"""Fixed sparsity patterns: a matrix is a vector of values on its pattern.

All matrices of a mechanical system keep their pattern during a run, so they
are passed around as plain value vectors. That makes sums of matrices sums of
vectors, and batched assembly one product with a constant 0/1 matrix.
"""

from __future__ import annotations

from typing import final

import numpy as np
import scipy

from ancfdae.numerics.arrays import Array

# Up to this many entries a dense product beats a sparse one (measured: 84 x 84 dense times
# 6 columns 5 us, sparse 20 us).
_DENSE_ENTRIES = 40_000


@final
class Pattern:
    """Positions of the entries of a matrix, sorted; duplicates in `rows`, `columns` are merged."""

    def __init__(self, shape: tuple[int, int], rows: Array, columns: Array) -> None:
        self.shape = shape
        flat = np.asarray(rows, dtype=np.int64) * shape[1] + columns
        # `np.unique` hashes, which takes 20 times as long: the entries are almost in order.
        flat.sort(kind="stable")
        self._flat = flat[np.append(flat[:1] == flat[:1], flat[1:] != flat[:-1])]
        self.rows = self._flat // max(shape[1], 1)
        self.columns = self._flat - self.rows * shape[1]
        self._indptr = np.searchsorted(self.rows, np.arange(shape[0] + 1))
        self._dense = shape[0] * shape[1] <= _DENSE_ENTRIES

    @staticmethod
    def full(shape: tuple[int, int]) -> Pattern:
        """Return the pattern of a dense matrix; its values are ``matrix.ravel()``."""
        rows, columns = np.indices(shape)
        return Pattern(shape, rows.ravel(), columns.ravel())

    @property
    def size(self) -> int:
        """Number of stored entries."""
        return len(self._flat)

    def index(self, rows: Array, columns: Array) -> Array:
        """Where the given positions stand in the value vector; they must be in the pattern."""
        return np.searchsorted(
            self._flat, np.asarray(rows, dtype=np.int64) * self.shape[1] + columns
        )

    def gather(self, rows: Array, columns: Array, contributions: Array) -> Array:
        """Return the values that sum contributions at the given positions."""
        values = np.zeros(self.size, dtype=contributions.dtype)
        np.add.at(values, self.index(rows, columns), contributions)
        return values

    def dense(self, values: Array) -> Array:
        """Return the matrix as a two-dimensional array."""
        matrix = np.zeros(self.shape[0] * self.shape[1], dtype=values.dtype)
        matrix[self._flat] = values
        return matrix.reshape(self.shape)

    def csr(self, values: Array) -> scipy.sparse.csr_array:
        """Return the matrix in compressed sparse row form."""
        return scipy.sparse.csr_array((values, self.columns, self._indptr), shape=self.shape)

    def dot(self, values: Array, x: Array) -> Array:
        """Product of the matrix with a vector or with the columns of an array."""
        if self._dense:
            return self.dense(values) @ x
        return np.asarray(self.csr(values) @ x)

    def dot_transposed(self, values: Array, x: Array) -> Array:
        """Product of the transposed (not conjugated) matrix with a vector or columns."""
        if self._dense:
            return self.dense(values).T @ x
        return np.asarray(self.csr(values).T @ x)


@final
class Stack:
    """Two matrices with the same columns, one above the other, multiplied in one product."""

    def __init__(self, upper: Pattern, lower: Pattern) -> None:
        self._upper, self._lower = upper, lower
        rows, columns = upper.shape[0] + lower.shape[0], upper.shape[1]
        self._small = rows * columns <= _DENSE_ENTRIES
        # Transposed; what is zero by the patterns is written once.
        self._matrix = np.zeros((columns, rows) if self._small else (0, 0))
        self._flat_upper = upper.columns * rows + upper.rows
        self._flat_lower = lower.columns * rows + lower.rows + upper.shape[0]

    def dot_rows(self, upper: Array, lower: Array, x: Array) -> Array:
        """Multiply each row of an array, shape (k, n_columns) to (k, n_rows)."""
        if not self._small:
            products = [self._upper.dot(upper, x.T), self._lower.dot(lower, x.T)]
            return np.concatenate(products).T
        entries = self._matrix.reshape(-1)
        entries[self._flat_upper], entries[self._flat_lower] = upper, lower
        product: Array = x @ self._matrix
        return product
