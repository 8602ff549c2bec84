"""Factorisation L D L^T of symmetric saddle-point matrices, and their negative directions.

**Fronts** factorise matrices whose bands are wide (nets, frames, trees of bodies):

    [ K      B^T ]     scaled by powers of two, so that the diagonal of K and the largest entry of
    [ B    -eps  ]     each row of B have the size of one;  eps = 1e-7

is quasidefinite where K is positive definite: L D L^T then exists in every order of the unknowns
(Vanderbei 1995), with positive pivots of coordinates and negative ones of multipliers, so that the
order with the least work can be used. Iterative refinement with the matrix itself, eps = 0, removes
the perturbation: an error shrinks by about eps over the smallest eigenvalue of B K^-1 B^T with each
sweep. The factorisation is multifrontal (`kernels/fronts.h`).

**Negative directions** of K on the null space of constraints are counted. The saddle-point matrix
of a symmetric K and m independent constraints B has m negative eigenvalues and one more for every
direction of the null space of B in which K is negative. L D L^T without exchanges counts them all,
whatever their size: by Sylvester's law of inertia D has as many negative entries.

    [ K + B^T B   B^T ]
    [ B           0   ] = L D L^T

B^T B adds nothing on the null space and makes coordinates regular that only constraints hold.
Eigenvalues kappa are relative to a positive diagonal D_0, K x = kappa D_0 x on the null space,
numbers without a unit; with K + sigma D_0 those below -sigma are counted. The factors are exact for
a matrix whose entries differ by eps sum_k L_ik^2 |D_k|: where a pivot has cancelled this is much
more than eps, and the count is rejected.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias, final

import numpy as np
import scipy

from ancfdae.kernels import FrontPlan, eliminate
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import SparsityPattern

# Terms of a sum of matrices: pairs of a factor and entries on the pattern.
Terms: TypeAlias = tuple[tuple[float, Array], ...]
# Refinement has not converged if the relative residual is above this: rows of B are then almost
# dependent.
_UNREFINED = 1e-12
# Orderings with little fill: minimum degree is better for frames, COLAMD for nets.
_ORDERS: tuple[dict[str, Any], ...] = (
    {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}},
    {"permc_spec": "COLAMD", "diag_pivot_thresh": 0.0},
)


@final
class Fronts:
    """Multifrontal elimination of matrices of one pattern, shape (n + m, n + m).

    `order` is the order of elimination, computed unless one is given; `by_columns` says whether it
    is COLAMD's, which is used where it takes less work than minimum degree.
    """

    def __init__(self, K: SparsityPattern, B: SparsityPattern, order: Array | None = None) -> None:
        n, m = K.shape[0], B.shape[0]
        # All entries below the diagonal of either triangle, and the diagonals of multipliers.
        multipliers = n + np.arange(m)
        rows = np.concatenate([K.rows, n + B.rows, multipliers])
        columns = np.concatenate([K.columns, B.columns, multipliers])
        orders = _orders(rows, columns, n + m) if order is None else [order]
        found = [_analysed(each, rows, columns) for each in orders]
        self.by_columns = found[-1][2] < found[0][2]
        self.order, analysis, _ = found[-1] if self.by_columns else found[0]
        place = _places(self.order)
        row, column = place[rows], place[columns]
        lower = row >= column
        lower[K.size :] = True
        at = np.maximum(row, column)[lower] + (n + m) * np.minimum(row, column)[lower].astype(
            np.int64
        )
        entries, places = np.unique(at, return_inverse=True)
        first = np.searchsorted(entries, (n + m) * np.arange(n + m + 1))
        chosen = np.flatnonzero(lower[: K.size]).astype(np.int32)
        to = places[: len(places) - m].astype(np.int32)
        entry_rows = (entries % (n + m)).astype(np.int32)
        signs = np.where(self.order < n, 1.0, -1.0)
        #: The fronts, with the positions in them of entries of K and of B.
        arrays = *analysis, first, entry_rows, signs, self.order, chosen, to
        self.plan = FrontPlan(*arrays)

    def factor(self, terms: Terms, B: Array) -> Callable[..., Array | None] | None:
        """Return a solver for the sum K of at most three terms; None if a pivot has a wrong sign.

        The solver takes right sides, shape (..., n + m), and a relative residual that need not be
        refined further; it returns None for a matrix so nearly singular that refinement does not
        converge.
        """
        factors, failed = self.plan.factor(terms, B)

        def solve(right: Array, enough: float = 0.0) -> Array | None:
            x, residual = self.plan.solve(factors, right, enough)
            return x if residual <= _UNREFINED else None

        return None if failed else solve

    def growth(self, terms: Terms, B: Array) -> float | None:
        """Return the largest sum_k L_ik^2 |D_k|; None if a pivot has a wrong sign.

        It is relative to the diagonal of K, and to rows of B of length one: row i of the matrix has
        an error of eps times this sum.
        """
        _, growth = self.plan.signs(terms, B, False)
        return growth if growth < np.inf else None

    def negative(self, terms: Terms, B: Array) -> tuple[int, float]:
        """Return the number of negative pivots less the number of multipliers, and their growth.

        The growth is infinite where a pivot vanishes.
        """
        return self.plan.signs(terms, B, True)


def _places(order: Array) -> Array:
    """Return the position of each unknown in an order, the inverse permutation."""
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    return place


def _orders(rows: Array, columns: Array, size: int) -> list[Array]:
    """Return elimination orders with little fill, one for each rule of SuperLU in _ORDERS.

    SuperLU factorises a diagonally dominant matrix of this pattern, so that it exchanges no rows.
    """
    ones = np.ones(len(rows))
    graph = scipy.sparse.csr_array((ones, (rows, columns)), shape=(size, size))
    graph = ((graph + graph.T) != 0).astype(float)
    diagonal = scipy.sparse.diags_array(1.0 + graph.sum(axis=1))
    made_up = (diagonal - 0.5 * graph).tocsc()
    return [np.argsort(scipy.sparse.linalg.splu(made_up, **how).perm_c) for how in _ORDERS]


def _analysed(order: Array, rows: Array, columns: Array) -> tuple[Array, tuple[Any, ...], float]:
    """Return the elimination order of the fronts, their arrays, and the number of operations."""
    size, place = len(order), _places(order)
    row, column = place[rows], place[columns]
    entries = np.unique(np.maximum(row, column) * size + np.minimum(row, column))
    row, column = entries // size, entries % size
    left = row > column
    first = np.append(0, np.cumsum(np.bincount(row[left], minlength=size)))
    (after, *arrays), work = eliminate(first, column[left].astype(np.int32))
    return order[after].astype(np.int64), tuple(arrays), work


_EPS = float(np.finfo(float).eps)
# Number of bounds of negative eigenvalues that are tried, each 16 times the last.
_BOUNDS = 40
# An eigenvalue counts as real or negative beyond _ROUNDINGS times the round-off of the largest.
_ROUNDINGS = 64
# All eigenvalues are computed for up to _DENSE motions; else first the _AROUND nearest to a centre.
_DENSE, _AROUND = 100, 12
# Number of lowest motions that are searched for flutter in systems of more than WHOLE motions, and
# growth, relative to the frequency, below which flutter of other motions is ignored.
_LOWEST, WHOLE, WEAK = 20, 1500, 1e-3
# Most coordinates for which dense matrices are formed, which takes about a second.
_LARGE = 800
# Options of SuperLU in the given order: with row exchanges, or with diagonal pivots of any size.
_EXCHANGING: dict[str, Any] = {"permc_spec": "NATURAL"}
_DIAGONAL = _EXCHANGING | {
    "diag_pivot_thresh": 0.0,
    "panel_size": 1,
    "options": {"SymmetricMode": True},
}


@final
class ConstrainedPattern:
    """Positions of the entries of saddle-point matrices, compressed by columns in a given order.

    In the order, (n + m,), every multiplier follows a coordinate of its own constraint; `wide` says
    that the entries do not fit into a narrow band.
    """

    def __init__(self, K: SparsityPattern, B: SparsityPattern, order: Array, wide: bool) -> None:
        size = len(order)
        self.K, self.B, self.size, self.wide = K, B, size, wide
        self.place = np.empty(size, dtype=np.int64)
        self.place[order] = np.arange(size)
        self.pairs = _pairs(B)

    @cached_property
    def _entries(self) -> tuple[Array, Array, Array]:
        """Return positions of the terms' entries in `matrix`; its rows and starts of columns."""
        K, B, n, size = self.K, self.B, self.K.shape[0], self.size
        i, j = (B.columns[pair] for pair in self.pairs)
        diagonal, multipliers = np.arange(n), n + B.rows
        rows = np.concatenate([K.rows, K.columns, diagonal, multipliers, B.columns, i])
        columns = np.concatenate([K.columns, K.rows, diagonal, B.columns, multipliers, j])
        flat = self.place[columns] * size + self.place[rows]
        entries, to = np.unique(flat, return_inverse=True)
        first = np.searchsorted(entries, np.arange(size + 1) * size).astype(np.int32)
        return to, (entries % size).astype(np.int32), first

    @cached_property
    def squared(self) -> tuple[SparsityPattern, Array]:
        """Pattern of K + K^T + 1 + B^T B, and the indices of the entries of each term in it."""
        K, (one, other) = self.K, (self.B.columns[pair] for pair in self.pairs)
        n, diagonal = K.shape[0], np.arange(K.shape[0])
        rows = np.concatenate([K.rows, K.columns, diagonal, one])
        columns = np.concatenate([K.columns, K.rows, diagonal, other])
        entries, to = np.unique(rows.astype(np.int64) * n + columns, return_inverse=True)
        return SparsityPattern(K.shape, entries // n, entries % n), to

    @cached_property
    def fronts(self) -> Fronts:
        """Multifrontal L D L^T in this order, in which multipliers follow their coordinates."""
        order = np.empty(self.size, dtype=np.int64)
        order[self.place] = np.arange(self.size)
        return Fronts(self.squared[0], self.B, order)

    def matrix(self, *values: Array) -> scipy.sparse.csc_array:
        """Return the sum of given entries of K, K^T, a diagonal, B, B^T and B^T B, compressed."""
        flat, (to, rows, first) = np.concatenate(values), self._entries
        data = np.bincount(to, flat.real, minlength=len(rows))
        if flat.dtype.kind == "c":
            data = data + 1j * np.bincount(to, flat.imag, minlength=len(rows))
        return scipy.sparse.csc_array((data, rows, first), shape=(self.size, self.size))

    def scaled(self, K: Array, B: Array, diagonal: Array) -> ConstrainedMatrix:
        """Return the matrix scaled by a positive diagonal, with rows of B of length one."""
        scale = 1.0 / np.sqrt(diagonal)
        K = K * scale[self.K.rows] * scale[self.K.columns]
        B = B * scale[self.B.columns]
        length = np.sqrt(np.bincount(self.B.rows, B * B, minlength=self.B.shape[0]))
        return ConstrainedMatrix(self, K, B / np.where(length > 0, length, 1.0)[self.B.rows])


def _pairs(B: SparsityPattern) -> tuple[Array, Array]:
    """Return all pairs of entries of B in the same row, as two arrays of indices."""
    first, _ = B.places
    count = np.diff(first)[B.rows]
    one = np.repeat(np.arange(B.size), count)
    start = np.repeat(np.cumsum(count) - count, count)
    return one, first[B.rows[one]] + np.arange(len(one)) - start


@final
@dataclass(frozen=True)
class ConstrainedMatrix:
    """Values of K (n x n) and of constraints B (m x n), scaled by a positive diagonal."""

    pattern: ConstrainedPattern
    K: Array
    B: Array

    @cached_property
    def skewness(self) -> float:
        """Bound of the contribution of the skew-symmetric part of K to eigenvalues."""
        K = self.pattern.K.csr(self.K)
        return 0.5 * float(np.max(abs(K - K.T).sum(axis=1), initial=0.0))

    def below(self, sigma: float) -> int | None:
        """Return how many eigenvalues of the symmetric part of K are less than -sigma.

        None if round-off could move one by more than sigma/2, or decides the sign of the pivot of a
        multiplier, as where constraints are nearly dependent.
        """
        # The analysis of fronts costs more than a factorisation in a band.
        if self.pattern.wide and self._all_above(-sigma):
            return 0
        negative, growth = self._signs(sigma)
        return negative if _EPS * growth <= 0.5 * sigma else None

    def _signs(self, sigma: float) -> tuple[int, float]:
        """Return how many eigenvalues are less than -sigma, and the growth of SuperLU's factors.

        It is infinite where round-off decides the sign of the pivot of a multiplier.
        """
        lu = self._factors(sigma, symmetric=True)
        if lu is None or np.any(lu.perm_r != lu.perm_c):
            return 0, np.inf
        U = lu.U
        pivots = U.diagonal()
        column = np.repeat(np.arange(len(pivots)), np.diff(U.indptr))
        reach = np.bincount(column, U.data**2 / np.abs(pivots)[U.indices])
        m = lu.perm_c[self.pattern.place[self.pattern.K.shape[0] :]]
        if not np.all(_ROUNDINGS * _EPS * reach[m] <= np.abs(pivots[m])):
            return 0, np.inf
        return int(np.sum(pivots < 0)) - len(m), float(np.max(reach))

    def definite(self, sigma: float) -> bool:
        """Return whether all eigenvalues provably exceed sigma/2 > 0; only in wide patterns."""
        return self.pattern.wide and self._all_above(sigma)

    def _all_above(self, bound: float) -> bool:
        """Return whether fronts prove that no eigenvalue is below the bound, up to half of it.

        Fronts have -eps, 1e-7, in place of the zeros. Pivots of coordinates are positive, and
        pivots of multipliers negative, where K - bound + B^T B + B^T B / eps is positive definite.
        On the null space of B this is K - bound. Eigenvalues below eps may remain without proof.
        """
        growth = self.pattern.fronts.growth(((1.0, self._symmetric(-bound)),), self.B)
        return growth is not None and _EPS * growth <= 0.5 * abs(bound)

    def negative(self) -> tuple[int, float]:
        """Return a bound of the number of negative eigenvalues of K, and the growth of factors.

        Fronts count eigenvalues of K + B^T B / eps, which may have more. The growth is infinite
        where pivots vanish.
        """
        if not self.pattern.wide:
            return self._signs(0.0)
        return self.pattern.fronts.negative(((1.0, self._symmetric(0.0)),), self.B)

    def _symmetric(self, sigma: float) -> Array:
        """Return the symmetric part of K + sigma + B^T B, entries on the pattern `squared`."""
        one, other = self.pattern.pairs
        diagonal = np.full(self.pattern.K.shape[0], sigma)
        values = [0.5 * self.K, 0.5 * self.K, diagonal, self.B[one] * self.B[other]]
        to = self.pattern.squared[1]
        return np.bincount(to, np.concatenate(values), minlength=self.pattern.squared[0].size)

    def below_densely(self, sigma: float) -> int | None:
        """Return `below` by dense matrices, also for dependent constraints; None if large.

        Rows of B have length one; its null space has singular values below the root of eps, which
        constraints that depend on each other within round-off also leave.
        """
        if self.pattern.K.shape[0] > _LARGE:
            return None
        K = self.pattern.K.dense(self.K)
        if self.pattern.B.shape[0]:
            Z = scipy.linalg.null_space(self.pattern.B.dense(self.B), rcond=_EPS**0.5)
            K = Z.T @ K @ Z
        return int(np.sum(np.linalg.eigvalsh((K + K.T) / 2) < -sigma * max(1, len(K))))

    def is_odd(self, sigma: float) -> bool | None:
        """Return whether an odd number of real eigenvalues of K is less than -sigma.

        It is the sign of the determinant; K need not be symmetric. None if the matrix is singular
        to working precision.
        """
        lu = self._factors(sigma, symmetric=False)
        if lu is None:
            return None
        negative = int(np.sum(lu.U.diagonal() < 0)) - self.pattern.B.shape[0]
        return (negative + _exchanges(lu.perm_r) + _exchanges(lu.perm_c)) % 2 == 1

    def log_determinant(self) -> complex | None:
        """Return the logarithm of the determinant of K on the null space of B, up to a constant.

        Its imaginary part is known up to multiples of 2 pi. The constant depends on B and on the
        diagonal alone. K may be complex. None if the matrix is singular to working precision.
        """
        lu = self._factors(0.0, symmetric=False)
        if lu is None:
            return None
        exchanges = _exchanges(lu.perm_r) + _exchanges(lu.perm_c)
        return complex(np.sum(np.log(lu.U.diagonal() + 0j)) + 1j * np.pi * exchanges)

    def has_negative(self, M: Array) -> bool:
        """Return whether K x = kappa M x has a real negative eigenvalue on the null space of B.

        M, entries on the pattern of K, is symmetric, positive definite and scaled by the same
        diagonal. Real parts of kappa are at least -rho, the smallest eigenvalue of the symmetric
        part of K. All real negative eigenvalues therefore lie in the disc about -rho/2 through
        zero: those nearest to its centre are computed until one lies outside.
        """
        K, B = self.pattern.K, self.pattern.B
        rho, count, values = self._bound(M), _AROUND, np.zeros(0)
        moved = replace(self, K=self.K + 0.5 * rho * M)
        while np.max(np.abs(values), initial=0.0) <= 0.5 * rho:
            if max(count, _DENSE) >= K.shape[0] - B.shape[0]:
                values = moved.eigenvalues(M)
                break
            values, count = moved.nearest(M, count), 4 * count
        kappa = values - 0.5 * rho
        noise = _ROUNDINGS * _EPS * rho
        real = np.abs(kappa.imag) <= noise
        # Round-off splits a double eigenvalue, as of a round shaft under a torque, by its root.
        real |= (np.abs(kappa.imag) <= _EPS**-0.5 * noise) & (kappa.real < -np.abs(kappa.imag))
        return bool(np.any(kappa.real[real] < -noise))

    @property
    def seen_whole(self) -> bool:
        """Whether `growing` examines all motions, not only the _LOWEST of a large system."""
        return self.pattern.K.shape[0] - self.pattern.B.shape[0] <= WHOLE

    def growing(self, M: Array) -> complex | None:
        """Return s, Im s > 0, of the vibration x e^{st} that grows fastest, K x = -s^2 M x.

        None if no kappa = -s^2 is complex, of all motions or of the _LOWEST of a large system.
        Round-off e splits a double kappa by its root. Beyond the _LOWEST only a vibration counts
        that grows by more than WEAK times its frequency: waves of single elements may grow by less,
        and any damping suppresses them.
        """
        if self.seen_whole:
            kappa, error = spectrum(*self._within(M))
        else:
            kappa = self.nearest(M, _LOWEST)
            size = np.abs(kappa)
            error = _EPS * size / np.min(size, initial=1.0)
        order = np.argsort(np.abs(kappa))
        kappa, error = kappa[order], error[order]
        least = _ROUNDINGS * np.sqrt(error)
        least[_LOWEST:] = np.maximum(least[_LOWEST:], 2.0 * WEAK)
        pairs = kappa[np.abs(kappa.imag) > least * np.abs(kappa)]
        # The root with a positive real part, in the upper half plane.
        s = np.sqrt(-pairs)
        return complex(max(np.where(s.imag < 0, np.conj(s), s), key=np.real)) if len(s) else None

    def _bound(self, M: Array) -> float:
        """Return a number rho for which the symmetric part of K + rho M is positive definite."""
        largest = float(np.max(np.abs(M)))
        for rho in _EPS / largest * 16.0 ** np.arange(_BOUNDS):
            moved, size = replace(self, K=self.K + rho * M), 1.0 + rho * largest
            if moved.below(_ROUNDINGS * _EPS * size) == 0:
                break
        return float(rho)

    def eigenvalues(self, M: Array) -> Array:
        """Return all eigenvalues of K x = kappa M x, the smallest with the most digits."""
        matrices = self._within(M)
        try:
            inverse = np.linalg.eigvals(np.linalg.solve(*matrices))
        except np.linalg.LinAlgError:  # Zero is an eigenvalue.
            return np.zeros(1, dtype=complex)
        return np.asarray(1.0 / inverse[inverse != 0], dtype=complex)

    def _within(self, M: Array) -> list[Array]:
        """Return K and M restricted to the null space of B, as dense matrices."""
        matrices = [self.pattern.K.dense(x) for x in (self.K, M)]
        if not len(self.B):
            return matrices
        Z = scipy.linalg.null_space(self.pattern.B.dense(self.B))
        return [Z.T @ x @ Z for x in matrices]

    def nearest(self, M: Array, count: int) -> Array:
        """Return the `count` eigenvalues of K x = kappa M x nearest to zero, by Arnoldi."""
        lu = self._factors(0.0, symmetric=False)
        if lu is None:  # Zero is an eigenvalue.
            return np.zeros(1, dtype=complex)
        n = self.pattern.K.shape[0]
        places, right = self.pattern.place[:n], np.zeros(self.pattern.size)

        def inverse(x: Array) -> Array:
            right[places] = self.pattern.K.dot(M, x.ravel())
            return np.asarray(lu.solve(right)[places])

        operator = scipy.sparse.linalg.LinearOperator((n, n), inverse, dtype=float)
        begin = inverse(np.cos(1.0 + np.arange(n) ** 2))
        try:
            values = scipy.sparse.linalg.eigs(operator, count, v0=begin, return_eigenvectors=False)
        except scipy.sparse.linalg.ArpackError:  # A cluster, as of soft parts beside stiff ones.
            values = self.eigenvalues(M)
            return values[np.argsort(np.abs(values))[:count]]
        return np.asarray(1.0 / values)

    def _factors(self, sigma: float, symmetric: bool) -> Any | None:
        """Factorise K + sigma, or its symmetric part, with B; None if it is singular."""
        parts = (0.5 * self.K, 0.5 * self.K) if symmetric else (self.K, 0 * self.K)
        one, other = self.pattern.pairs
        diagonal, squares = np.full(self.pattern.K.shape[0], sigma), self.B[one] * self.B[other]
        matrix = self.pattern.matrix(*parts, diagonal, self.B, self.B, squares)
        options = _DIAGONAL if symmetric else _EXCHANGING
        try:
            return scipy.sparse.linalg.splu(matrix, **options)
        except RuntimeError:  # An exactly singular matrix.
            return None


def spectrum(K: Array, M: Array) -> tuple[Array, Array]:
    """Return all kappa of K x = kappa M x, and their relative errors, for dense matrices.

    M is symmetric and positive definite.
    """
    L = scipy.linalg.cholesky(M, lower=True)
    half = scipy.linalg.solve_triangular(L, K, lower=True)
    inverse, g = shifted_inverse(scipy.linalg.solve_triangular(L, half.T, lower=True).T)
    return shifted_back(np.linalg.eigvals(inverse), g)


def shifted_inverse(A: Array) -> tuple[Array, float]:
    """Return (A + g)^-1 and g, between the smallest and the largest eigenvalue of A.

    Eigenvalues of the inverse have the round-off of its largest one: with this g both ends of the
    spectrum lose only half of the digits of their ratio.
    """
    if not A.size:
        return A, 1.0
    largest = float(np.linalg.norm(A))
    try:
        smallest = 1.0 / float(np.linalg.norm(np.linalg.inv(A)))
    except np.linalg.LinAlgError:  # Zero is an eigenvalue.
        smallest = 0.0
    g = (largest * max(smallest, _EPS * largest)) ** 0.5
    return np.linalg.inv(A + g * np.eye(len(A))), g


def shifted_back(theta: Array, g: float) -> tuple[Array, Array]:
    """Return eigenvalues kappa = 1 / theta - g, undoing a shift and inversion, and their errors."""
    kappa = np.asarray(1.0 / theta - g, dtype=complex)
    size, error = np.abs(kappa), _EPS * np.max(np.abs(theta), initial=0.0) / np.abs(theta) ** 2
    return kappa, error / np.where(size == 0, 1.0, size)


def _exchanges(order: Array) -> int:
    """Return the number of exchanges that make a permutation, up to an even number."""
    n = len(order)
    graph = scipy.sparse.csr_array((np.ones(n), order, np.arange(n + 1)), shape=(n, n))
    return n - int(scipy.sparse.csgraph.connected_components(graph)[0])
