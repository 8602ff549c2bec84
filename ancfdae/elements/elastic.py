"""Elastic energy, force, tangent and their derivatives, batched over elements.

Everything is a product of the invariant A with the packed Gram matrix of the
relative node vectors Y (docs/theory.md, section 2):

    U = 1/2 dg^T A dg,   dg = g(Y) - g_o,   p = A dg,
    dU/dY   = W(p) Y                                         (eqs. 13, 17)
    tangent = W(p) (x) I_d + G^T A G,   G = dg/dY            (eq. 19)

A has shape (n, n_g, n_g), or (1, n_g, n_g) when all elements share it.
"""

from __future__ import annotations

import numpy as np

from ancfdae.elements.packing import (
    gram_derivative,
    packed_gram,
    packed_gram_direction,
    unpacked_stress,
)
from ancfdae.numerics.arrays import Array


def apply_invariant(A: Array, x: Array) -> Array:
    """Return A x per element; shapes (n or 1, n_g, n_g) and (n, n_g)."""
    product: Array = x @ A[0] if len(A) == 1 else np.matmul(A, x[..., None])[..., 0]
    return product


def energy(A: Array, g_o: Array, Y: Array) -> Array:
    """Strain energy of each element, shape (n,)."""
    dg = packed_gram(Y) - g_o
    U: Array = 0.5 * np.sum(dg * apply_invariant(A, dg), axis=1)
    return U


def stress(A: Array, g_o: Array, Y: Array) -> Array:
    """Symmetric W with dU/dY = W Y, shape (n, n_y, n_y)."""
    return unpacked_stress(apply_invariant(A, packed_gram(Y) - g_o), Y.shape[1])


def force(A: Array, g_o: Array, Y: Array) -> Array:
    """Gradient of the strain energy in Y, shape (n, n_y, d)."""
    F: Array = np.matmul(stress(A, g_o, Y), Y)
    return F


def tangent(A: Array, g_o: Array, Y: Array) -> Array:
    """Hessian of the strain energy in Y, shape (n, n_y d, n_y d), symmetric."""
    n, n_y, d = Y.shape
    W = stress(A, g_o, Y)
    G = np.matmul(gram_derivative(n_y), Y).reshape(n, -1, n_y * d)
    K: Array = np.matmul(G.transpose(0, 2, 1), np.matmul(A, G))
    blocks = K.reshape(n, n_y, d, n_y, d)
    for axis in range(d):
        blocks[:, :, axis, :, axis] += W
    return K


def force_direction(A: Array, g_o: Array, Y: Array, U: Array) -> Array:
    """Return the derivative of `force` in direction U: W(A g'[U]) Y + W(p) U."""
    W_u = unpacked_stress(apply_invariant(A, packed_gram_direction(Y, U)), Y.shape[1])
    F_u: Array = np.matmul(W_u, Y) + np.matmul(stress(A, g_o, Y), U)
    return F_u


def force_second_direction(A: Array, Y: Array, U: Array, V: Array) -> Array:
    """Second derivative of `force` in directions U and V.

    W(A g''[U, V]) Y + W(A g'[U]) V + W(A g'[V]) U; g is quadratic, so g'' is constant.
    """
    n_y = Y.shape[1]
    W_uv = unpacked_stress(apply_invariant(A, packed_gram_direction(U, V)), n_y)
    W_u = unpacked_stress(apply_invariant(A, packed_gram_direction(Y, U)), n_y)
    W_v = unpacked_stress(apply_invariant(A, packed_gram_direction(Y, V)), n_y)
    F_uv: Array = np.matmul(W_uv, Y) + np.matmul(W_u, V) + np.matmul(W_v, U)
    return F_uv


def force_partial(A_b: Array, c_b: Array, g_o: Array, Y: Array) -> Array:
    """Partial derivative of `force` in a design parameter (eqs. 24, 25), shape (n, n_y, d)."""
    p_b = apply_invariant(A_b, packed_gram(Y) - g_o) - c_b
    F_b: Array = np.matmul(unpacked_stress(p_b, Y.shape[1]), Y)
    return F_b


def force_partial_direction(A_b: Array, c_b: Array, g_o: Array, Y: Array, U: Array) -> Array:
    """Return the derivative of `force_partial` in direction U."""
    n_y = Y.shape[1]
    p_b = apply_invariant(A_b, packed_gram(Y) - g_o) - c_b
    p_bu = apply_invariant(A_b, packed_gram_direction(Y, U))
    W_b, W_bu = unpacked_stress(p_b, n_y), unpacked_stress(p_bu, n_y)
    F_bu: Array = np.matmul(W_bu, Y) + np.matmul(W_b, U)
    return F_bu
