"""Motions without stiffness: K r + Phi_q^T mu = 0, Phi_q r = 0.

One step of inverse iteration at a shift -sigma, written with what it takes away,

    x - (K + sigma M)^-1 K x = sigma (K + sigma M)^-1 M x,

leaves rigid motions as they are and of a shape with z the part sigma/(z + sigma). What is wrong
with it is round-off of the part that goes, not of x: a wheel that turns freely keeps no part of the
waves of the beam that carries it, beside which its own terms are nothing.
"""

from __future__ import annotations

import numpy as np

from ancfdae.errors.kinds import SingularMatrix
from ancfdae.modes.linearised import EPS, ROUND_OFF, Linearised
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization

# Motions searched for at first; multiplied by _MORE as long as all motions found are rigid.
_FIRST, _MORE = 4, 4
_SWEEPS, _CLEANED = 3, 3
# Squares of the parts of a block that are more than round-off of others, and of motions that keep
# their size.
_DISTINCT, _KEPT = 1e-10, 0.5


def rigid_motions(small: Linearised) -> Array:
    """Return all rigid motions as columns, shape (n_q, count), orthonormal in M."""
    root, count = np.sqrt(small.system.weights)[:, None], _FIRST
    random = np.random.default_rng(3)
    while True:
        count = min(count, small.n_free)
        X = random.standard_normal((len(root), count)) / root
        factors = _beside(small, ROUND_OFF * EPS * small.size)
        for _ in range(_SWEEPS):
            X = small.solve(factors, small.times(small.M, X))
            X = distinct(X, small.times(small.M, X))
        R, _ = separated(small, _soft(small, X))
        if R.shape[1] < count or count == small.n_free:
            return R
        count *= _MORE


def distinct(X: Array, weighted: Array) -> Array:
    """Return a basis of columns, orthonormal in A, from A X; without round-off of the largest."""
    if not X.size:
        return X
    squares, V = np.linalg.eigh(X.T @ weighted)
    kept = squares > _DISTINCT * squares[-1]
    return np.asarray(X @ V[:, kept] / np.sqrt(squares[kept]))


def separated(small: Linearised, X: Array) -> tuple[Array, Array]:
    """Return the rigid motions in the span of columns, and the rest; all orthonormal in M."""
    if not X.size:
        return X, X
    factors = _beside(small, ROUND_OFF * float(np.max(floor(small, X))))
    Y = X
    for _ in range(_CLEANED):
        Y = Y - small.solve(factors, small.times(small.K, Y))
    squares, V = _gram(small, Y)
    kept = squares > _KEPT
    return Y @ V[:, kept] / np.sqrt(squares[kept]), X @ V[:, ~kept]


def with_zeros(small: Linearised, z: Array, X: Array, change: Array) -> tuple[Array, Array, Array]:
    """Return modes of symmetric K, rigid motions first, without parts of others and with z = 0.

    The change of z in the last sweep goes with them.
    """
    soft = np.abs(z) <= ROUND_OFF * (floor(small, X) + EPS * np.max(np.abs(z)))
    if not np.any(soft):
        return z, X, change
    R, rest = separated(small, X[:, soft])
    y, W = np.linalg.eigh(rest.T @ small.times(small.K, rest))
    none, mixed = np.zeros(R.shape[1]), np.full(len(y), np.max(change[soft]))
    values, changes = (none, y, z[~soft]), (none, mixed, change[~soft])
    X = np.hstack([R, rest @ W, X[:, ~soft]])
    return np.concatenate(values), X, np.concatenate(changes)


def undamped_part(small: Linearised, rigid: Array) -> Array:
    """Return the rigid motions that meet no damping, orthonormal in M.

    Where D is symmetric those dissipate nothing but what strains that are left of others do.
    """
    assert small.D is not None
    if small.symmetric and rigid.size:
        work, W = np.linalg.eigh(small.works(rigid, 0.0, 1.0))
        X = rigid @ W
        tau = small.largest(small.D) / small.size
        strained = np.minimum(np.abs(np.diag(small.works(X, 1.0, 0.0))), floor(small, X))
        noise = (ROUND_OFF * EPS) ** 2 * small.largest(small.D) + ROUND_OFF * tau * strained
        return np.asarray(X[:, np.abs(work) <= noise])
    root = np.sqrt(small.system.weights)[:, None]
    sizes = small.times(np.abs(small.D), np.abs(rigid)) / root
    noise = np.linalg.norm(sizes) + EPS * small.largest(small.D)
    rates = small.solve(small.mass_factors, small.times(small.D, rigid))
    _, left, Vt = np.linalg.svd(root * rates, full_matrices=False)
    return np.asarray(rigid @ Vt[left <= ROUND_OFF * EPS * noise].T)


def floor(small: Linearised, X: Array) -> Array:
    """Round-off of x^T K x for the columns of X, which have parts eps of the stiffest shapes."""
    return np.asarray(small.round_off(small.K, X) + ROUND_OFF * EPS**2 * small.size)


def _soft(small: Linearised, X: Array) -> Array:
    """Return the combinations without stiffness, to the round-off of all products."""
    _, sizes, Vt = np.linalg.svd(X.T @ small.times(small.K, X))
    X = X @ Vt.T
    return np.asarray(X[:, sizes <= ROUND_OFF * (floor(small, X) + EPS * sizes[0])])


def _gram(small: Linearised, X: Array) -> tuple[Array, Array]:
    """Eigenvalues and eigenvectors of X^T M X."""
    squares, V = np.linalg.eigh(X.T @ small.times(small.M, X))
    return squares, V


def _beside(small: Linearised, shift: float) -> Factorization:
    """Factorise K + sigma M, sigma no less than the shift."""
    while True:
        try:
            return small.saddle.factor(small.K + shift * small.M, small.Phi_q)
        except SingularMatrix:
            shift *= 4.0
