"""Factorisation of the saddle-point matrices that all methods share.

    [ K      B^T ]     K on the system's pattern (n x n),
    [ B      0   ]     B on its constraint pattern (m x n).

Unknowns are ordered so that factors stay small, by the graph of K + B^T B, as if multipliers were
eliminated. Each multiplier follows its last coordinate: these are then eliminated first, by pivots
of K, and a constraint is satisfied to the round-off of its own row, not of the row of a stiff body.
(Multipliers of a clamp at the end of the band would widen it less behind all coordinates;
frequencies of stiff linkages then lose three digits.) Where K is symmetric and positive definite, L
D L^T then needs no exchange of rows: the pivots of coordinates are positive, those of multipliers
negative. Signs do not depend on the units of the scene; a pivot of the wrong sign shows that K is
not positive definite.

Matrices with such a pivot, and unsymmetric ones, are scaled symmetrically: coordinates by
1/sqrt(weight), and constraints so that their scaled rows have the size of the largest scaled entry
of K. Pivoting then depends neither on the units nor on the step size. They are factorised with row
exchanges, as a band. If the band is wide (trees, nets and frames of bodies) symmetric matrices are
factorised by fronts, in an order with little fill (`fronts`). Others are factorised by SuperLU, in
an order of minimum degree, or in its own order of columns if that fills less (nets).

Copies of one system that are coupled in K, such as the stages of Radau, have the same form:

    [ K_11 .. K_1s   B_1^T         ]
    [ ..      ..            ..     ]      all K_ij on the pattern of K (n x n),
    [ K_s1 .. K_ss           B_s^T ]      B_i on that of B (m x n).
    [ B_1 .. B_s             0     ]
"""

from __future__ import annotations

import abc
import warnings
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple, TypeAlias, final

import numpy as np
import scipy

from ancfdae.errors.kinds import SingularMatrix
from ancfdae.kernels import Band, CoupledMatrix, Envelope, FrontPlan, narrow_order
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.inertia import ConstrainedPattern, Fronts, Terms
from ancfdae.numerics.patterns import SparsityPattern

#: Factorises the matrix of K, a sum of terms (factor, values), and of B, for a `Model`. Returns the
#: solver, a function of the right side and of whether the matrix is transposed; None if singular.
Factorise: TypeAlias = Callable[[Terms, Array], Callable[[Array, bool], Array] | None]


class MatrixLayout(NamedTuple):
    """Order and scale of the unknowns, and the storage of the entries: envelope, band or fronts."""

    order: Array
    scale: Array
    envelope: Envelope | None
    band: Band | None
    fronts: FrontPlan | None = None


def little_fill(pattern: SparsityPattern, constraint_pattern: SparsityPattern) -> Array:
    """Return an order of the n + m unknowns by minimum degree, multipliers behind coordinates.

    SuperLU computes it when it factorises a diagonally dominant matrix of this pattern.
    """
    # The pattern of K + B^T B.
    K, B = (each.csr(np.ones(each.size, dtype=bool)) for each in (pattern, constraint_pattern))
    graph = ((K + B.T @ B).tocsr() if B.nnz else K).astype(float)
    # Diagonal pivots need no exchange.
    diagonal = scipy.sparse.diags_array(1.0 + graph.sum(axis=1))
    made_up = (diagonal - 0.5 * graph).tocsc()
    symmetric = {"SymmetricMode": True}
    lu = scipy.sparse.linalg.splu(
        made_up, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric
    )
    return _with_multipliers(np.argsort(lu.perm_c), constraint_pattern)


def _with_multipliers(order: Array, constraint_pattern: SparsityPattern) -> Array:
    """Return an order with each multiplier inserted behind its last coordinate, (n + m,)."""
    n = len(order)
    place = np.zeros(n + constraint_pattern.shape[0], dtype=np.int32)
    place[order] = np.arange(n)
    rows, columns = constraint_pattern.rows, constraint_pattern.columns
    np.maximum.at(place, n + rows, place[columns])
    # Coordinates come before multipliers of the same place.
    return np.argsort(place, kind="stable")


