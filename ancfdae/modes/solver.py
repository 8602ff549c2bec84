"""Eigenvalues of small motions: which method, how many, and how exactly.

What is rigid, and which modes coincide, is decided by the round-off of x^T K x itself, so that
neither units nor stiff waves of the section matter.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy

from ancfdae.errors import InvalidInput, SingularMatrix
from ancfdae.modes import dense, sparse
from ancfdae.modes.linearised import EPS, ROUND_OFF, Linearised
from ancfdae.modes.precise import ALLOWED, NoModes, lost, precise_modes, refuse_lost
from ancfdae.modes.rigid import floor, rigid_motions, with_zeros
from ancfdae.numerics.arrays import Array

# Up to this many independent motions dense matrices are faster; damped ones have twice as many
# exponents, all of which dense methods find (docs/measurements.md, section 12).
_DENSE, _DENSE_DAMPED = 300, 120
# ARPACK needs room for its basis.
_ROOM = 40
# Round-off may be so many times what another rounding changes.
_MARGIN, _TINY = 4.0, float(np.finfo(float).tiny)
_SWEEPS = 2


# Part of the next value that one counts as freed by a load at.
_FREED = 1e-3


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
    near = _near(pairs.z, pairs.noise)
    apart = np.abs(np.diff(pairs.z)) > near[:-1] + near[1:]
    ends = [0, *(np.flatnonzero(apart) + 1).tolist(), len(pairs.z)]
    return [list(range(*pair)) for pair in itertools.pairwise(ends) if pair[0] < pair[1]]


def _near(z: Array, noise: Array) -> Array:
    """Half the distance of neighbours that coincide."""
    return np.asarray(np.sqrt(noise * np.maximum(np.abs(z), noise)))


def solve(small: Linearised, count: int, highest: bool) -> Eigenpairs:
    """Return the lowest modes, growing ones first, or the highest, by falling frequency.

    A group of modes that coincide is not cut. InvalidInput if nothing can move, or a motion has no
    inertia; NoModes if ARPACK finds none.
    """
    asked, n = min(count, small.n_modes), small.n_modes
    if n <= 0:
        raise InvalidInput(
            "modes", "need a motion that the joints leave", "none", "Remove a joint."
        )
    wanted = min(asked + 2, n)
    while True:
        method = _undamped if small.D is None else _damped
        try:
            pairs = method(small, wanted, highest)
        except scipy.sparse.linalg.ArpackError as error:
            raise NoModes(f"{wanted} modes: {error}. Ask for another number.") from error
        first = pairs.first(asked)
        if len(first.z) < len(pairs.z) or wanted == n:
            return first
        wanted = min(2 * wanted, n)


def _undamped(small: Linearised, count: int, highest: bool) -> Eigenpairs:
    if not small.symmetric:
        return _asymmetric(small, count, highest)
    z, X = (dense if _is_small(small, count) else sparse).undamped(small, count, highest)
    change = np.zeros(len(z))
    if not highest:
        z, X, change = with_zeros(small, *_sharpened(small, z, X))
    order = np.argsort(-z if highest else z, kind="stable")
    pairs = _finished(small, z[order], X[:, order])
    left = _left(small, pairs, change[order])
    missing = lost(pairs.z, left)
    if highest or not (len(missing) or _mixed(small, pairs)):
        return pairs
    try:
        z, X, noise = precise_modes(small, pairs.X)
        # Before round-off is named zero: the rigid motions are, and no other is one of them.
        refuse_lost(small, z, noise)
        precise = _sorted(_finished(small, z, X, noise))
    except NoModes:
        if _freed(pairs.z, left, missing):
            return pairs
        raise
    return precise


def _mixed(small: Linearised, pairs: Eigenpairs) -> bool:
    """Whether modes with z = 0 may be, or contain, others that are not rigid.

    `separated` leaves them a part (sigma / z)^3 of a shape with z, which takes its square of z; and
    all shapes with z below sigma are zero to round-off.
    """
    zero = pairs.z == 0
    if not np.any(zero):
        return False
    sigma = ROUND_OFF * float(np.max(floor(small, pairs.X[:, zero])))
    least = np.min(np.abs(pairs.z[~zero]), initial=np.inf)
    return bool(sigma > ALLOWED ** (1 / 6) * least)


def _sorted(pairs: Eigenpairs) -> Eigenpairs:
    """By growing z, of which round-off may be named zero since they were found."""
    order = np.argsort(pairs.z, kind="stable")
    return Eigenpairs(pairs.z[order], pairs.X[:, order], pairs.noise[order])


def _asymmetric(small: Linearised, count: int, highest: bool) -> Eigenpairs:
    rigid = rigid_motions(small)
    if _is_small(small, count):
        z, X = dense.asymmetric(small, rigid)
    else:
        z, X = sparse.undamped(small, count, highest, rigid)
    order = np.lexsort((z.imag, -z.real if highest else z.real))[:count]
    z, X, change = _with_rigid(rigid, *_each_sharpened(small, z[order], X[:, order]))
    order = np.argsort(-z.real if highest else z.real, kind="stable")[:count]
    pairs = _finished(small, z[order], X[:, order])
    refuse_lost(small, pairs.z, _left(small, pairs, change[order]))
    return pairs


def _with_rigid(rigid: Array, z: Array, X: Array, change: Array) -> tuple[Array, Array, Array]:
    none = np.zeros(rigid.shape[1])
    return np.append(none, z), np.hstack([rigid, X]), np.append(none, change)


def _freed(z: Array, noise: Array, missing: Array) -> bool:
    """Whether a load has all but freed these motions, so that round-off counts beside the others.

    Next to a critical load z passes through zero. Of beams that carry none neighbours differ by a
    factor of 40 at most.
    """
    others = np.setdiff1d(np.flatnonzero(z != 0), missing)
    least = np.min(np.abs(z[others]), initial=np.inf)
    if not np.isfinite(least):
        return False
    small = np.abs(z[missing]) < _FREED * least
    return bool(np.all(small & (noise[missing] <= ALLOWED * least)))


def _damped(small: Linearised, count: int, highest: bool) -> Eigenpairs:
    rigid = rigid_motions(small)
    if _is_small(small, count):
        s, X = dense.damped(small, rigid)
    else:
        more = count + (0 if highest else rigid.shape[1])
        around = _undamped(replace(small, D=None), more, highest)
        size = float(np.sqrt(np.max(np.abs(around.z))))
        s, X = sparse.damped(small, count, size, highest, rigid)
    order = np.argsort(-np.abs(s), kind="stable") if highest else _ranked(small, s, X)
    order = order[:count]
    if not highest:
        # Before they are sharpened some grow by round-off, which would take the place of others.
        order = np.union1d(order, np.argsort(np.where(s.imag, np.abs(s), np.inf))[:count])
    s, X, change = _each_sharpened(small, s[order], X[:, order])
    if not highest:
        s, X, change = _with_rigid(rigid, s, X, change)
        order = _ranked(small, s, X)
        s, X, change = s[order], X[:, order], change[order]
    pairs = _finished(small, s, X)
    refuse_lost(small, pairs.z, _left(small, pairs, change))
    return pairs


def _left(small: Linearised, pairs: Eigenpairs, change: Array) -> Array:
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


def _is_small(small: Linearised, count: int) -> bool:
    size = _DENSE if small.D is None else _DENSE_DAMPED
    return small.n_free <= max(size, 3 * count + _ROOM)


def _ranked(small: Linearised, s: Array, X: Array) -> Array:
    """Return the order of exponents: growing ones, fastest first, rigid, vibrating, decaying ones.

    Each kind by size. A body with internal damping has as many real exponents next to -1 over its
    retardation time as motions that do not vibrate: in front they would hide those that do.
    """
    noise = _noise(small, s, X)
    growing, vibrates = s.real > ROUND_OFF * noise, np.abs(s.imag) > _near(s, noise)
    kind = np.where(growing, 0, np.where(s == 0, 1, np.where(vibrates, 2, 3)))
    return np.lexsort((np.where(growing, -s.real, np.abs(s)), kind))


def _sharpened(small: Linearised, z: Array, X: Array) -> tuple[Array, Array, Array]:
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
        Z = Z / np.sqrt(small.squares(Z))
        K, M = (Z.T @ small.times(values, Z) for values in (small.K, small.M))
        # LAPACK itself: `eigh` takes four times as long for a few shapes.
        _, W, failed = scipy.linalg.lapack.dsygv((K + K.T) / 2, (M + M.T) / 2)
        if failed:
            return z, X, change
        X = Z @ W
        last, z = z, np.einsum("ij,ij->j", X, small.times(small.K, X)) / small.squares(X)
        change = np.abs(z - last) / _falling(z, shift, len(z) == small.n_free)
    return z, X, change


def _falling(z: Array, shift: float, complete: bool) -> Array:
    """Return 1 - rho^2 of a sweep for each value; 1 for the largest, of which nothing is known."""
    top = np.max(z)
    rho = (z - shift) / (top - shift)
    same = top - z <= ALLOWED * np.abs(top)
    return np.where(same | complete, 1.0, 1 - rho**2)


def _each_sharpened(small: Linearised, z: Array, X: Array) -> tuple[Array, Array, Array]:
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

    Rayleigh's quotient, stationary in x and mu: what solves beside an eigenvalue leave in the
    constraints counts in second order. With K symmetric and D gyroscopic it is imaginary to
    round-off of the products, and what does not grow is not taken for what does.
    """
    assert small.D is not None
    m = small.squares(X)
    d, k = (np.einsum("ij,ij->j", np.conj(X), small.times(A, X)) for A in (small.D, small.K))
    violation = small.system.constraint_pattern.dot(small.Phi_q, X)
    k = k + 2 * np.real(np.einsum("ij,ij->j", np.conj(small.multipliers(s, X)), violation))
    root = np.sqrt((d / (2 * m)) ** 2 - k / m)
    ends = -d / (2 * m) + root, -d / (2 * m) - root
    return np.asarray(np.where(np.abs(ends[0] - s) <= np.abs(ends[1] - s), *ends))


