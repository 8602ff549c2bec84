"""A few eigenvalues of large systems by ARPACK, on the factorised saddle-point matrix.

The inverse of F(shift) within the constraints maps every force to a motion that keeps them, so
that all Krylov vectors do. Shifts are of the size of the eigenvalues asked for: taken from a first
rough pass at a shift near zero.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigs, eigsh

from ancfdae.modes.linearised import Linearised
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization

# First shift, relative to the largest eigenvalue: round-off leaves zero at 1e-16 of it.
_NEAR_ZERO = 1e-9
# A rough pass tells sizes, not values.
_ROUGH = 1e-2
_SHIFTS = 6


def undamped(small: Linearised, count: int, highest: bool) -> tuple[Array, Array]:
    """Return z = -s^2 in increasing order of its real part, and the shapes as columns."""
    if highest:
        return _highest(small, count, 0.0)
    shift = -_NEAR_ZERO * largest(small)
    z, _ = _near(small, shift, count, _ROUGH)
    for _ in range(_SHIFTS):
        # Below all of them: a growing motion may lie below the shift.
        shift = min(-float(np.max(np.abs(z))), 1.5 * float(np.min(z.real)))
        z, X = _near(small, shift, count, 0.0)
        if np.min(z.real) > shift:
            break
    return z, X


def largest(small: Linearised) -> float:
    """Size of the largest z = -s^2, to some per cent."""
    z, _ = _highest(small, 1, _ROUGH)
    return float(abs(z[0]))


def damped(small: Linearised, count: int, size: float) -> tuple[Array, Array]:
    """Return exponents near zero with Im s >= 0 and their shapes.

    With u = v / shift the first-order form has at the shift the inverse

        x' = -F(shift)^{-1} (shift M u + (D + shift M) x),     u' = x' + x / shift

    Parameters
    ----------
    small : Linearised
    count : int
    size : float
        Size of the exponents asked for, for example their natural frequencies.
    """
    assert small.D is not None
    n, D, M = small.system.n_q, small.D, small.M
    factors = small.saddle.factor(small.matrix(size), small.Phi_q)
    root = np.sqrt(small.system.weights)

    def inverse(y: Array) -> Array:
        x, u = y[:n] / root, y[n:] / root
        force = small.times(size * M, u) + small.times(D + size * M, x)
        moved = -small.solve(factors, force)
        return np.concatenate([root * moved, root * (moved + x / size)])

    start = _start(small, factors)
    OP = LinearOperator((2 * n, 2 * n), matvec=inverse, dtype=float)
    v_0 = np.concatenate([root * start, root * start])
    # Both of a pair of complex conjugate exponents are found.
    theta, Y = eigs(OP, k=2 * count, v0=v_0)
    s, X = size + 1 / theta, Y[:n] / root[:, None]
    return s[s.imag >= 0], X[:, s.imag >= 0]


def _near(small: Linearised, shift: float, count: int, tolerance: float) -> tuple[Array, Array]:
    """Eigenvalues of K - z M next to a shift."""
    n = small.system.n_q
    factors = small.saddle.factor(small.K - shift * small.M, small.Phi_q)
    inverse = _operator(n, lambda x: small.solve(factors, x))
    K, M = _operator(n, lambda x: small.times(small.K, x)), small.system.pattern.csr(small.M)
    start = _start(small, factors)
    routine = eigsh if small.symmetric else eigs
    z, X = routine(K, count, M, sigma=shift, OPinv=inverse, v0=start, tol=tolerance)
    order = np.argsort(z.real, kind="stable")
    return z[order], X[:, order]


def _highest(small: Linearised, count: int, tolerance: float) -> tuple[Array, Array]:
    n, factors = small.system.n_q, small.mass_factors
    inverse = _operator(n, lambda x: small.solve(factors, x))
    K, M = _operator(n, lambda x: small.times(small.K, x)), small.system.pattern.csr(small.M)
    start = _start(small, factors)
    if small.symmetric:
        z, X = eigsh(K, count, M, which="LA", Minv=inverse, v0=start, tol=tolerance)
    else:
        z, X = eigs(K, count, M, which="LR", Minv=inverse, v0=start, tol=tolerance)
    order = np.argsort(z.real, kind="stable")
    return z[order], X[:, order]


def _start(small: Linearised, factors: Factorization) -> Array:
    """Return a motion within the constraints that no symmetry keeps from any mode."""
    generator = np.random.default_rng(1)
    push = generator.standard_normal(small.system.n_q) * np.sqrt(small.system.weights)
    return small.solve(factors, push)


def _operator(n: int, times: object) -> LinearOperator:
    return LinearOperator((n, n), matvec=times, dtype=float)