# Half-width of a band whose factorisation takes as long as SuperLU (docs/measurements.md, "Linear
# algebra").
_BAND_HALF_WIDTH = 64
# Options of SuperLU, which exchanges rows where a pivot is below a tenth of its column's largest
# entry: in the given order, or in SuperLU's own order of columns.
_IN_ORDER: dict[str, Any] = {
    "permc_spec": "NATURAL",
    "diag_pivot_thresh": 0.1,
    "panel_size": 1,
    "options": {"SymmetricMode": True},
}
_BY_COLUMNS: dict[str, Any] = {"permc_spec": "COLAMD", "diag_pivot_thresh": 0.1}


# Largest relative residual of `Factorization.rough`.
_ROUGH = 1e-13


@final
@dataclass(frozen=True, eq=False)
class Factorization:
    """A factorised matrix; right-hand sides are vectors or columns of an array.

    `solver` takes right-hand sides, and whether the matrix is to be transposed. `rough`, if not
    None, is cheaper, with relative residuals of up to _ROUGH.
    """

    solver: Callable[[Array, bool], Array]
    rough: Callable[[Array], Array] | None = None

    def solve(self, right: Array) -> Array:
        """Return the solution of the factorised matrix for right-hand sides, (n,) or (n, k)."""
        return self.solver(right, False)

    def solve_roughly(self, right: Array) -> Array:
        """Return the solution for right-hand sides, (n,) or (n, k), to twelve digits or more."""
        return self.rough(right) if self.rough else self.solve(right)

    def solve_transposed(self, right: Array) -> Array:
        """Return the solution of the transposed (not conjugated) matrix, (n,) or (n, k)."""
        return self.solver(right, True)


class _Storage(abc.ABC):
    """Positions of the values of K, B and B^T in a stored matrix, and its factorisation."""

    @abc.abstractmethod
    def factor(self, K: Array, B: Array) -> Factorization:
        """Return the factorisation of the matrix with these values of K and B.

        Raises SingularMatrix if it is singular to working precision or not finite.
        """


