"""Factorisation of the saddle-point matrices that all methods share.

    [ K      B^T ]     K on the system's pattern (n x n),
    [ B      0   ]     B on its constraint pattern (m x n).

The matrix is scaled symmetrically before it is factorised, coordinates by
1/sqrt(weight) and constraints so that their scaled rows have unit length:
pivoting then does not depend on the units of the scene. It is factorised as a
band after a reverse Cuthill-McKee numbering, or by SuperLU after one of minimum
degree where the band is wide (trees and grids of bodies); see `orders`.
"""

from __future__ import annotations

import abc
import warnings
from collections.abc import Iterator
from typing import Any, final

import numpy as np
import scipy

from ancfdae.errors import SingularMatrix
from ancfdae.kernels import band_factor, band_solve
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.orders import little_fill, narrow_band
from ancfdae.numerics.patterns import Pattern

# Half-width at which a band takes as long as SuperLU (docs/measurements.md, section 9).
_BAND_HALF_WIDTH = 64
# In the order as given; rows are exchanged where a pivot is below a tenth of its column's largest.
_SUPERLU: dict[str, Any] = {
    "permc_spec": "NATURAL",
    "diag_pivot_thresh": 0.1,
    "panel_size": 1,
    "options": {"SymmetricMode": True},
}


class Factorization(abc.ABC):
    """A factorised matrix; right-hand sides are vectors or columns of an array."""

    @abc.abstractmethod
    def solve(self, right: Array) -> Array:
        """Solve with the matrix."""

    @abc.abstractmethod
    def solve_transposed(self, right: Array) -> Array:
        """Solve with the transposed (not conjugated) matrix."""


class _Storage(abc.ABC):
    """Where values of K, of B and of B again go, and how they are factorised."""

    @abc.abstractmethod
    def factor(self, K: Array, B: Array) -> Factorization:
        """Factorise the matrix of these values.

        Raises SingularMatrix if it is singular to working precision or not finite.
        """


@final
class SaddlePoint:
    """Saddle-point matrices of one system: constant patterns of K and B, numbering and scaling.

    The weights of the coordinates, (n,), are positive, usually the diagonal of the mass matrix;
    the rows of constraints are scaled by the values of B at the start.
    """

    def __init__(
        self,
        pattern: Pattern,
        constraint_pattern: Pattern,
        weights: Array,
        constraint_values: Array,
    ) -> None:
        n, m = pattern.shape[0], constraint_pattern.shape[0]
        self.size = n + m
        scale = 1.0 / np.sqrt(weights)
        squared = (constraint_values.real * scale[constraint_pattern.columns]) ** 2
        length = np.sqrt(np.bincount(constraint_pattern.rows, squared, minlength=m))
        self.scale = np.concatenate([scale, 1.0 / np.where(length > 0, length, 1.0)])
        self._storage = _choose_storage(self.scale, pattern, constraint_pattern)

    def factor(self, K: Array, B: Array) -> Factorization:
        """Factorise for the given values of K and B.

        Raises SingularMatrix for one that is singular to working precision or not finite.
        """
        return self._storage.factor(K, B)

    def factor_each(self, K: Array, B: Array) -> Iterator[Factorization]:
        """Factorise matrices, given as rows of values, as they are asked for."""
        return map(self.factor, K, B)


def _choose_storage(scale: Array, pattern: Pattern, constraint_pattern: Pattern) -> _Storage:
    order = narrow_band(pattern, constraint_pattern)
    rows, columns = _places(order, pattern, constraint_pattern)
    half_width = int(np.max(np.abs(rows - columns), initial=0))
    if half_width <= _BAND_HALF_WIDTH:
        return _BandStorage(scale, order, rows, columns, half_width)
    order = little_fill(pattern, constraint_pattern)
    return _SparseStorage(scale, order, *_places(order, pattern, constraint_pattern))


