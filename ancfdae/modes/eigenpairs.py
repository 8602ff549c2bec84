"""Eigenpairs with their round-off, and rigid motions (without stiffness).

Rigid motions solve K r + Phi_q^T mu = 0, Phi_q r = 0. One step of inverse iteration at a shift
-sigma, written as a correction,

    x - (K + sigma M)^-1 K x = sigma (K + sigma M)^-1 M x,

leaves rigid motions unchanged and multiplies a shape with eigenvalue z by sigma/(z + sigma). The
error of the step is round-off of the correction, not of x: a wheel that rotates freely has no
component of waves in the beam that carries it, though the entries of K for the beam are far larger.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.errors.kinds import SingularMatrix
from ancfdae.modes.linearised import EPS, ROUND_OFF, Linearised
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.linear_solvers import Factorization

# Size of the first block of motions; multiplied by _MORE as long as all motions found are rigid.
_FIRST, _MORE = 4, 4
_SWEEPS, _CLEANED = 3, 3
# Least squares of relative lengths: of independent columns of a block, beyond round-off, and of
# motions that inverse iteration leaves unchanged.
_DISTINCT, _KEPT = 1e-10, 0.5


def rigid_motions(small: Linearised) -> Array:
    """Return all rigid motions as columns, shape (n_q, count), orthonormal in M.

    Those of `Linearised.idle` are known, and come first.
    """
    root, count, random = np.sqrt(small.system.weights)[:, None], _FIRST, np.random.default_rng(3)
    known = np.zeros((len(root), len(small.idle)))
    known[small.idle, np.arange(len(small.idle))] = 1 / root[small.idle, 0]
    most = small.n_free - len(small.idle)
    while True:
        count = min(count, most)
        X = random.standard_normal((len(root), count)) / root
        factors = _beside(small, ROUND_OFF * EPS * small.size)
        for _ in range(_SWEEPS):
            X = small.solve(factors, small.times(small.M, X))
            X[small.idle] = 0.0
            X = distinct(X, small.times(small.M, X))
        R, _ = separated(small, _soft(small, X))
        if R.shape[1] < count or count == most:
            return np.hstack([known, _unseen(small, R)])
        count *= _MORE


def _unseen(small: Linearised, R: Array) -> Array:
    """Return the rigid motions that no state measures, shape (n_q, m), in the span of R, (n_q, k).

    Rows of K of states vanish for them. A position that acts through a state only has no stiffness
    of its own, and is not free.
    """
    if not (len(small.idle) and R.size):
        return R
    root = np.sqrt(small.system.weights)[:, None]
    seen, sizes = (
        (small.times(K, x) / root)[small.idle] for K, x in ((small.K, R), (abs(small.K), abs(R)))
    )
    _, left, Vt = np.linalg.svd(seen)
    left = np.append(left, np.zeros(R.shape[1]))[: R.shape[1]]
    return np.asarray(R @ Vt[left <= ROUND_OFF * EPS * np.linalg.norm(sizes)].T)


def distinct(X: Array, weighted: Array) -> Array:
    """Return a basis of the columns of X, orthonormal in A, from A X; without round-off."""
    if not X.size:
        return X
    squares, V = np.linalg.eigh(X.T @ weighted)
    kept = squares > _DISTINCT * squares[-1]
    return np.asarray(X @ V[:, kept] / np.sqrt(squares[kept]))


def separated(small: Linearised, X: Array) -> tuple[Array, Array]:
    """Return the rigid motions in the span of X and the remaining motions, orthonormal in M."""
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
    """Return modes of symmetric K, rigid motions first with z = 0, other modes free of them.

    The changes of z in the last sweep are reordered alike; shapes are columns of X, (n_q, k).
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
    """Return the rigid motions that meet no damping, (n_q, k), orthonormal in M.

    With a symmetric D these are the rigid motions whose dissipated power is below its round-off:
    the power that strains of round-off size would dissipate.
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
    """Return the round-off of x^T K x for each column of X, shape (k,).

    It includes stiffest shapes that the columns contain with a relative size of eps.
    """
    return np.asarray(small.round_off(small.K, X) + ROUND_OFF * EPS**2 * small.size)


def _soft(small: Linearised, X: Array) -> Array:
    """Return the combinations of the columns of X without stiffness, to round-off."""
    _, sizes, Vt = np.linalg.svd(X.T @ small.times(small.K, X))
    X = X @ Vt.T
    return np.asarray(X[:, sizes <= ROUND_OFF * (floor(small, X) + EPS * sizes[0])])


def _gram(small: Linearised, X: Array) -> tuple[Array, Array]:
    """Return the eigenvalues and eigenvectors of X^T M X."""
    squares, V = np.linalg.eigh(X.T @ small.times(small.M, X))
    return squares, V


def _beside(small: Linearised, shift: float) -> Factorization:
    """Return the factors of K + sigma M with Phi_q for a regular sigma, at least `shift`."""
    while True:
        try:
            return small.saddle.factor(small.K + shift * small.M, small.Phi_q)
        except SingularMatrix:
            shift *= 4.0


# -- solutions ---------------------------------------------------------------------------------


# Round-off is estimated as _MARGIN times the change of a value under other rounding.
_MARGIN, _TINY = 4.0, float(np.finfo(float).tiny)


@final
@dataclass(frozen=True)
class Eigenpairs:
    """Solutions of F(z) x + Phi_q^T mu = 0, Phi_q x = 0, with the round-off of z.

    z, shape (k,), is -s^2 without damping and s with damping; exactly zero for rigid motions.
    Shapes x are the columns of X, (n_q, k): x^H M x = 1, and the largest entry is real and
    positive.
    """

    z: Array
    X: Array
    noise: Array

    def first(self, count: int) -> Eigenpairs:
        """Return the first `count` pairs, and those that coincide with the last of them."""
        groups = coincident(self)
        stop = next(g[-1] + 1 for g in groups if g[-1] + 1 >= min(count, len(self.z)))
        return Eigenpairs(self.z[:stop], self.X[:, :stop], self.noise[:stop])


def without_idle(small: Linearised, pairs: Eigenpairs) -> Eigenpairs:
    """Return the pairs without the motions at z = 0 of `Linearised.idle` alone."""
    still = pairs.z == 0
    R = pairs.X[:, still].real
    R[small.idle] = 0.0
    # The columns had the length one: what is left of a motion of idle coordinates is round-off.
    squares, V = _gram(small, R) if R.size else (np.zeros(0), np.zeros((0, 0)))
    kept = squares > _DISTINCT
    R = R @ V[:, kept] / np.sqrt(squares[kept])
    first, count = int(np.argmax(still)), int(np.sum(still))
    ahead, behind = slice(0, first), slice(first + count, None)
    none = np.zeros(R.shape[1])
    return Eigenpairs(
        np.concatenate([pairs.z[ahead], none, pairs.z[behind]]),
        np.hstack([pairs.X[:, ahead], R, pairs.X[:, behind]]),
        np.concatenate([pairs.noise[ahead], none, pairs.noise[behind]]),
    )


def coincident(pairs: Eigenpairs) -> list[list[int]]:
    """Return groups of indices of neighbours whose z coincide.

    z coincide if they differ by less than the root of their relative round-off. At a relative gap g
    round-off e mixes the shapes by e/g: at g = sqrt(e) shapes, and derivatives that take the modes
    for simple, are as inaccurate as derivatives that take them for coinciding.
    """
    half = half_gap(pairs.z, pairs.noise)
    apart = np.abs(np.diff(pairs.z)) > half[:-1] + half[1:]
    ends = [0, *(np.flatnonzero(apart) + 1).tolist(), len(pairs.z)]
    return [list(range(*pair)) for pair in itertools.pairwise(ends) if pair[0] < pair[1]]


def half_gap(z: Array, noise: Array) -> Array:
    """Return for each z half the distance up to which neighbours coincide, shape (n,)."""
    return np.asarray(np.sqrt(noise * np.maximum(np.abs(z), noise)))


def finished(small: Linearised, z: Array, X: Array, noise: Array | None = None) -> Eigenpairs:
    """Return eigenpairs with normalised shapes, and z set to zero where it is round-off."""
    X = X / np.sqrt(small.squares(X))
    pivot = X[largest_entries(small, X), np.arange(X.shape[1])]
    X = X * (np.abs(pivot) / pivot)
    noise = noise_of(small, z, X) if noise is None else noise
    if small.D is None:
        z = np.where(np.abs(z) <= ROUND_OFF * noise, 0.0, z)
        z = np.where(np.abs(z.imag) <= ROUND_OFF * noise, z.real, z)
    else:
        z = np.where(np.abs(z.real) <= ROUND_OFF * noise, 1j * z.imag, z)
        # A coinciding complex conjugate pair is a double real root: the mode decays.
        z = np.where(np.abs(z.imag) <= half_gap(z, noise), z.real, z)
    return Eigenpairs(z, X, noise)


def largest_entries(small: Linearised, X: Array) -> Array:
    """Return the index of the largest entry of each shape, in the norm of the weights, (k,).

    Among entries within 1e-3 of the largest it is the first: equal entries differ by round-off
    only.
    """
    size = np.abs(X) * np.sqrt(small.system.weights)[:, None]
    return np.asarray(np.argmax(size >= (1 - 1e-3) * np.max(size, axis=0), axis=0))


def noise_of(small: Linearised, z: Array, X: Array) -> Array:
    """Return the round-off of z: of the terms of x^H F(z) x, over |x^H F'(z) x|; shape (k,)."""
    X = X / np.sqrt(small.squares(X))
    size, noise = np.abs(z), floor(small, X)
    if small.D is None:
        return noise + size * EPS
    noise = noise + size * small.round_off(small.D, X) + size**2 * EPS
    slope = 2 * z + np.einsum("ij,ij->j", np.conj(X), small.times(small.D, X))
    return np.asarray(noise / np.maximum(np.abs(slope), np.sqrt(noise)))


def likely_error(small: Linearised, pairs: Eigenpairs, change: Array) -> Array:
    """Return the likely error of z, (k,), from the last sweep and from rounding K differently.

    The round-off in `pairs` is a bound, hundreds of times larger where many terms are summed.
    """
    pattern = small.system.pattern
    signs = 2.0 * np.random.default_rng(4).integers(0, 2, pattern.size) - 1.0
    other = EPS * small.times(signs * small.K, pairs.X)
    moved = np.abs(np.einsum("ij,ij->j", np.conj(pairs.X), other))
    if small.D is not None:
        slope = np.einsum("ij,ij->j", np.conj(pairs.X), small.times(small.D, pairs.X))
        moved = moved / np.maximum(np.abs(2 * pairs.z + slope), np.sqrt(moved) + _TINY)
    return np.asarray(np.maximum(change, _MARGIN * moved))
