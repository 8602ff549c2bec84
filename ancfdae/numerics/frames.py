"""Orthonormal frames, and vectors of the plane in space."""

import numpy as np

from ancfdae.numerics.arrays import Array


def orthonormal(rows: Array) -> Array:
    """Return independent rows made orthonormal in their order; the first keeps its direction."""
    Q, R = np.linalg.qr(rows.T)
    return (Q * np.sign(np.diag(R))).T


def in_space(vectors: Array) -> Array:
    """Give vectors of the plane a third component, zero."""
    missing = np.zeros((*vectors.shape[:-1], 3 - vectors.shape[-1]), dtype=vectors.dtype)
    return np.concatenate([vectors, missing], axis=-1)
