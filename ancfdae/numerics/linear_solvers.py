"""Factorisation of the saddle-point matrices that all methods share.

    [ K      B^T ]     K on the system's pattern (n x n),
    [ B      0   ]     B on its constraint pattern (m x n).

Unknowns are numbered by reverse Cuthill-McKee, multipliers behind their coordinates. Where K is
symmetric and positive definite, L D L^T then needs no exchange of rows: the pivots of coordinates
are positive, those of multipliers negative. Signs do not depend on the units of the scene; a pivot
that has not its sign tells that K is not positive definite.

Such a matrix, and one that is not symmetric, is scaled symmetrically, coordinates by
1/sqrt(weight) and constraints so that their scaled rows have unit length (pivoting then does not
depend on the units either), and factorised with exchanges, as a band; SuperLU takes over where the
band is wide (many closed loops meeting in one body).
"""

from __future__ import annotations

import abc
import warnings
from functools import cached_property
from typing import Any, TypeAlias, final

import numpy as np
import scipy

from ancfdae.errors import SingularMatrix
from ancfdae.kernels import add_scaled, band_factor, band_solve, ldl_factor, ldl_solve
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import Pattern

# Band LU costs N k^2; at k = 25 it is 3.6 times faster than SuperLU, so they meet near here.
_BAND_HALF_WIDTH = 64

