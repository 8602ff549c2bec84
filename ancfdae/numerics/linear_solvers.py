"""Factorisation of the saddle-point matrices that all methods share.

    [ K      B^T ]     K on the system's pattern (n x n),
    [ B      0   ]     B on its constraint pattern (m x n).

The matrix is scaled symmetrically before it is factorised, coordinates by
1/sqrt(weight) and constraints so that their scaled rows have unit length:
pivoting then does not depend on the units of the scene. Small systems are
factorised densely; larger ones as a band after a reverse Cuthill-McKee
numbering, which puts multipliers beside their nodes; SuperLU takes over where
the band is wide (many closed loops meeting in one body).
"""

from __future__ import annotations

import abc
import warnings
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Any, TypeAlias, final

import numpy as np
import scipy

from ancfdae.errors import SingularMatrix
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import Pattern

# Measured on chains of spatial elements (docs/measurements.md, section 9): below this size dense
# LU is as fast as the band.
_DENSE_SIZE = 60
# Band LU costs N k^2; at k = 25 it is 3.6 times faster than SuperLU, so they meet near here.
_BAND_HALF_WIDTH = 64


@lru_cache(maxsize=8)
def _lapack(factor: str, solve: str, dtype: np.dtype) -> tuple[Any, Any]:
    """LAPACK routines for a type; looking them up costs as much as a small solve."""
    found = scipy.linalg.get_lapack_funcs((factor, solve), dtype=dtype)
    return found[0], found[1]


# Solves for a right side, or with the transposed (not conjugated) matrix.
_Solver: TypeAlias = Callable[[Array, bool], Array]


@final
class Factorization:
    """A factorised matrix; right-hand sides are vectors or columns of an array."""

    def __init__(self, solver: _Solver, scale: Array, complex_matrix: bool) -> None:
        self._solver, self._scale, self._complex = solver, scale, complex_matrix

    def solve(self, right: Array) -> Array:
        """Solve with the matrix."""
        return self._solved(right, False)

    def solve_transposed(self, right: Array) -> Array:
        """Solve with the transposed (not conjugated) matrix."""
        return self._solved(right, True)

    def _solved(self, right: Array, transposed: bool) -> Array:
        if right.dtype.kind == "c" and not self._complex:
            return self._solved(right.real, transposed) + 1j * self._solved(right.imag, transposed)
        # Undoes the symmetric scaling.
        scale = self._scale if right.ndim == 1 else self._scale[:, None]
        return scale * self._solver(scale * right, transposed)


class _Storage(abc.ABC):
    """Where the scaled values go, and how they are factorised."""

    @abc.abstractmethod
    def factor(self, values: Array) -> _Solver:
        """Factorise the matrix of these values; raises SingularMatrix."""


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
        r, c = constraint_pattern.rows + n, constraint_pattern.columns
        rows = np.concatenate([pattern.rows, r, c])
        columns = np.concatenate([pattern.columns, c, r])
        self._factors = self.scale[rows] * self.scale[columns]
        self._storage = _choose_storage(self.size, rows, columns)

    def factor(self, K: Array, B: Array) -> Factorization:
        """Factorise for the given values of K and B; see `factor_each`."""
        return next(self.factor_each(K[None], B[None]))

    def factor_each(self, K: Array, B: Array) -> Iterator[Factorization]:
        """Factorise matrices, given as rows of values, as they are asked for.

        Raises SingularMatrix for one that is singular to working precision or not finite.
        """
        # Written row by row: matrices may come as columns in memory.
        n, m = K.shape[1], B.shape[1]
        scaled = np.empty((len(K), n + 2 * m), dtype=np.result_type(K, B))
        np.multiply(K, self._factors[:n], out=scaled[:, :n])
        np.multiply(B, self._factors[n : n + m], out=scaled[:, n : n + m])
        scaled[:, n + m :] = scaled[:, n : n + m]
        for values, finite in zip(scaled, np.isfinite(scaled.sum(axis=1)), strict=True):
            if not finite:
                raise SingularMatrix("the saddle-point matrix is not finite")
            yield Factorization(self._storage.factor(values), self.scale, values.dtype.kind == "c")


