"""Polynomials in xi that the elements share, and shape functions of beams with sections (eq. 8)."""

from typing import Any

import numpy as np

from ancfdae.model.elements.element import Quantity
from ancfdae.numerics.arrays import Array


def end_weight(xi: Array) -> Array:
    """Weight of the second node's position, 3 xi^2 - 2 xi^3; the first has one minus it."""
    return xi * xi * (3.0 - 2.0 * xi)


def slope_weights(xi: Array) -> tuple[Array, Array]:
    """Weights of the axial slopes per unit length: xi - 2 xi^2 + xi^3 and -xi^2 + xi^3."""
    return xi * (1.0 - xi) ** 2, -xi * xi * (1.0 - xi)


def end_weight_xi(xi: Array) -> Array:
    """Return the derivative of `end_weight` in xi."""
    return 6.0 * xi * (1.0 - xi)


def slope_weights_xi(xi: Array) -> tuple[Array, Array]:
    """Return the derivatives of `slope_weights` in xi."""
    return (1.0 - xi) * (1.0 - 3.0 * xi), xi * (3.0 * xi - 2.0)


def tangent_weights(xi: Array) -> Array:
    """Return the weights of the chord and both axial slopes in dr/dx at unit length, (..., 3)."""
    return np.stack([end_weight_xi(xi), *slope_weights_xi(xi)], axis=-1)


def curvature_weights(xi: Array) -> tuple[Array, Array, Array]:
    """Return the second derivatives of `end_weight` and of both `slope_weights`."""
    return 6.0 - 12.0 * xi, 6.0 * xi - 4.0, 6.0 * xi - 2.0


def shape_weights(d: int, quantity: Quantity, xi: Any, y: Any, z: Any) -> Array:
    """Return the weights of node vectors in a position or slope, shape (..., 2 (d + 1)).

    Eq. (8), in space with the terms of the width (docs/theory/01-elements.md), at unit length and
    at places xi, y and z that broadcast.
    """
    shape, dtype = np.broadcast(xi, y, z).shape, np.result_type(xi, y, z, float)
    # The nodes along the second axis from the end.
    w = np.zeros((*shape, 2, d + 1), dtype=dtype)
    if quantity is Quantity.POSITION:
        s5 = end_weight(xi)
        w[..., 0, 0], w[..., 1, 0] = 1 - s5, s5
        w[..., 0, 1], w[..., 1, 1] = slope_weights(xi)
        for k, offset in enumerate((y, z)[: d - 1], start=2):
            w[..., 0, k], w[..., 1, k] = offset * (1 - xi), offset * xi
    elif quantity is Quantity.SLOPE_X:
        s5 = end_weight_xi(xi)
        w[..., 0, 0], w[..., 1, 0] = -s5, s5
        w[..., 0, 1], w[..., 1, 1] = slope_weights_xi(xi)
        for k, offset in enumerate((y, z)[: d - 1], start=2):
            w[..., 0, k], w[..., 1, k] = -offset, offset
    else:
        w[..., 0, quantity], w[..., 1, quantity] = 1 - xi, xi
    return w.reshape(*shape, -1)
