"""Orthonormal frames."""

import numpy as np

from ancfdae.numerics.arrays import Array


def orthonormal(rows: Array) -> Array:
    """Return independent rows made orthonormal in their order; the first keeps its direction."""
    Q, R = np.linalg.qr(rows.T)
    return (Q * np.sign(np.diag(R))).T
