"""L D L^T of symmetric saddle-point matrices whose bands are wide: nets, frames, trees of bodies.

    [ K      B^T ]     scaled by powers of two, so that the diagonal of K and the largest entry of
    [ B    -eps  ]     each row of B have the size of one;  eps = 1e-7

is quasidefinite where K is positive definite: L D L^T then exists in every order of the unknowns
(Vanderbei 1995), with positive pivots of coordinates and negative ones of multipliers, so that the
order with the least work serves. Iterative refinement with the matrix itself, eps = 0, removes the
perturbation: an error shrinks by about eps over the smallest eigenvalue of B K^-1 B^T with each
sweep. The factorisation is multifrontal (`kernels/fronts.h`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias, final

import numpy as np
import scipy

from ancfdae.kernels import FrontArrays, eliminate, fronts_factor, fronts_signs, fronts_solve
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.patterns import SparsityPattern

# Terms of a sum of matrices: numbers and values on the pattern.
Terms: TypeAlias = tuple[tuple[float, Array], ...]
# A refined residual above this part of the right side and the solution is no round-off: rows of B
# are almost dependent, and refinement has not converged.
_UNREFINED = 1e-12
# Orders with little fill: minimum degree is better for frames, COLAMD for nets.
_ORDERS: tuple[dict[str, Any], ...] = (
    {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}},
    {"permc_spec": "COLAMD", "diag_pivot_thresh": 0.0},
)


@final
class Fronts:
    """The elimination of matrices of one pattern, shape (n + m, n + m).

    `order` is the order of elimination, found unless one is given; `by_columns` says whether it is
    COLAMD's, where that takes less work than minimum degree.
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
        self._chosen = np.flatnonzero(lower[: K.size]).astype(np.int32)
        self._places = places[: len(places) - m].astype(np.int32)
        entry_rows = (entries % (n + m)).astype(np.int32)
        signs = np.where(self.order < n, 1.0, -1.0)
        self._arrays: FrontArrays = (*analysis, first, entry_rows, signs)

    @property
    def layout(self) -> tuple[Array, Array, FrontArrays]:
        """The values of K in the lower triangle, places of these and of B, and the fronts."""
        return self._chosen, self._places, self._arrays

    def factor(self, terms: Terms, B: Array) -> Callable[..., Array | None] | None:
        """Factorise for a sum K of at most three terms; None where a pivot has not its sign.

        The solver takes right sides, shape (..., n + m), and the relative residual that need not be
        refined; it returns None for a matrix so near to
        a singular one that refinement does not converge.
        """
        factors, failed = fronts_factor(terms, B, self._chosen, self._places, self._arrays)

        def solve(right: Array, enough: float = 0.0) -> Array | None:
            x, residual = fronts_solve(factors, self._arrays, self.order, right, enough)
            return x if residual <= _UNREFINED else None

        return None if failed else solve

    def growth(self, terms: Terms, B: Array) -> float | None:
        """Return the largest sum_k L_ik^2 |D_k|; None where a pivot has not its sign.

        Relative to the diagonal of K, and to rows of B of length one: rows i of the matrix have an
        error of eps times this sum.
        """
        _, growth = fronts_signs(terms, B, self._chosen, self._places, self._arrays, False)
        return growth if growth < np.inf else None

    def negative(self, terms: Terms, B: Array) -> tuple[int, float]:
        """Return how many more pivots are negative than multipliers, and the growth as above.

        The growth is infinite where a pivot vanishes.
        """
        return fronts_signs(terms, B, self._chosen, self._places, self._arrays, True)


def _places(order: Array) -> Array:
    """Return where each unknown stands in an order."""
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