def _places(order: Array, pattern: Pattern, constraint_pattern: Pattern) -> tuple[Array, Array]:
    """Return rows and columns of all entries in an order of the unknowns."""
    place = np.empty(len(order), dtype=np.int32)
    place[order] = np.arange(len(order))
    r, c = place[constraint_pattern.rows + pattern.shape[0]], place[constraint_pattern.columns]
    rows = np.concatenate([place[pattern.rows], r, c])
    return rows, np.concatenate([place[pattern.columns], c, r])


@final
class _BandStorage(_Storage):
    def __init__(
        self, scale: Array, order: Array, rows: Array, columns: Array, half_width: int
    ) -> None:
        self._scale, self._order, self._half_width = scale, order, half_width
        # LAPACK band storage with room for fill-in: entry (i, j) at row 2 k + i - j of column j.
        self._flat = np.multiply(columns, 3 * half_width, dtype=np.int64)
        self._flat += rows
        self._flat += 2 * half_width
        numbered = scale[order]
        self._factors = numbered[rows]
        self._factors *= numbered[columns]

    def factor(self, K: Array, B: Array) -> Factorization:
        size, half_width = len(self._order), self._half_width
        lu, pivots, info = band_factor(K, B, self._factors, self._flat, size, half_width)
        if info > 0:
            raise SingularMatrix(f"zero pivot {info} of {size}")
        if info < 0:
            raise SingularMatrix("the saddle-point matrix is not finite")
        return _BandFactorization(lu, pivots, half_width, self._order, self._scale)


@final
class _BandFactorization(Factorization):
    def __init__(
        self, lu: Array, pivots: Array, half_width: int, order: Array, scale: Array
    ) -> None:
        self._factors = lu, pivots, half_width, order, scale

    def solve(self, right: Array) -> Array:
        # Right-hand sides as rows of an array, one after the other in memory.
        return band_solve(*self._factors, right.T, False).T

    def solve_transposed(self, right: Array) -> Array:
        return band_solve(*self._factors, right.T, True).T


@final
class _SparseStorage(_Storage):
    def __init__(self, scale: Array, order: Array, rows: Array, columns: Array) -> None:
        self._order, self._scale = order, scale[order]
        self._sorted = np.lexsort((rows, columns))
        self._rows = rows[self._sorted]
        self._first = np.searchsorted(columns[self._sorted], np.arange(len(order) + 1))
        self._factors = self._scale[rows] * self._scale[columns]

    def factor(self, K: Array, B: Array) -> Factorization:
        values = self._factors * np.concatenate([K, B, B])
        if not np.isfinite(values.sum()):
            raise SingularMatrix("the saddle-point matrix is not finite")
        size = len(self._scale)
        matrix = scipy.sparse.csc_array(
            (values[self._sorted], self._rows, self._first), shape=(size, size)
        )
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                lu = scipy.sparse.linalg.splu(matrix, **_SUPERLU)
            except (RuntimeError, Warning) as error:
                raise SingularMatrix(str(error)) from error
        return _SparseFactorization(lu, values.dtype, self._order, self._scale)


@final
class _SparseFactorization(Factorization):
    def __init__(self, lu: Any, dtype: np.dtype, order: Array, scale: Array) -> None:
        self._lu, self._dtype, self._order, self._scale = lu, dtype, order, scale

    def solve(self, right: Array) -> Array:
        return self._solved(right, "N")

    def solve_transposed(self, right: Array) -> Array:
        return self._solved(right, "T")

    def _solved(self, right: Array, transposed: str) -> Array:
        if right.dtype.kind == "c" and self._dtype.kind != "c":
            return self._solved(right.real, transposed) + 1j * self._solved(right.imag, transposed)
        # Undoes the symmetric scaling.
        scale = self._scale if right.ndim == 1 else self._scale[:, None]
        scaled = np.ascontiguousarray(scale * right[self._order], dtype=self._dtype)
        solution = np.empty_like(scaled)
        solution[self._order] = scale * self._lu.solve(scaled, transposed)
        return solution