# Terms of a sum of matrices: numbers and values on the pattern.
Terms: TypeAlias = tuple[tuple[float, Array], ...]


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
    the rows of constraints are scaled by the values of B at the start. K is symmetric where that
    is said.
    """

    def __init__(
        self,
        pattern: Pattern,
        constraint_pattern: Pattern,
        weights: Array,
        constraint_values: Array,
        symmetric: bool = False,
    ) -> None:
        self._patterns, m = (pattern, constraint_pattern), constraint_pattern.shape[0]
        scale = 1.0 / np.sqrt(weights)
        squared = (constraint_values.real * scale[constraint_pattern.columns]) ** 2
        length = np.sqrt(np.bincount(constraint_pattern.rows, squared, minlength=m))
        self.scale = np.concatenate([scale, 1.0 / np.where(length > 0, length, 1.0)])
        self._order, self._place, self._half_width = _numbered(*self._patterns)
        self._envelope = None
        if symmetric and self._half_width <= _BAND_HALF_WIDTH:
            self._envelope = _Envelope(*self._patterns, self._order, self._place)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.scale)

    def factor(self, K: Array, B: Array) -> Factorization:
        """Factorise for the given values of K and B.

        Raises SingularMatrix for one that is singular to working precision or not finite.
        """
        return self.factor_sum(((1.0, K),), B)

    def factor_sum(self, terms: Terms, B: Array) -> Factorization:
        """Factorise for a sum K of at most three terms, each a number and values.

        Raises SingularMatrix as `factor`.
        """
        factors = self._envelope and self._envelope.factor(terms, B)
        if factors:
            return factors
        (s, K), *more = terms
        K = K if s == 1.0 else s * K
        for s, values in more:
            K = add_scaled(K, s, values)
        return self._storage.factor(K, B)

    @cached_property
    def _storage(self) -> _Storage:
        """What factorises with exchanges."""
        rows, columns = _entries(*self._patterns)
        if self._half_width > _BAND_HALF_WIDTH:
            return _SparseStorage(self.scale, rows, columns)
        at = self._place[rows], self._place[columns]
        return _BandStorage(self.scale, self._order, *at, self._half_width)


def _entries(pattern: Pattern, constraint_pattern: Pattern) -> tuple[Array, Array]:
    """Return rows and columns of all entries: of K, of B, and of B^T."""
    r, c = constraint_pattern.rows + pattern.shape[0], constraint_pattern.columns
    rows = np.concatenate([pattern.rows, r, c])
    return rows, np.concatenate([pattern.columns, c, r])


def _numbered(pattern: Pattern, constraint_pattern: Pattern) -> tuple[Array, Array, int]:
    """Return the order of unknowns, their places in it, and the half width of the band.

    The band is narrow, and each multiplier stands behind its coordinates. These are eliminated
    first, by pivots of K; what a constraint asks is then met to the round-off of its own row, and
    not to that of a stiff body's.
    """
    n = pattern.shape[0]
    size = n + constraint_pattern.shape[0]
    rows, columns = _entries(pattern, constraint_pattern)
    graph = scipy.sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(size, size))
    B = graph[n:, :n]
    coordinates = scipy.sparse.csgraph.reverse_cuthill_mckee(
        (graph[:n, :n] + B.T @ B).tocsr(), symmetric_mode=True
    )
    key = np.zeros(size)
    key[coordinates] = np.arange(n)
    own = rows >= n
    np.maximum.at(key, rows[own], key[columns[own]])
    # Coordinates come before multipliers of the same place.
    order = np.argsort(key, kind="stable")
    place = np.empty(size, dtype=np.int64)
    place[order] = np.arange(size)
    return order, place, int(np.max(np.abs(place[rows] - place[columns]), initial=0))


@final
class _Envelope:
    """L D L^T of symmetric K: the lower triangle, each column from its diagonal to its end.

    A column ends with its last entry, but not before the one to its left, so that the factors fill
    the same places.
    """

    def __init__(
        self, pattern: Pattern, constraint_pattern: Pattern, order: Array, place: Array
    ) -> None:
        n, size = pattern.shape[0], len(order)
        row, column = place[pattern.rows], place[pattern.columns]
        chosen = np.flatnonzero(row >= column)
        row, column = (
            np.concatenate([own[chosen], place[constraints]])
            for own, constraints in (
                (row, constraint_pattern.rows + n),
                (column, constraint_pattern.columns),
            )
        )
        end = np.arange(size)
        np.maximum.at(end, column, row)
        first = np.append(0, np.cumsum(np.maximum.accumulate(end) - np.arange(size) + 1))
        signs = np.where(order < n, 1.0, -1.0)
        self._order, self._first, self._signs = order, first.astype(np.int32), signs
        self._chosen = chosen.astype(np.int32)
        self._places = (first[column] + row - column).astype(np.int32)

    def factor(self, terms: Terms, B: Array) -> Factorization | None:
        """Factorise; None where a pivot has not its sign."""
        factors, failed = ldl_factor(terms, B, self._chosen, self._places, self._first, self._signs)
        return None if failed else _SymmetricFactorization(factors, self._first, self._order)


@final
class _SymmetricFactorization(Factorization):
    def __init__(self, factors: Array, first: Array, order: Array) -> None:
        self._factors = factors, first, order

    def solve(self, right: Array) -> Array:
        return ldl_solve(*self._factors, right.T).T

    def solve_transposed(self, right: Array) -> Array:
        return self.solve(right)


@final
class _BandStorage(_Storage):
    def __init__(
        self, scale: Array, order: Array, rows: Array, columns: Array, half_width: int
    ) -> None:
        self._scale, self._order, self._half_width = scale, order, half_width
        # LAPACK band storage with room for fill-in: entry (i, j) at row 2 k + i - j of column j.
        self._flat = columns * (3 * half_width + 1) + 2 * half_width + rows - columns
        numbered = scale[order]
        self._factors = numbered[rows] * numbered[columns]

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
    def __init__(self, scale: Array, rows: Array, columns: Array) -> None:
        self._scale = scale
        self._order = np.lexsort((rows, columns))
        self._rows = rows[self._order]
        self._indptr = np.searchsorted(columns[self._order], np.arange(len(scale) + 1))
        self._factors = scale[rows] * scale[columns]

    def factor(self, K: Array, B: Array) -> Factorization:
        values = self._factors * np.concatenate([K, B, B])
        if not np.isfinite(values.sum()):
            raise SingularMatrix("the saddle-point matrix is not finite")
        size = len(self._scale)
        matrix = scipy.sparse.csc_array(
            (values[self._order], self._rows, self._indptr), shape=(size, size)
        )
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                lu = scipy.sparse.linalg.splu(matrix)
            except (RuntimeError, Warning) as error:
                raise SingularMatrix(str(error)) from error
        return _SparseFactorization(lu, values.dtype, self._scale)


@final
class _SparseFactorization(Factorization):
    def __init__(self, lu: Any, dtype: np.dtype, scale: Array) -> None:
        self._lu, self._dtype, self._scale = lu, dtype, scale

    def solve(self, right: Array) -> Array:
        return self._solved(right, "N")

    def solve_transposed(self, right: Array) -> Array:
        return self._solved(right, "T")

    def _solved(self, right: Array, transposed: str) -> Array:
        if right.dtype.kind == "c" and self._dtype.kind != "c":
            return self._solved(right.real, transposed) + 1j * self._solved(right.imag, transposed)
        # Undoes the symmetric scaling.
        scale = self._scale if right.ndim == 1 else self._scale[:, None]
        scaled = np.ascontiguousarray(scale * right, dtype=self._dtype)
        return np.asarray(scale * self._lu.solve(scaled, transposed))