@final
class SaddlePoint:
    """Saddle-point matrices of one system: constant patterns of K and B, numbering and scaling.

    The weights of the coordinates, (n,), are positive, usually the diagonal of the mass matrix;
    rows of constraints are scaled by the values of B at the start. `symmetric` says that K is
    symmetric. If an `order` of the unknowns is given they are stored as a band in that order.
    """

    def __init__(
        self,
        pattern: SparsityPattern,
        constraint_pattern: SparsityPattern,
        weights: Array,
        constraint_values: Array,
        symmetric: bool = False,
        order: Array | None = None,
    ) -> None:
        self._patterns, m = (pattern, constraint_pattern), constraint_pattern.shape[0]
        scale = 1.0 / np.sqrt(weights)
        squared = (constraint_values.real * scale[constraint_pattern.columns]) ** 2
        length = np.sqrt(np.bincount(constraint_pattern.rows, squared, minlength=m))
        self.scale = np.concatenate([scale, 1.0 / np.where(length > 0, length, 1.0)])
        # The matrices of one system have the same patterns: the pattern of K stores the places for
        # the last two B. (A dictionary of weak references has callbacks, and Ctrl-C in a callback
        # is lost.)
        places = None if order is not None else dict(pattern.beside).get(constraint_pattern)
        if places is None:
            # Reverse Cuthill-McKee order, or the order of the scene where its band is narrower.
            if order is None:
                narrow = narrow_order(*pattern.places, *constraint_pattern.places)
            else:
                narrow = order
            places = _Places(*self._patterns, narrow)
            if order is None:
                pattern.beside = (constraint_pattern, places), *pattern.beside[:1]
        self._places = places
        self._in_band = order is not None or self._places.half_width <= _BAND_HALF_WIDTH
        self._envelope = self._places.envelope if symmetric and self._in_band else None
        self._symmetric = symmetric

    @property
    def size(self) -> int:
        """Number of unknowns of the matrix, coordinates and multipliers."""
        return len(self.scale)

    @property
    def _n(self) -> int:
        """Number of coordinates, the size of K."""
        return self._patterns[0].shape[0]

    @property
    def constrained(self) -> ConstrainedPattern:
        """Pattern of the matrices whose negative directions are counted."""
        return (self._places if self._in_band else self._places.sparse).constrained

    @cached_property
    def parts(self) -> tuple[int, Array]:
        """Number of disconnected parts of the graph, and the part of each coordinate, (n,)."""
        K, B = self._patterns
        rows, columns = np.append(K.rows, self._n + B.rows), np.append(K.columns, B.columns)
        graph = scipy.sparse.csr_array((np.ones(len(rows)), (rows, columns)), (self.size,) * 2)
        count, part = scipy.sparse.csgraph.connected_components(graph, directed=False)
        return int(count), part[: self._n]

    def of_mass(self) -> SaddlePoint:
        """Return these matrices for a symmetric K, such as a mass matrix."""
        same = copy(self)
        same._symmetric, same._envelope = True, self._places.envelope if self._in_band else None
        return same

    def layout(self, band: bool) -> MatrixLayout | None:
        """Return the positions of values in envelope and band; None if the band is too wide.

        The band is included if `band` is True or there is no envelope.
        """
        if not self._in_band:
            return None
        band_map = self._band.band if band or not self._envelope else None
        return MatrixLayout(self._places.order, self.scale, self._envelope, band_map)

    def layout_out_of_band(self) -> MatrixLayout:
        """Return the layout of the matrix in fronts; without fronts unless K is symmetric."""
        if not self._symmetric:
            return MatrixLayout(np.arange(self.size), self.scale, None, None)
        fronts = self._places.fronts
        return MatrixLayout(fronts.order, self.scale, None, None, fronts.plan)

    def exchanging(self, layout: MatrixLayout) -> Factorise | None:
        """Return a function that factorises where the layout stores no band or envelope."""
        return None if layout.band or layout.envelope else self._solver_of

    def _solver_of(self, terms: Terms, B: Array) -> Callable[[Array, bool], Array] | None:
        """Return the solver of `_exchanging`; None if the matrix is singular."""
        try:
            return self._exchanging(terms, B).solver
        except SingularMatrix:
            return None

    def factor(self, K: Array, B: Array) -> Factorization:
        """Return the factorisation for the given values of K and B.

        Raises SingularMatrix if the matrix is singular to working precision or not finite.
        """
        return self.factor_sum(((1.0, K),), B)

    def factor_sum(self, terms: Terms, B: Array) -> Factorization:
        """Return the factorisation for a sum K of at most three terms, each a factor and values.

        Raises SingularMatrix as `factor` does.
        """
        envelope = self._envelope
        if envelope:
            lower, failed = envelope.factor(terms, B)
            if not failed:  # Every pivot has its sign.
                return Factorization(lambda right, _: envelope.solve(lower, right.T).T)
            return self._exchanging(terms, B)
        return self._factor_by_fronts(terms, B) or self._exchanging(terms, B)

    def _exchanging(self, terms: Terms, B: Array) -> Factorization:
        """Return a factorisation with row exchanges for K, the sum of `terms`, and B."""
        (s, K), *more = terms
        K = K if s == 1.0 else s * K
        for s, values in more:
            K = K + s * values
        return self._storage.factor(K, B)

    def _factor_by_fronts(self, terms: Terms, B: Array) -> Factorization | None:
        """Factorise a real symmetric matrix with a wide band; None where K is not definite."""
        is_complex = B.dtype.kind == "c" or any(K.dtype.kind == "c" for _, K in terms)
        if self._in_band or not self._symmetric or is_complex:
            return None
        solve = self._places.fronts.factor(terms, B)
        if solve is None:
            return None
        # Copies, because the caller may overwrite the arrays.
        kept = tuple((s, K.copy()) for s, K in terms), B.copy()
        exchanging: list[Factorization] = []

        def solver(right: Array, transposed: bool, enough: float = 0.0) -> Array:
            x = solve(right.T, enough)
            if x is not None:
                return x.T
            if not exchanging:
                exchanging.append(self._exchanging(*kept))
            return exchanging[0].solver(right, transposed)

        return Factorization(solver, partial(solver, transposed=False, enough=_ROUGH))

    @cached_property
    def _storage(self) -> _Storage:
        """Storage of the matrix for a factorisation with row exchanges: band, fronts or sparse."""
        if self._in_band:
            return self._band
        if self._places.fronts.by_columns:
            return _SparseStorage(self.scale, self._n, self._places, _BY_COLUMNS)
        return _SparseStorage(self.scale, self._n, self._places.sparse, _IN_ORDER)

    @cached_property
    def _band(self) -> _BandStorage:
        return _BandStorage(self.scale, self._n, self._places)


