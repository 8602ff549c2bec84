"""Lengths and directions of vectors, and their rates, complex-safe."""

from __future__ import annotations

import numpy as np

from ancfdae.numerics.arrays import Array


def dot(a: Array, b: Array) -> Array:
    """Return a . b over the last axis, which is kept."""
    product: Array = np.sum(a * b, axis=-1, keepdims=True)
    return product


def direction(e: Array) -> tuple[Array, Array]:
    """Return the length l of vectors, shape (..., 1), and n = e / l."""
    l = np.sqrt(dot(e, e))
    return l, e / l


def direction_rate(e: Array, w: Array) -> tuple[Array, Array]:
    """Return l' = n . w and n' = (w - n l') / l for e' = w."""
    l, n = direction(e)
    l_1 = dot(n, w)
    return l_1, (w - n * l_1) / l
