"""Gauss-Legendre quadrature over the reference element."""

from functools import lru_cache

import numpy as np

from ancfdae.numerics.arrays import Array


@lru_cache(maxsize=32)
def box_rule(counts: tuple[int, ...]) -> tuple[Array, Array]:
    """Tensor rule on xi in [0, 1] and each transverse coordinate in [-1/2, 1/2].

    Returns points, shape (n_p, len(counts)), and weights that sum to one; n points along a
    direction integrate polynomials of degree 2 n - 1 exactly.
    """
    rules = [np.polynomial.legendre.leggauss(count) for count in counts]
    axes = [0.5 * (x + 1.0) if k == 0 else 0.5 * x for k, (x, _) in enumerate(rules)]
    points = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    weights = np.ones(1)
    for _, w in rules:
        weights = np.outer(weights, 0.5 * w).ravel()
    points.setflags(write=False)
    weights.setflags(write=False)
    return points, weights