@final
class _Places:
    """An order of the unknowns, and rows and columns in it of the entries of K, B and B^T."""

    def __init__(self, K: SparsityPattern, B: SparsityPattern, order: Array) -> None:
        place = np.empty(len(order), dtype=np.int32)
        place[order] = np.arange(len(order))
        r, c = place[B.rows + K.shape[0]], place[B.columns]
        self.order, self._sizes, self._patterns = order, (K.shape[0], K.size, B.size), (K, B)
        self.rows = np.concatenate([place[K.rows], r, c])
        self.columns = np.concatenate([place[K.columns], c, r])
        self.half_width = int(np.max(np.abs(self.rows - self.columns), initial=0))

    @cached_property
    def envelope(self) -> Envelope:
        """Storage for L D L^T of symmetric K: lower triangle, columns up to their ends.

        A column ends with its last entry, but not before the end of the one to its left, so that
        the factors fit into the same storage. Entries of B^T are left out.
        """
        n, n_K, n_B = self._sizes
        size, lower = len(self.order), self.rows >= self.columns
        lower[n_K : n_K + n_B], lower[n_K + n_B :] = True, False
        row, column = self.rows[lower], self.columns[lower]
        end = np.arange(size)
        np.maximum.at(end, column, row)
        starts = np.append(0, np.cumsum(np.maximum.accumulate(end) - np.arange(size) + 1))
        first, chosen = starts.astype(np.int32), np.flatnonzero(lower[:n_K]).astype(np.int32)
        signs = np.where(self.order < n, 1.0, -1.0)
        return Envelope(first, chosen, first[column] + row - column, signs, self.order)

    @cached_property
    def fronts(self) -> Fronts:
        """Multifrontal elimination in an order with little fill, which is not the band's order."""
        return Fronts(*self._patterns)

    @cached_property
    def sparse(self) -> _Places:
        """Positions of entries in an order of minimum degree, independent of this order."""
        return _Places(*self._patterns, little_fill(*self._patterns))

    @cached_property
    def constrained(self) -> ConstrainedPattern:
        """Pattern of matrices in this order whose negative directions are counted."""
        wide = self.half_width > _BAND_HALF_WIDTH
        return ConstrainedPattern(*self._patterns, self.order, wide)

    @cached_property
    def flat(self) -> Array:
        """Indices of the entries in LAPACK's band storage with space for fill-in.

        Entry (i, j) is at row 2 k + i - j of column j.
        """
        flat = self.columns.astype(np.int64) * (3 * self.half_width)
        flat += 2 * self.half_width + self.rows
        return flat


def _balanced(scale: Array, n: int, of_B: float) -> Array:
    """Return the scales of n coordinates and of multipliers where B is multiplied by `of_B`."""
    return scale if of_B == 1.0 else np.concatenate([scale[:n], of_B * scale[n:]])


@final
class _BandStorage(_Storage):
    def __init__(self, scale: Array, n: int, places: _Places) -> None:
        self._scale, self._n = scale, n
        numbered = scale[places.order]
        factors = numbered[places.rows] * numbered[places.columns]
        #: Positions of all entries in the band, and factors that scale them.
        self.band = Band(places.half_width, places.flat, factors, places.order)

    def factor(self, K: Array, B: Array) -> Factorization:
        lu, pivots, of_B, info = self.band.factor(K, B)
        if info > 0:
            raise SingularMatrix(f"zero pivot {info} of {len(pivots)}")
        if info < 0:
            raise SingularMatrix("the saddle-point matrix is not finite")
        solve, known = self.band.solve, (lu, pivots, _balanced(self._scale, self._n, of_B))
        # Right-hand sides as rows of an array, one after the other in memory.
        return Factorization(lambda right, turned: solve(*known, right.T, turned).T)


