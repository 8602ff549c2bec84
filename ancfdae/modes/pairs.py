"""Solutions of the eigenvalue problem, with their round-off."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import final

import numpy as np

from ancfdae.modes.linearised import EPS, ROUND_OFF, Linearised
from ancfdae.modes.rigid import floor
from ancfdae.numerics.arrays import Array

# Round-off is estimated as _MARGIN times the change of a value under other rounding.
_MARGIN, _TINY = 4.0, float(np.finfo(float).tiny)


@final
@dataclass(frozen=True)
class Eigenpairs:
    """Solutions of F(z) x + Phi_q^T mu = 0, Phi_q x = 0, columns of X, with the round-off in z.

    z is -s^2 without damping, s with it; exactly zero for rigid motions. x^H M x = 1, and the
    largest entry of x is real and positive.
    """

    z: Array
    X: Array
    noise: Array

    def first(self, count: int) -> Eigenpairs:
        """Return the first ones; those that coincide with the last of them too."""
        groups = coincident(self)
        stop = next(g[-1] + 1 for g in groups if g[-1] + 1 >= min(count, len(self.z)))
        return Eigenpairs(self.z[:stop], self.X[:, :stop], self.noise[:stop])


def coincident(pairs: Eigenpairs) -> list[list[int]]:
    """Group neighbours whose z are nearer than the root of their relative round-off.

    At a relative gap of g round-off e turns the shapes into each other by e/g: at g = sqrt(e)
    they, and derivatives that take them for simple, have lost as much as those that take them
    for one.
    """
    half = half_gap(pairs.z, pairs.noise)
    apart = np.abs(np.diff(pairs.z)) > half[:-1] + half[1:]
    ends = [0, *(np.flatnonzero(apart) + 1).tolist(), len(pairs.z)]
    return [list(range(*pair)) for pair in itertools.pairwise(ends) if pair[0] < pair[1]]


def half_gap(z: Array, noise: Array) -> Array:
    """Return half the distance up to which neighbours coincide, shape (n,)."""
    return np.asarray(np.sqrt(noise * np.maximum(np.abs(z), noise)))


def finished(small: Linearised, z: Array, X: Array, noise: Array | None = None) -> Eigenpairs:
    """Name zero what is zero to round-off; norm and sign of the shapes."""
    X = X / np.sqrt(small.squares(X))
    pivot = X[largest_entries(small, X), np.arange(X.shape[1])]
    X = X * (np.abs(pivot) / pivot)
    noise = noise_of(small, z, X) if noise is None else noise
    if small.D is None:
        z = np.where(np.abs(z) <= ROUND_OFF * noise, 0.0, z)
        z = np.where(np.abs(z.imag) <= ROUND_OFF * noise, z.real, z)
    else:
        z = np.where(np.abs(z.real) <= ROUND_OFF * noise, 1j * z.imag, z)
        # A pair that coincides is a double real root: it creeps.
        z = np.where(np.abs(z.imag) <= half_gap(z, noise), z.real, z)
    return Eigenpairs(z, X, noise)


def largest_entries(small: Linearised, X: Array) -> Array:
    """Return the number of the largest entry of each shape, in the norm of the weights.

    The first of those that are nearly the largest: equal ones differ by round-off only.
    """
    size = np.abs(X) * np.sqrt(small.system.weights)[:, None]
    return np.asarray(np.argmax(size >= (1 - 1e-3) * np.max(size, axis=0), axis=0))


def noise_of(small: Linearised, z: Array, X: Array) -> Array:
    """Round-off in z: that of the terms of x^H F(z) x, over x^H F'(z) x."""
    X = X / np.sqrt(small.squares(X))
    size, noise = np.abs(z), floor(small, X)
    if small.D is None:
        return noise + size * EPS
    noise = noise + size * small.round_off(small.D, X) + size**2 * EPS
    slope = 2 * z + np.einsum("ij,ij->j", np.conj(X), small.times(small.D, X))
    return np.asarray(noise / np.maximum(np.abs(slope), np.sqrt(noise)))


def likely_error(small: Linearised, pairs: Eigenpairs, change: Array) -> Array:
    """Likely error of z: what the last sweep changed, and what another rounding of K does.

    The round-off of pairs is a bound, hundreds of times as much where many terms are summed.
    """
    pattern = small.system.pattern
    signs = 2.0 * np.random.default_rng(4).integers(0, 2, pattern.size) - 1.0
    other = EPS * small.times(signs * small.K, pairs.X)
    moved = np.abs(np.einsum("ij,ij->j", np.conj(pairs.X), other))
    if small.D is not None:
        slope = np.einsum("ij,ij->j", np.conj(pairs.X), small.times(small.D, pairs.X))
        moved = moved / np.maximum(np.abs(2 * pairs.z + slope), np.sqrt(moved) + _TINY)
    return np.asarray(np.maximum(change, _MARGIN * moved))
