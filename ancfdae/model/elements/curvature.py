"""Bending of cables: the curvature of the material, at the Gauss points where its energy is taken.

With t = r_x, h = l r_xx and the part of h across t, n = h - t (t . h)/(t . t), the tangent turns by

    kappa = |r_x x r_xx| / |r_x|^2 = |n| / (l |t|)

per length of the reference configuration, however the cable is stretched, and the energy is
1/2 int E I kappa^2 dx (docs/theory/02-strain-energy.md). Two Gauss points are exact for small
deflections, whose kappa is linear along an element. Forces and tangents of simulations are those of
`kernels/bending.h`; here the same formulas stand in vectors, for energies and section forces.

`bending`, (n or 1, 2), holds the flexural stiffness E I and the length l; both are zero in beams.
Y, (..., n, n_y, d), are relative node vectors, of which the chord, r_x1 and r_x2 count.
"""

import numpy as np

from ancfdae.model.elements.hermite import curvature_weights, tangent_weights
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.quadrature import box_rule

_CORNER, _RULE = box_rule((2,))
#: Gauss points of the energy of bending, in xi, shape (2,).
POINTS: Array = _CORNER[:, 0]
_T, _H = tangent_weights(POINTS), np.stack(curvature_weights(POINTS), axis=-1)


def energy(bending: Array, Y: Array) -> Array:
    """Return the energy of bending of each element, shape (..., n)."""
    per_l, Z = _scaled(bending, Y)
    return np.asarray(bending[:, 0] * per_l * _energy(Z))


def energy_along(bending: Array, change: Array, Y: Array) -> Array:
    """Return the derivative of `energy` at held Y along a change of `bending`, shape (..., n)."""
    per_l, Z = _scaled(bending, Y)
    mean, by_chord = _energy(Z), np.sum(_gradient(Z)[..., 0, :] * Z[..., 0, :], axis=-1)
    by_length = -bending[:, 0] * per_l**2 * (mean + by_chord)
    return np.asarray(change[:, 0] * per_l * mean + change[:, 1] * by_length)


def forces(bending: Array, Y: Array) -> Array:
    """Return the derivative of `energy` in Y, shape (..., n, n_y, d)."""
    per_l, Z = _scaled(bending, Y)
    on_Z = (bending[:, 0] * per_l)[:, None, None] * _gradient(Z)
    on_Z[..., 0, :] *= per_l[:, None]
    F = np.zeros(Y.shape, dtype=on_Z.dtype)
    F[..., _rows(Y), :] = on_Z
    return F


def _rows(Y: Array) -> list[int]:
    """Places of the chord, r_x1 and r_x2 among the relative node vectors."""
    return [0, 1, (Y.shape[-2] + 1) // 2]


def _scaled(bending: Array, Y: Array) -> tuple[Array, Array]:
    """1/l, shape (n or 1,), zero in beams, and chord/l, r_x1 and r_x2, shape (..., n, 3, d)."""
    l = bending[:, 1]
    per_l = np.where(l == 0, 0.0, 1 / np.where(l == 0, 1.0, l))
    Z = Y[..., _rows(Y), :].astype(np.result_type(Y, l))
    Z[..., 0, :] *= per_l[:, None]
    return per_l, Z


def _vectors(Z: Array) -> tuple[Array, Array, Array, Array]:
    """T and n at the points, shape (..., 2, d), t . t and (t . h)/(t . t), shape (..., 2, 1)."""
    t, h = _T @ Z, _H @ Z
    square = np.sum(t * t, axis=-1, keepdims=True)
    along = np.sum(t * h, axis=-1, keepdims=True) / square
    return t, h - along * t, square, along


def _energy(Z: Array) -> Array:
    """Mean of (l kappa)^2/2 over an element, shape (..., n)."""
    _, across, square, _ = _vectors(Z)
    return np.asarray(0.5 * np.sum(across * across / square, axis=-1) @ _RULE)


def _gradient(Z: Array) -> Array:
    """Return the derivative of `_energy` in Z, shape (..., n, 3, d)."""
    t, across, square, along = _vectors(Z)
    kappa_squared = np.sum(across * across, axis=-1, keepdims=True) / square
    on_t = -(along * across + kappa_squared * t) / square
    rule = _RULE[:, None]
    return np.asarray(_T.T @ (rule * on_t) + _H.T @ (rule * across / square))
