"""Polynomials in xi that the elements share (eq. 8)."""

from __future__ import annotations

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


def curvature_weights(xi: Array) -> tuple[Array, Array, Array]:
    """Return the second derivatives of `end_weight` and of both `slope_weights`."""
    return 6.0 - 12.0 * xi, 6.0 * xi - 4.0, 6.0 * xi - 2.0
