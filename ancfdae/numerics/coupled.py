"""Saddle-point matrices of copies of one system, coupled in K, such as the stages of Radau.

[ K_11 .. K_1s   B_1^T         ] [ ..      ..            ..     ]      all K_ij on the pattern of K
(n x n), [ K_s1 .. K_ss           B_s^T ]      B_i on that of B (m x n). [ B_1 .. B_s           0 ]
"""

import numpy as np

from ancfdae.kernels import CoupledMatrix
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import SaddlePoint
from ancfdae.numerics.patterns import SparsityPattern


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