@final
class _SparseStorage(_Storage):
    def __init__(self, scale: Array, n: int, places: _Places, settings: Mapping[str, Any]) -> None:
        self._order, self._n, self._all = places.order, n, scale
        self._settings = settings
        self._sorted = np.lexsort((places.rows, places.columns))
        self._rows = places.rows[self._sorted]
        starts = np.arange(len(places.order) + 1)
        self._first = np.searchsorted(places.columns[self._sorted], starts)
        numbered = scale[places.order]
        self._factors = numbered[places.rows] * numbered[places.columns]

    def factor(self, K: Array, B: Array) -> Factorization:
        values = self._factors * np.concatenate([K, B, B])
        if not np.isfinite(values.sum()):
            raise SingularMatrix("the saddle-point matrix is not finite")
        of_B = 2.0 ** np.frexp(np.max(np.abs(values[: len(K)]), initial=0.0))[1]
        values[len(K) :] *= of_B
        size = len(self._order)
        matrix = scipy.sparse.csc_array(
            (values[self._sorted], self._rows, self._first), shape=(size, size)
        )
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                lu = scipy.sparse.linalg.splu(matrix, **self._settings)
            except (RuntimeError, Warning) as error:
                raise SingularMatrix(str(error)) from error
        scale = _balanced(self._all, self._n, of_B)[self._order]
        return Factorization(partial(self._solved, lu, scale, values.dtype))

    def _solved(
        self, lu: Any, scale: Array, dtype: np.dtype, right: Array, transposed: bool
    ) -> Array:
        if right.dtype.kind == "c" and dtype.kind != "c":
            parts = (
                self._solved(lu, scale, dtype, x, transposed) for x in (right.real, right.imag)
            )
            return next(parts) + 1j * next(parts)
        # Undoes the symmetric scaling.
        scale = scale if right.ndim == 1 else scale[:, None]
        scaled = np.ascontiguousarray(scale * right[self._order], dtype=dtype)
        solution = np.empty_like(scaled)
        solution[self._order] = scale * lu.solve(scaled, "T" if transposed else "N")
        return solution


def coupled_arrays(
    copies: int,
    K: SparsityPattern,
    B: SparsityPattern,
    weights: Array,
    constraint_values: Array,
    order: Array | None = None,
) -> CoupledMatrix:
    """Return the storage of the module's matrix for kernels; weights and values of B scale it.

    If the unknowns of the system have an `order` in a band, all copies of an unknown are adjacent.
    """
    m, n = B.shape
    i, j = np.indices((copies, copies)).reshape(2, -1, 1)
    rows, columns = K.rows.astype(int) + n * i, K.columns.astype(int) + n * j
    pattern = SparsityPattern((copies * n, copies * n), rows.ravel(), columns.ravel())
    places = pattern.index(rows, columns)
    copy = np.arange(copies)[:, None]
    B_rows, B_columns = B.rows.astype(int) + m * copy, B.columns.astype(int) + n * copy
    constraints = SparsityPattern((copies * m, copies * n), B_rows.ravel(), B_columns.ravel())
    scales = np.tile(weights, copies), np.tile(constraint_values, copies)
    if order is not None:
        place, copy = order[:, None], np.arange(copies)
        multiplier = (copies - 1) * n + copy * m + place
        order = np.where(place < n, copy * n + place, multiplier).ravel()
    matrices = SaddlePoint(pattern, constraints, *scales, order=order)
    layout = matrices.layout(band=True) or matrices.layout_out_of_band()
    factorise = matrices.exchanging(layout)
    return CoupledMatrix(layout.order, layout.scale, places.ravel(), layout.band, factorise)
