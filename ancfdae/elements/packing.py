"""Packed symmetric Gram matrices of relative node vectors.

The strain of an ANCF element depends on its coordinates only through
Gram = Y Y^T, and linearly. A symmetric n_y x n_y matrix is stored as the
vector g of its upper triangle (15 entries for n_y = 5, 28 for n_y = 7).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ancfdae.numerics.arrays import Array


@lru_cache(maxsize=8)
def upper_triangle(n_y: int) -> tuple[Array, Array]:
    """Row and column of each packed entry."""
    rows, columns = np.triu_indices(n_y)
    return rows, columns


@lru_cache(maxsize=8)
def _flat_index(n_y: int) -> Array:
    rows, columns = upper_triangle(n_y)
    flat: Array = rows * n_y + columns
    return flat


@lru_cache(maxsize=8)
def _unpack_index(n_y: int) -> tuple[Array, Array]:
    rows, columns = upper_triangle(n_y)
    index = np.zeros((n_y, n_y), dtype=np.intp)
    index[rows, columns] = index[columns, rows] = np.arange(len(rows))
    # dU = p . dg; a diagonal entry Y_i . Y_i contributes 2 p Y_i to dU/dY_i, an
    # off-diagonal one p Y_j.
    factor = np.where(rows == columns, 2.0, 1.0)
    return index, factor


@lru_cache(maxsize=8)
def gram_derivative(n_y: int) -> Array:
    """Constant T with dg_k/dY_m = sum_j T[k, m, j] Y_j, shape (n_g n_y, n_y)."""
    rows, columns = upper_triangle(n_y)
    n_g = len(rows)
    T = np.zeros((n_g, n_y, n_y))
    T[np.arange(n_g), rows, columns] += 1.0
    T[np.arange(n_g), columns, rows] += 1.0
    return T.reshape(n_g * n_y, n_y)


def packed_gram(Y: Array) -> Array:
    """Packed Y Y^T; Y of shape (..., n_y, d), result (..., n_g)."""
    return _packed(np.matmul(Y, np.swapaxes(Y, -1, -2)))


def packed_gram_direction(Y: Array, U: Array) -> Array:
    """Return packed Y U^T + U Y^T, the derivative of `packed_gram` at Y in direction U."""
    product: Array = np.matmul(Y, np.swapaxes(U, -1, -2))
    return _packed(product + np.swapaxes(product, -1, -2))


def unpacked_stress(p: Array, n_y: int) -> Array:
    """Symmetric W with dU/dY = W Y from p = dU/dg; shapes (..., n_g) and (..., n_y, n_y)."""
    index, factor = _unpack_index(n_y)
    return (p * factor).take(index, axis=-1)


def _packed(symmetric: Array) -> Array:
    """Upper triangle of symmetric matrices, shape (..., n_y, n_y) to (..., n_g)."""
    n_y = symmetric.shape[-1]
    flat = symmetric.reshape(*symmetric.shape[:-2], n_y * n_y)
    return flat.take(_flat_index(n_y), axis=-1)
