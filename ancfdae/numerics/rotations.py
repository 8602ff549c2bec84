"""Rotation matrices from rotation vectors, complex-safe, many at once; orthonormal frames."""

import numpy as np

from ancfdae.numerics.arrays import Array


def orthonormal(rows: Array) -> Array:
    """Return independent rows orthonormalised in their order; the first keeps its direction."""
    Q, R = np.linalg.qr(rows.T)
    return (Q * np.sign(np.diag(R))).T


def in_space(vectors: Array) -> Array:
    """Return vectors of the plane, (..., 2), with a third component zero, (..., 3)."""
    missing = np.zeros((*vectors.shape[:-1], 3 - vectors.shape[-1]), dtype=vectors.dtype)
    return np.concatenate([vectors, missing], axis=-1)


_PLANAR = np.array([[[0.0, -1.0], [1.0, 0.0]]])
_SPATIAL = np.array(
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    ]
)
# Terms of the series of sin(x)/x and (1 - cos x)/x^2; below |x| = 1 the next term is under eps.
_TERMS = 10


def generators(d: int) -> Array:
    """Return the matrices E_k of rotations about each axis, E_k r = e_k x r, shape (n_r, d, d).

    n_r is one in the plane and three in space.
    """
    return _PLANAR if d == 2 else _SPATIAL


def rotation(turn: Array, d: int) -> Array:
    """Return the matrix, (d, d), of a rotation vector along the axis, of the length of the angle.

    exp(W) = I + sin(x)/x W + (1 - cos x)/x^2 W^2, x = |turn|; `turn` has one entry in the plane.
    """
    if not np.any(turn):
        return np.eye(d, dtype=np.result_type(turn, float))
    turn = np.atleast_1d(turn)
    W = np.tensordot(turn, generators(d), 1)
    squared = np.sum(turn * turn)
    if np.abs(squared.real) < 1.0:
        first, second = _series(squared, 1), _series(squared, 2)
    else:
        x = np.sqrt(squared)
        first, second = np.sin(x) / x, (1.0 - np.cos(x)) / squared
    return np.eye(d) + first * W + second * (W @ W)


def _series(squared: Array, order: int) -> Array:
    """Return the sum of (-x^2)^k / (2 k + order)!, by Horner's rule."""
    total = 0.0 * squared + 1.0
    for k in range(_TERMS, 0, -1):
        total = 1.0 - squared / ((2 * k + order) * (2 * k + order - 1)) * total
    return total / order


def cayley(g: Array, d: int) -> Array:
    """Return rotations from their Gibbs vectors, shape (n, n_r) to (n, d, d).

    g points along the axis and is 2 tan(angle / 2) long:
    R = I + (G + G^2 / 2) / (1 + g.g / 4), G r = g x r. Rational, so that derivatives are too.
    """
    G = np.tensordot(g, generators(d), 1)
    size = 1.0 + np.sum(g * g, axis=-1)[:, None, None] / 4
    return np.eye(d) + (G + 0.5 * G @ G) / size


def cayley_partials(g: Array, d: int) -> Array:
    """Return the partials of `cayley` in the entries of g, shape (n_r, n, d, d)."""
    E = generators(d)[:, None]
    G = np.tensordot(g, generators(d), 1)
    size = 1.0 + np.sum(g * g, axis=-1)[:, None, None] / 4
    shrink = 0.5 * g.T[..., None, None] * (G + 0.5 * G @ G) / size
    return (E + 0.5 * (E @ G + G @ E) - shrink) / size
