"""Least-norm solutions of least squares with a matrix that may lack rank (pseudo-inverse).

Small matrices K are solved by their singular values, large sparse ones by

    [ a E    K  ] [ r ]   [ b ]
    [ K^T  -a E ] [ x ] = [ 0 ],     x = (K^T K + a^2 E)^-1 K^T b,

whose matrix is regular for any rank of K, and by iterative refinement. The error for a singular
value s falls by a^2 / (a^2 + s^2) in each iteration. The null space of K does not enter if b is in
the range of K; the part of b outside adds round-off from the null space, up to 1e-2 of that part.
"""

from __future__ import annotations

import warnings
from typing import final

import numpy as np
import scipy

from ancfdae.errors.kinds import SingularMatrix
from ancfdae.numerics.arrays import Array

#: Most columns for which singular values cost less than refinement (measured on chains of bodies).
DENSE = 150
# Singular values below _RANK times the largest count as zero.
_RANK = 1e-10
# a over the largest entry of K: far below singular values that are not zero, far above round-off.
_SHIFT = 1e-7
_PASSES = 20


@final
class LeastNorm:
    """The pseudo-inverse of a real matrix K, which is sparse or has few columns."""

    def __init__(self, matrix: scipy.sparse.csr_array | Array) -> None:
        self._matrix, self._pinv = matrix, None
        if matrix.shape[1] <= DENSE:
            small = matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
            self._pinv = np.linalg.pinv(small, rcond=_RANK)
        else:
            self._lu = _augmented(matrix)

    def solve(self, b: Array) -> Array:
        """Return the least-norm solution K^+ b, (n,), for a real or complex vector b, (m,)."""
        if self._pinv is not None:
            product: Array = self._pinv @ b
            return product
        if b.dtype.kind == "c":
            return self.solve(b.real) + 1j * self.solve(b.imag)
        x, last = np.zeros(self._matrix.shape[1]), np.inf
        for _ in range(_PASSES):
            right = np.concatenate([b - self._matrix @ x, np.zeros_like(x)])
            dx = self._lu.solve(right)[len(b) :]
            x, change = x + dx, float(np.max(np.abs(dx), initial=0.0))
            if change >= 0.5 * last or change <= _RANK**2 * np.max(np.abs(x)):
                break
            last = change
        return x

    def leaves_open(self, count: int) -> Array:
        """Return how far solutions may move in each of the first `count` unknowns.

        It is a generic vector less its part that K determines: zero where solutions are unique.
        """
        x = np.zeros(self._matrix.shape[1])
        x[:count] = np.cos(1.0 + np.arange(count) ** 2)
        return np.abs(x - self.solve(self._matrix @ x))[:count]


def _augmented(matrix: scipy.sparse.csr_array) -> scipy.sparse.linalg.SuperLU:
    rows, columns = matrix.shape
    shift = _SHIFT * float(np.max(np.abs(matrix.data), initial=0.0))
    diagonal = np.concatenate([np.full(rows, shift), np.full(columns, -shift)])
    entries = matrix.tocoo()
    i = np.concatenate([np.arange(rows + columns), entries.row, entries.col + rows])
    j = np.concatenate([np.arange(rows + columns), entries.col + rows, entries.row])
    values = np.concatenate([diagonal, entries.data, entries.data])
    whole = scipy.sparse.csc_array((values, (i, j)), shape=(rows + columns, rows + columns))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return scipy.sparse.linalg.splu(whole)
        except (RuntimeError, Warning) as error:
            raise SingularMatrix(str(error)) from error
