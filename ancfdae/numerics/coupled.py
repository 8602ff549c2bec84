"""Saddle-point matrices of several copies of one system, coupled in K, as the stages of a step are.

[ K_11 .. K_1s   B_1^T         ]
[ ..      ..            ..     ]      all K_ij on the pattern of K (n x n),
[ K_s1 .. K_ss           B_s^T ]      B_i on that of B (m x n).
[ B_1 .. B_s           0       ]
"""

from typing import final

import numpy as np

from ancfdae.kernels import CoupledArrays
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization, SaddlePoint
from ancfdae.numerics.patterns import SparsityPattern


@final
class CoupledFactors:
    """A factorised coupled matrix, for right sides (s, n + m, ...)."""

    def __init__(self, factors: Factorization, copies: int, n: int) -> None:
        self._factors, self._copies, self._n = factors, copies, n

    def solve(self, right: Array) -> Array:
        """Return the solution of the coupled matrix for a right-hand side."""
        return self._split(self._factors.solve(self._joined(right)))

    def solve_transposed(self, right: Array) -> Array:
        """Return the solution of the transposed coupled matrix for a right-hand side."""
        return self._split(self._factors.solve_transposed(self._joined(right)))

    def _joined(self, right: Array) -> Array:
        parts = np.split(right, [self._n], axis=1)
        return np.concatenate([x.reshape(-1, *x.shape[2:]) for x in parts])

    def _split(self, x: Array) -> Array:
        parts = np.split(x, [self._copies * self._n])
        return np.concatenate([x.reshape(self._copies, -1, *x.shape[1:]) for x in parts], axis=1)


@final
class CoupledSaddlePoints:
    """Coupled matrices of one system: constant patterns; weights and values of B scale as there.

    Where the unknowns of the system have an order in a band, all copies of one stand together.
    """

    def __init__(
        self,
        copies: int,
        K: SparsityPattern,
        B: SparsityPattern,
        weights: Array,
        constraint_values: Array,
        order: Array | None = None,
    ) -> None:
        self._copies, (m, n) = copies, B.shape
        self._n = n
        i, j = np.indices((copies, copies)).reshape(2, -1, 1)
        rows, columns = K.rows.astype(int) + n * i, K.columns.astype(int) + n * j
        pattern = SparsityPattern((copies * n, copies * n), rows.ravel(), columns.ravel())
        self._places = pattern.index(rows, columns)
        copy = np.arange(copies)[:, None]
        B_rows, B_columns = B.rows.astype(int) + m * copy, B.columns.astype(int) + n * copy
        constraints = SparsityPattern((copies * m, copies * n), B_rows.ravel(), B_columns.ravel())
        scales = np.tile(weights, copies), np.tile(constraint_values, copies)
        if order is not None:
            place, copy = order[:, None], np.arange(copies)
            multiplier = (copies - 1) * n + copy * m + place
            order = np.where(place < n, copy * n + place, multiplier).ravel()
        self._matrices = SaddlePoint(pattern, constraints, *scales, order=order)

    @property
    def arrays(self) -> CoupledArrays:
        """The matrix as kernels take it."""
        layout = self._matrices.layout(band=True) or self._matrices.layout_out_of_band()
        places, factorise = self._places.ravel(), self._matrices.exchanging(layout)
        return layout.order, layout.scale, places, layout.band, factorise

    def factor(self, K: Array, B: Array) -> CoupledFactors:
        """Factorise for values K, (s, s, size of the pattern), and B, (s, size).

        Raises SingularMatrix as `SaddlePoint.factor`.
        """
        values = np.empty(K.size, dtype=K.dtype)
        values[self._places] = K.reshape(len(self._places), -1)
        factors = self._matrices.factor(values, B.ravel())
        return CoupledFactors(factors, self._copies, self._n)
