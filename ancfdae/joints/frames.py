"""Directions across a given one, complex-safe, for joints with an axis."""

from __future__ import annotations

import numpy as np

from ancfdae.numerics.arrays import Array


def unit(vector: Array) -> Array:
    """Return the vector over its length; complex perturbations go through."""
    # Scaled first, so that no square under- or overflows.
    scaled: Array = vector / np.max(np.abs(vector.real))
    result: Array = scaled / np.sqrt(np.sum(scaled * scaled))
    return result


def across(direction: Array) -> Array:
    """Return d - 1 orthonormal vectors across a direction, shape (d - 1, d).

    In space the first one is as near as possible to the coordinate axis that is most across,
    the earlier one on a tie: for the z axis the vectors are x and y.
    """
    direction = unit(direction)
    if len(direction) == 2:
        return np.stack([np.array([-direction[1], direction[0]])])
    helper = np.zeros(3)
    helper[int(np.argmin(np.round(np.abs(direction.real), 12)))] = 1.0
    first = unit(helper - np.sum(helper * direction) * direction)
    return np.stack([first, np.cross(direction, first)])


def slope_weights(slopes: Array, direction: Array) -> Array:
    """Return the weights k with sum_k weight_k slope_k = direction; slopes are rows."""
    return np.linalg.solve(slopes.T, direction)
