"""Packed symmetric Gram matrices of relative node vectors.

The strain of an ANCF element depends on its coordinates only through
Gram = Y Y^T, and linearly. A symmetric n_y x n_y matrix is stored as the
vector g of its upper triangle (15 entries for n_y = 5, 28 for n_y = 7).
"""

from functools import lru_cache

import numpy as np

from ancfdae.kernels import gram
from ancfdae.numerics.arrays import Array


@lru_cache(maxsize=8)
def upper_triangle(n_y: int) -> tuple[Array, Array]:
    """Row and column of each packed entry."""
    rows, columns = np.triu_indices(n_y)
    return rows, columns


def packed_gram(Y: Array) -> Array:
    """Packed Y Y^T; Y of shape (..., n_y, d), result (..., n_g)."""
    return gram(Y, Y) / 2
