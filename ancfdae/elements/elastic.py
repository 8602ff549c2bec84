"""Elastic energy, force, tangent and their derivatives, batched over elements and instants.

Everything is a product of the invariant A with the packed Gram matrix of the
relative node vectors Y (docs/theory.md, section 2):

    U = 1/2 dg^T A dg + p_o^T dg,   dg = g(Y) - g_o,
    force   = W(p) Y,    p = A (dg + tau g') + p_o,   g' = dg/dt     (eqs. 13, 17)
    tangent = W(p) (x) I_d + G(Y)^T A (G(Y) + tau G(V))        (eq. 19)
    damping tangent = tau G(Y)^T A G(Y),        G(Y) = dg/dY

tau is the retardation time of Kelvin-Voigt damping, stress = C (E + tau E').
Y and V have shape (..., n, n_y, d): leading axes are instants. A has shape
(n, n_g, n_g), or (1, n_g, n_g) when all elements share it. Undamped calls
leave V and tau out and pay nothing for them; most elements have no p_o.
"""

from __future__ import annotations

import math

import numpy as np

from ancfdae.elements.packing import (
    gram_derivative,
    packed_gram,
    packed_gram_direction,
    unpacked_stress,
)
from ancfdae.numerics.arrays import Array


def apply_invariant(A: Array, x: Array) -> Array:
    """Return A x per element; shapes (n or 1, n_g, n_g) and (..., n, n_g)."""
    product: Array
    if x.dtype.kind == "c" and A.dtype.kind != "c":
        # One after the other, so that A is not copied.
        product = apply_invariant(A, x.real) + 1j * apply_invariant(A, x.imag)
    elif len(A) == 1:
        product = x @ A[0]
    elif x.ndim == 2:
        product = np.matmul(A, x[..., None])[..., 0]
    else:
        # A is symmetric; one product per element for all instants instead of one for each.
        instants = x.reshape(math.prod(x.shape[:-2]), *x.shape[-2:]).swapaxes(0, 1)
        product = np.matmul(instants, A).swapaxes(0, 1).reshape(x.shape)
    return product


def strain(g_o: Array, Y: Array, V: Array | None = None, tau: Array | None = None) -> Array:
    """Return dg + tau g', what stresses are proportional to, shape (..., n, n_g)."""
    dg = packed_gram(Y) - g_o
    if V is not None and tau is not None:
        dg = dg + tau[:, None] * packed_gram_direction(Y, V)
    return dg


def stress(A: Array, x: Array, p_o: Array | None) -> Array:
    """Return p = A x + p_o of strains x, shape (..., n, n_g)."""
    p = apply_invariant(A, x)
    return p if p_o is None else p + p_o


def energy(A: Array, g_o: Array, Y: Array, p_o: Array | None = None) -> Array:
    """Return the strain energy of each element, shape (..., n)."""
    dg = strain(g_o, Y)
    p = 0.5 * apply_invariant(A, dg)
    U: Array = np.sum(dg * (p if p_o is None else p + p_o), axis=-1)
    return U


def force(
    A: Array,
    g_o: Array,
    Y: Array,
    V: Array | None = None,
    tau: Array | None = None,
    p_o: Array | None = None,
) -> Array:
    """Return the elastic force in Y; undamped, the gradient of the energy. Shape as Y."""
    return stressed(stress(A, strain(g_o, Y, V, tau), p_o), Y)


def stressed(p: Array, Y: Array) -> Array:
    """Return W(p) Y; shapes (..., n, n_g) and (..., n, n_y, d)."""
    F: Array = np.matmul(unpacked_stress(p, Y.shape[-2]), Y)
    return F


