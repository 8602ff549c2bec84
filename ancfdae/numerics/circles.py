"""Derivatives of any order of analytic functions, from their values on a circle (Cauchy).

The coefficient of z^r in f is the mean of f(z) z^-r over a circle |z| = rho. From N points its
error is (rho/R)^N with the radius R of convergence, and round-off over rho^r. A circle is small
enough if the coefficient of half the order N is small; of those the one with the least round-off
serves.
"""

from collections.abc import Callable

import numpy as np

from ancfdae.numerics.arrays import Array

# Points of a circle, and the upper half of them: f(conj z) = conj f(z).
_POINTS = 16
_UPPER = np.exp(2j * np.pi * np.arange(_POINTS // 2 + 1) / _POINTS)
# First radius, for functions that vary over arguments of the order of one; the factor between
# radii, and how many are tried.
_RADIUS, _FACTOR, _TRIALS = 0.125, 4.0, 8
# Largest middle coefficient over the largest one, at the unit of the radius.
_SMALL = 1e-7


def coefficient(f: Callable[[complex], Array], order: int) -> Array:
    """Return f^(r)(0) / r!, of the shape of f, for a function that is real at real numbers; r <= 4.

    If f is analytic on no circle tried, the circle with the smallest middle coefficient is taken.
    """
    best, error, least, radius = np.zeros(()), np.array(np.inf), np.inf, _RADIUS
    with np.errstate(all="ignore"):
        for _ in range(_TRIALS):
            upper = np.array([f(radius * z) for z in _UPPER.tolist()])
            values = np.concatenate([upper, np.conj(upper[-2:0:-1])])
            parts = np.fft.fft(values, axis=0).real / _POINTS
            size = np.max(np.abs(parts), axis=0)
            middle = np.abs(parts[_POINTS // 2 - 1 : _POINTS // 2 + 1]).max(axis=0)
            share = np.max(middle / np.where(size > 0, size, 1.0), initial=0.0)
            found, round_off = parts[order] / radius**order, size / radius**order
            if share <= _SMALL:
                better = round_off < 0.5 * error
                best, error = np.where(better, found, best), np.minimum(error, round_off)
                if _SMALL < least < np.inf or not np.any(better):
                    break  # Shrunk so far, or round-off is least.
                least, radius = 0.0, radius * _FACTOR
            elif least <= _SMALL:
                break
            else:
                if share < least or np.ndim(best) == 0:
                    best, least = found, min(share, 1.0)
                radius /= _FACTOR
    return best
