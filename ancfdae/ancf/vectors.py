"""Vectors of material points, many at once: U = L q, and forces on them lifted to L^T F."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
from scipy import sparse

from ancfdae.naming import PointVector
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_map import LinearMap


@final
class Vectors:
    """A list of point vectors as one linear map with design derivatives.

    Parameters
    ----------
    vectors : sequence of PointVector
    d, n_q, n_b : int

    Attributes
    ----------
    matrix : sparse array, shape (n_v d, n_q)
        L; row d i + c is component c of vector i.
    moves : array of bool, shape (n_b,)
        Whether L depends on each design variable.
    """

    def __init__(self, vectors: Sequence[PointVector], d: int, n_q: int, n_b: int) -> None:
        self._d, self._n_b, self._count = d, n_b, len(vectors)
        rows, columns, values, values_b = [], [], [], []
        for number, vector in enumerate(vectors):
            used = (vector.weights != 0) | np.any(vector.weights_b != 0, axis=1)
            for axis in range(d):
                columns.append(vector.vectors[used] * d + axis)
                rows.append(np.full(int(np.sum(used)), number * d + axis))
                values.append(vector.weights[used])
                values_b.append(vector.weights_b[used])
        empty = np.zeros(0, dtype=np.int64)
        row = np.concatenate([empty, *rows])
        column = np.concatenate([empty, *columns])
        value = np.concatenate([np.zeros(0), *values])
        value_b = np.concatenate([np.zeros((0, n_b)), *values_b])
        shape = (self._count * d, n_q)
        self.matrix = sparse.csr_array((value, (row, column)), shape=shape)
        self._L = LinearMap(self.matrix)
        at, variable = np.nonzero(value_b)
        changes = value_b[at, variable]
        self.moves = np.bincount(variable, minlength=n_b) > 0
        self._moving = len(at) > 0
        self._L_b = LinearMap.of(
            row[at] * n_b + variable, column[at], changes, (shape[0] * n_b, n_q)
        )
        self._L_bT = LinearMap.of(
            column[at] * n_b + variable, row[at], changes, (n_q * n_b, shape[0])
        )

    def of(self, q: Array) -> Array:
        """Return U for rows of q, shape (k, n_v, d)."""
        return self._L.rows(q).reshape(len(q), self._count, self._d)

    def of_b(self, q: Array) -> Array:
        """Return the design partial of U with q held, shape (k, n_v, d, n_b)."""
        shape = (len(q), self._count, self._d, self._n_b)
        return self._L_b.rows(q).reshape(shape) if self._moving else np.zeros(shape)

    def lift(self, F: Array) -> Array:
        """Return L^T F, shape (k, n_v, d) to (k, n_q)."""
        return self._L.rows_transposed(F.reshape(len(F), -1))

    def lift_b(self, F: Array) -> Array:
        """Return the design partial of L^T F with F held, shape (k, n_q, n_b)."""
        n_q = self.matrix.shape[1]
        if not self._moving:
            return np.zeros((len(F), n_q, self._n_b))
        return self._L_bT.rows(F.reshape(len(F), -1)).reshape(len(F), n_q, self._n_b)
