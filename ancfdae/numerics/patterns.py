"""Fixed sparsity patterns, for which a matrix is a vector of values, and constant linear maps.

All matrices of a mechanical system keep their pattern during a run, so they are passed around as
plain value vectors. That makes sums of matrices sums of vectors, and batched assembly one product
with a constant 0/1 matrix.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, TypeAlias, final

import numpy as np
import scipy

from ancfdae.kernels import csr_rows
from ancfdae.numerics.arrays import Array

#: A matrix in compressed sparse rows: starts of rows, columns, values.
Csr: TypeAlias = tuple[Array, Array, Array]


@final
class SparsityPattern:
    """Positions of the entries of a matrix, sorted; duplicates in `rows`, `columns` are merged.

    The column of every entry is stored, with the index of the first entry of every row; row indices
    are computed when they are first needed: a scene of 10,000 elements has four million entries.

    `beside` are constraint patterns with which this one was factorised, each with the positions of
    all entries in a band. `checked` are the saddle-point matrices whose constraints were last found
    to be independent, with the numbers that show it. Copies of the pattern have neither.
    """

    beside: tuple[tuple[SparsityPattern, Any], ...] = ()
    checked: tuple[Any, tuple[Any, ...]] | None = None

    def __init__(self, shape: tuple[int, int], rows: Array, columns: Array) -> None:
        self.shape = shape
        flat = self._flattened(rows, columns)
        # `np.unique` hashes, which takes 20 times as long: the entries are almost in order.
        flat.sort(kind="stable")
        flat = flat[np.append(flat[:1] == flat[:1], flat[1:] != flat[:-1])]
        starts = np.arange(shape[0] + 1) * shape[1]
        self._first = np.searchsorted(flat, starts).astype(np.int32)
        self.columns = (flat % max(shape[1], 1)).astype(np.int32)

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes of the pattern that are pickled and copied."""
        return {name: x for name, x in self.__dict__.items() if name not in ("beside", "checked")}

    @staticmethod
    def full(shape: tuple[int, int]) -> SparsityPattern:
        """Return the pattern of a dense matrix, whose values are ``matrix.ravel()``."""
        rows, columns = np.indices(shape)
        return SparsityPattern(shape, rows.ravel(), columns.ravel())

    @property
    def size(self) -> int:
        """Number of stored entries of the pattern, nnz."""
        return len(self.columns)

    @cached_property
    def rows(self) -> Array:
        """Row index of every stored entry, shape (nnz,)."""
        return np.repeat(np.arange(self.shape[0], dtype=np.int32), np.diff(self._first))

    @cached_property
    def diagonal(self) -> Array:
        """Indices of the diagonal entries in the value vector, (n,); all must be present."""
        n = np.arange(self.shape[0])
        return self.index(n, n)

    @cached_property
    def determined(self) -> tuple[Array, Array]:
        """Masks of the rows, and of the columns, of the square part of the pattern.

        For Phi_q these are the constraints, and the coordinates that they determine alone (Dulmage
        & Mendelsohn 1958). A matching pairs rows with columns and leaves some columns free. Paths
        go from a column to the rows in which it has entries, and from a row to its partner. The
        square part is not reached from free columns; its rows have entries in no other columns.
        """
        n_rows, n = self.shape
        source = n_rows + n
        matrix = self.csr(np.ones(self.size))
        match = scipy.sparse.csgraph.maximum_bipartite_matching(matrix, "row")
        free, bound = np.flatnonzero(match < 0), np.flatnonzero(match >= 0)
        begins = np.concatenate([self.columns, n + match[bound], np.full(len(free), source)])
        ends = np.concatenate([n + self.rows, bound, free])
        shape = source + 1, source + 1
        graph = scipy.sparse.csr_array((np.ones(len(ends)), (begins, ends)), shape)
        reached = scipy.sparse.csgraph.breadth_first_order(graph, source, return_predecessors=False)
        rest = np.ones(source + 1, dtype=bool)
        rest[reached] = False
        return rest[n:source], rest[:n]

    @cached_property
    def used(self) -> tuple[Array, Array]:
        """Columns with entries, and for each entry the index of its column among them, (nnz,)."""
        columns, places = np.unique(self.columns, return_inverse=True)
        return columns, places

    @property
    def places(self) -> tuple[Array, Array]:
        """Start of each row in the value vector, (n_rows + 1,), and column indices, (nnz,)."""
        return self._first, self.columns

    def index(self, rows: Array, columns: Array) -> Array:
        """Return indices in the value vector, in their shape, of positions in the pattern.

        Rows and columns are broadcast.
        """
        entries = self._flattened(self.rows, self.columns)
        return np.searchsorted(entries, self._flattened(rows, columns))

    def _flattened(self, rows: Array, columns: Array) -> Array:
        """Return indices of entries, in their shape, in the dense matrix flattened row by row."""
        return np.asarray(rows, dtype=np.int64) * self.shape[1] + columns

    def gather(self, rows: Array, columns: Array, contributions: Array) -> Array:
        """Return the value vector, (nnz,), that sums contributions at the given positions."""
        values = np.zeros(self.size, dtype=contributions.dtype)
        np.add.at(values, self.index(rows, columns), contributions)
        return values

    def dense(self, values: Array) -> Array:
        """Return the matrix with these values, or one for each row, (..., n_rows, n_columns)."""
        matrix = np.zeros((*values.shape[:-1], self.shape[0] * self.shape[1]), dtype=values.dtype)
        matrix[..., self._flattened(self.rows, self.columns)] = values
        return matrix.reshape(*values.shape[:-1], *self.shape)

    def csr(self, values: Array) -> scipy.sparse.csr_array:
        """Return the matrix with these values as a SciPy array in compressed sparse rows."""
        return scipy.sparse.csr_array((values, self.columns, self._first), shape=self.shape)

    def rows_of(self, values: Array) -> Csr:
        """Return the matrix with these values as the three arrays of compressed sparse rows."""
        return self._first, self.columns, values

    def dot(self, values: Array, x: Array) -> Array:
        """Return the matrix times a vector, (n_columns,), or columns, (n_columns, k)."""
        return csr_rows(self._first, self.columns, values, x.T, None).T

    def dot_transposed(self, values: Array, x: Array) -> Array:
        """Return the transposed (not conjugated) matrix times a vector, (n_rows,), or columns."""
        return csr_rows(self._first, self.columns, values, x.T, self.shape[1]).T


@final
class LinearMap:
    """A constant matrix, shape (n, m), that is used in products only.

    `csr` holds its rows: starts of rows, columns and values.
    """

    def __init__(self, csr: Csr, width: int) -> None:
        first, columns, values = csr
        self.csr = first.astype(np.int32, copy=False), columns.astype(np.int32, copy=False), values
        self._width = width

    @staticmethod
    def of(rows: Array, columns: Array, values: Array, shape: tuple[int, int]) -> LinearMap:
        """Return the map with these entries; entries at the same position add up."""
        order = np.argsort(rows, kind="stable")
        first = np.append(0, np.cumsum(np.bincount(rows, minlength=shape[0])))
        return LinearMap((first, columns[order], values[order]), shape[1])

    def __call__(self, x: Array) -> Array:
        """Return the matrix times a vector, (m,), or times each row, (k, m) to (k, n)."""
        return csr_rows(*self.csr, x, None)

    def transposed(self, x: Array) -> Array:
        """Return the transposed (not conjugated) matrix times each row, (k, n) to (k, m)."""
        return csr_rows(*self.csr, x, self._width)