def _finished(small: Linearised, z: Array, X: Array, noise: Array | None = None) -> Eigenpairs:
    """Name zero what is zero to round-off; norm and sign of the shapes."""
    X = X / np.sqrt(small.squares(X))
    pivot = X[largest_entries(small, X), np.arange(X.shape[1])]
    X = X * (np.abs(pivot) / pivot)
    noise = _noise(small, z, X) if noise is None else noise
    if small.D is None:
        z = np.where(np.abs(z) <= ROUND_OFF * noise, 0.0, z)
        z = np.where(np.abs(z.imag) <= ROUND_OFF * noise, z.real, z)
    else:
        z = np.where(np.abs(z.real) <= ROUND_OFF * noise, 1j * z.imag, z)
        # A pair that coincides is a double real root: it creeps.
        z = np.where(np.abs(z.imag) <= _near(z, noise), z.real, z)
    return Eigenpairs(z, X, noise)


def largest_entries(small: Linearised, X: Array) -> Array:
    """Return the number of the largest entry of each shape, in the norm of the weights.

    The first of those that are nearly the largest: equal ones differ by round-off only.
    """
    size = np.abs(X) * np.sqrt(small.system.weights)[:, None]
    return np.asarray(np.argmax(size >= (1 - 1e-3) * np.max(size, axis=0), axis=0))


def _noise(small: Linearised, z: Array, X: Array) -> Array:
    """Round-off in z: that of the terms of x^H F(z) x, over x^H F'(z) x."""
    X = X / np.sqrt(small.squares(X))
    size, noise = np.abs(z), floor(small, X)
    if small.D is None:
        return noise + size * EPS
    noise = noise + size * small.round_off(small.D, X) + size**2 * EPS
    slope = 2 * z + np.einsum("ij,ij->j", np.conj(X), small.times(small.D, X))
    return np.asarray(noise / np.maximum(np.abs(slope), np.sqrt(noise)))