def _choose_storage(size: int, rows: Array, columns: Array) -> _Storage:
    if size <= _DENSE_SIZE:
        return _DenseStorage(size, rows, columns)
    graph = scipy.sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(size, size))
    order = scipy.sparse.csgraph.reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.int64)
    place = np.empty(size, dtype=np.int64)
    place[order] = np.arange(size)
    half_width = int(np.max(np.abs(place[rows] - place[columns])))
    if half_width <= _BAND_HALF_WIDTH:
        return _BandStorage(order, place, place[rows], place[columns], half_width)
    return _SparseStorage(size, rows, columns)


@final
class _DenseStorage(_Storage):
    def __init__(self, size: int, rows: Array, columns: Array) -> None:
        self._size = size
        # The matrix is built transposed in C order, which is Fortran order of the matrix.
        self._flat = columns * size + rows

    def factor(self, values: Array) -> _Solver:
        matrix = np.zeros(self._size * self._size, dtype=values.dtype)
        matrix[self._flat] = values
        getrf, getrs = _lapack("getrf", "getrs", values.dtype)
        lu, pivots, info = getrf(matrix.reshape(self._size, self._size).T, overwrite_a=True)
        _require_pivots(info, self._size)

        def solve(right: Array, transposed: bool) -> Array:
            return np.asarray(getrs(lu, pivots, right, trans=transposed)[0])

        return solve


@final
class _BandStorage(_Storage):
    def __init__(
        self, order: Array, place: Array, rows: Array, columns: Array, half_width: int
    ) -> None:
        self._order, self._place, self._half_width = order, place, half_width
        size = len(order)
        # LAPACK band storage with room for fill-in: entry (i, j) at row 2 k + i - j; built
        # transposed in C order as above.
        self._shape = (size, 3 * half_width + 1)
        self._flat = columns * self._shape[1] + 2 * half_width + rows - columns

    def factor(self, values: Array) -> _Solver:
        k, order, place = self._half_width, self._order, self._place
        band = np.zeros(self._shape[0] * self._shape[1], dtype=values.dtype)
        band[self._flat] = values
        gbtrf, gbtrs = _lapack("gbtrf", "gbtrs", values.dtype)
        lu, pivots, info = gbtrf(band.reshape(self._shape).T, k, k, overwrite_ab=True)
        _require_pivots(info, len(order))

        def solve(right: Array, transposed: bool) -> Array:
            # LAPACK takes right-hand sides one after the other in memory: as rows of an array.
            rows = np.atleast_2d(right.T).take(order, axis=1)
            x, _ = gbtrs(lu, k, k, rows.T, pivots, trans=transposed, overwrite_b=True)
            result: Array = x.T.take(place, axis=1)
            return result.T if right.ndim == 2 else result[0]

        return solve


@final
class _SparseStorage(_Storage):
    def __init__(self, size: int, rows: Array, columns: Array) -> None:
        self._size = size
        self._order = np.lexsort((rows, columns))
        self._rows = rows[self._order]
        self._indptr = np.searchsorted(columns[self._order], np.arange(size + 1))

    def factor(self, values: Array) -> _Solver:
        matrix = scipy.sparse.csc_array(
            (values[self._order], self._rows, self._indptr), shape=(self._size, self._size)
        )
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                lu = scipy.sparse.linalg.splu(matrix)
            except (RuntimeError, Warning) as error:
                raise SingularMatrix(str(error)) from error

        def solve(right: Array, transposed: bool) -> Array:
            right = np.ascontiguousarray(right, dtype=values.dtype)
            return np.asarray(lu.solve(right, "T" if transposed else "N"))

        return solve


def _require_pivots(info: int, size: int) -> None:
    if info > 0:
        raise SingularMatrix(f"zero pivot {info} of {size}")
