"""Sweeps of inverse iteration, which give eigenvalues and shapes all digits that there are."""

from __future__ import annotations

import numpy as np
import scipy

from ancfdae.errors.kinds import SingularMatrix
from ancfdae.modes.linearised import EPS, Linearised
from ancfdae.modes.precise import ALLOWED
from ancfdae.numerics.arrays import Array

_SWEEPS = 2


def sharpened(small: Linearised, z: Array, X: Array) -> tuple[Array, Array, Array]:
    """Sweeps of inverse iteration with all shapes of a symmetric pencil, and Ritz's method.

    Returns the error left in z, too: what the last sweep changed, d, is d rho^2 / (1 - rho^2) and
    less, as parts of shapes that are not in the block fall by rho = (z - shift) / (top - shift) or
    more, where top is the largest z in it. Far from zero a shift changes nothing, and is no proof.

    Dense eigenvalues are good to round-off of the largest one, which in a thin beam is far above
    the lowest; those of Ritz's method to that of the largest here, which would hide a rigid motion.
    """
    change = np.full(len(z), np.inf)
    for _ in range(_SWEEPS):
        noise = float(np.max(small.round_off(small.K, X)))
        # Below all of them, and as far from zero as they are: as far as round-off allows.
        shift = -max(1.5 * float(np.max(np.abs(z))), noise / EPS**0.5)
        try:
            factors = small.saddle.factor(small.K - shift * small.M, small.Phi_q)
        except SingularMatrix:
            return z, X, change
        Z = small.solve(factors, small.times(small.M, X))
        last, found = z, ritz(small, Z)
        if found is None:
            return z, X, change
        z, X = found
        change = np.abs(z - last) / _falling(z, shift, len(z) == small.n_free)
    return z, X, change


def ritz(small: Linearised, Z: Array) -> tuple[Array, Array] | None:
    """Return the values and shapes of a symmetric pencil in the span of motions, increasing."""
    Z = Z / np.sqrt(small.squares(Z))
    K, M = (Z.T @ small.times(values, Z) for values in (small.K, small.M))
    # LAPACK itself: `eigh` takes four times as long for a few shapes.
    _, W, failed = scipy.linalg.lapack.dsygv((K + K.T) / 2, (M + M.T) / 2)
    if failed:
        return None
    X = Z @ W
    return np.einsum("ij,ij->j", X, small.times(small.K, X)) / small.squares(X), X


def _falling(z: Array, shift: float, complete: bool) -> Array:
    """Return 1 - rho^2 of a sweep for each value; 1 for the largest, of which nothing is known."""
    top = np.max(z)
    rho = (z - shift) / (top - shift)
    same = top - z <= ALLOWED * np.abs(top)
    return np.where(same | complete, 1.0, 1 - rho**2)


def each_sharpened(small: Linearised, z: Array, X: Array) -> tuple[Array, Array, Array]:
    """Sweeps of inverse iteration, one shape after the other: F(z) y = F'(z) x.

    Returns what the last sweep changed in z, too.

    F(z + dz) y = F'(z) (x + dz y) in first order: dz follows where that vanishes along y.
    """
    z, X, change = z.astype(complex), X.astype(complex), np.zeros(len(z))
    for j in range(len(z)):
        for _ in range(_SWEEPS):
            x, (factors, exact) = X[:, j], small.factor_beside(z[j])
            y = small.solve(factors, small.slope_times(z[j], x))
            if not np.any(y):  # A double root: F'(z) x vanishes.
                break
            along = np.conj(small.times(small.M, y))
            step = 0.0 if exact else (along @ x) / (along @ y)
            z[j], change[j] = z[j] - step, np.abs(step)
            X[:, j] = y / np.sqrt(np.real(along @ y))
    return z if small.D is None else _quotients(small, z, X), X, change


def _quotients(small: Linearised, s: Array, X: Array) -> Array:
    """Return the root of x^H (s^2 M + s D + K) x + 2 Re mu^H Phi_q x = 0 next to s.

    Rayleigh's quotient, stationary in x and mu: a violation of the constraints, left by solves next
    to an eigenvalue, has an effect of second order. With K symmetric and D gyroscopic the root is
    imaginary to round-off of the products, so that a steady mode does not appear to grow.
    """
    assert small.D is not None
    m = small.squares(X)
    d, k = (np.einsum("ij,ij->j", np.conj(X), small.times(A, X)) for A in (small.D, small.K))
    violation = small.system.constraint_pattern.dot(small.Phi_q, X)
    k = k + 2 * np.real(np.einsum("ij,ij->j", np.conj(small.multipliers(s, X)), violation))
    half = d / (2 * m)
    root = np.sqrt(half**2 - k / m)
    # The root of larger size has no cancellation, and the product of both is k / m.
    far = -half - np.where(np.real(np.conj(half) * root) >= 0, root, -root)
    ends = far, k / m / np.where(far == 0, 1.0, far)
    return np.asarray(np.where(np.abs(ends[0] - s) <= np.abs(ends[1] - s), *ends))