def tangent(
    A: Array,
    g_o: Array,
    Y: Array,
    V: Array | None = None,
    tau: Array | None = None,
    p_o: Array | None = None,
) -> Array:
    """Return the derivative of `force` in Y, shape (..., n, n_y d, n_y d)."""
    n_y, d = Y.shape[-2:]
    W = unpacked_stress(stress(A, strain(g_o, Y, V, tau), p_o), n_y)
    G = gram_jacobian(Y)
    H = G if V is None or tau is None else G + tau[:, None, None] * gram_jacobian(V)
    K: Array = np.matmul(np.swapaxes(G, -1, -2), np.matmul(A, H))
    blocks = K.reshape(*Y.shape[:-2], n_y, d, n_y, d)
    for axis in range(d):
        blocks[..., :, axis, :, axis] += W
    return K


def damping_tangent(A: Array, Y: Array, tau: Array) -> Array:
    """Return the derivative of `force` in V, shape (..., n, n_y d, n_y d)."""
    G = gram_jacobian(Y)
    K: Array = np.matmul(np.swapaxes(G, -1, -2), np.matmul(tau[:, None, None] * A, G))
    return K


def force_rate(
    A: Array,
    g_o: Array,
    Y: Array,
    V: Array,
    acceleration: Array,
    tau: Array | None = None,
    p_o: Array | None = None,
) -> Array:
    """Return d(force)/dt along the motion: W(p') Y + W(p) V. Shape as Y.

    p' = A (g' + tau g''), g'' the second time derivative of the Gram matrix.
    """
    rate = packed_gram_direction(Y, V)
    if tau is not None:
        curvature = packed_gram_direction(Y, acceleration) + packed_gram_direction(V, V)
        rate = rate + tau[:, None] * curvature
    p = stress(A, strain(g_o, Y, V, tau), p_o)
    return stressed(apply_invariant(A, rate), Y) + stressed(p, V)


def force_partial(A_b: Array, c_b: Array, x: Array, Y: Array) -> Array:
    """Return the partial of `force` in a design parameter (eqs. 24, 25), shape as Y.

    Parameters
    ----------
    A_b, c_b : array, shape (n, n_g, n_g) and (n, n_g)
        Derivative invariants.
    x : array, shape (..., n, n_g)
        The `strain` of these elements.
    Y : array, shape (..., n, n_y, d)
    """
    return stressed(apply_invariant(A_b, x) - c_b, Y)


def force_total(
    A: Array,
    p: Array,
    p_b: Array,
    YU: tuple[Array, Array],
    VU: tuple[Array, Array] | None = None,
    tau: Array | None = None,
) -> Array:
    """Return the total derivative of `force`, all directions at once.

    dF = G(Y)^T dp + W(p) dY,  dp = A (G(Y) dY + tau (G(V) dY + G(Y) dV)) + p_b. The tangent itself,
    whose products cost several times as much, is not formed.

    Parameters
    ----------
    A : array, shape (n or 1, n_g, n_g)
    p : array, shape (n, n_g)
        Stresses A (dg + tau g') + p_o.
    p_b : array, shape (n, n_g, n_b)
        Partial of p at fixed Y and V.
    YU, VU : pair of array, shape (n, n_y, d) and (n, n_y d, n_b)
        Y and V with their derivatives; V and tau None without damping.

    Returns
    -------
    array, shape (n, n_y d, n_b)
    """
    Y, U = YU
    G = gram_jacobian(Y)
    x_b = np.matmul(G, U)
    if VU is not None and tau is not None:
        rate_b = np.matmul(gram_jacobian(VU[0]), U) + np.matmul(G, VU[1])
        x_b = x_b + tau[:, None, None] * rate_b
    bent = np.matmul(np.swapaxes(G, -1, -2), np.matmul(A, x_b) + p_b)
    split = U.reshape(*Y.shape[:2], Y.shape[2] * U.shape[2])
    turned = np.matmul(unpacked_stress(p, Y.shape[1]), split)
    total: Array = bent + turned.reshape(U.shape)
    return total


def gram_jacobian(Y: Array) -> Array:
    """G(Y) = dg/dY, shape (..., n, n_g, n_y d)."""
    n_y, d = Y.shape[-2:]
    G: Array = np.matmul(gram_derivative(n_y), Y)
    return G.reshape(*Y.shape[:-2], n_y * (n_y + 1) // 2, n_y * d)
