"""Modes without damping, with sweeps of inverse iteration that give them all digits there are.

What is rigid, and which modes coincide, is decided by the round-off of x^T K x itself, so that
neither units nor stiff waves of the section matter.
"""

from __future__ import annotations

import warnings

import numpy as np

from ancfdae.errors.kinds import SingularMatrix, StabilityWarning
from ancfdae.modes import dense, sparse
from ancfdae.modes.counted import highest_of_all, lowest_of_all
from ancfdae.modes.eigenpairs import (
    Eigenpairs,
    finished,
    floor,
    half_gap,
    likely_error,
    noise_of,
    rigid_motions,
    with_zeros,
)
from ancfdae.modes.lanczos import lowest, ritz
from ancfdae.modes.linearised import EPS, ROUND_OFF, Linearised
from ancfdae.modes.precise import ALLOWED, NoModes, lost, precise_modes, refuse_lost
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.inertia import WEAK, WHOLE

_SWEEPS = 2
# F is factorised at this many times the distance between modes that coincide.
_ASIDE = 16.0


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
    beside = _beside_groups(small, z, X)
    for j in range(len(z)):
        for _ in range(_SWEEPS):
            try:
                x, (factors, exact) = X[:, j], small.factor_beside(z[j] + beside[j])
            except SingularMatrix:  # A double root with one shape, which `refuse_lost` names.
                break
            y = small.solve(factors, small.slope_times(z[j] + beside[j], x))
            if not np.any(y):  # A double root: F'(z) x vanishes.
                break
            along = np.conj(small.times(small.M, y))
            step = 0.0 if exact else (along @ x) / (along @ y) - beside[j]
            z[j], change[j] = z[j] - step, np.abs(step)
            X[:, j] = y / np.sqrt(np.real(along @ y))
    return z if small.D is None else _quotients(small, z, X), X, change


def _beside_groups(small: Linearised, z: Array, X: Array) -> Array:
    """Return how far from each z it is sharpened, shape (k,): zero for modes that stand alone.

    At z the nearest of several vibrations that coincide would take the place of all.
    """
    noise, beside = noise_of(small, z, X), np.zeros(len(z))
    half = half_gap(z, noise)
    for j in np.flatnonzero(z.imag) if small.D is not None else range(len(z)):
        apart = np.abs(z - z[j])
        same = apart <= half + half[j]
        if np.sum(same) > 1:
            beside[j] = _ASIDE * max(float(np.max(apart[same])), noise[j])
    return beside


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


# -- modes -------------------------------------------------------------------------------------


# Up to this many independent motions dense matrices are faster than ARPACK, and for the lowest
# modes faster than Lanczos's method with a count; damped motions have twice as many exponents, all
# of which dense methods find (docs/measurements.md, "Modes").
_DENSE, _DENSE_LOWEST, _DENSE_DAMPED = 300, 100, 120
# Up to this many they take over where Lanczos's method has not found all modes by the count: at
# once where there are up to _CHEAP times as many motions as modes are asked for.
_DENSE_MOST, _CHEAP = 3000, 12
_UNCOUNTED = (
    "modes: more modes lie below the last one than were found, or round-off hides their number. "
    "Ask for another number of modes, or use fewer elements."
)
# ARPACK needs room for its basis.
_ROOM = 40
# Part of the next value that one counts as freed by a load at.
_FREED = 1e-3


def undamped(small: Linearised, count: int, highest: bool, asked: int | None = None) -> Eigenpairs:
    """Return the lowest z = -s^2, or the highest, and their shapes.

    The first that are `asked` for, by default all, and those that coincide with them have all their
    digits. NoModes if one of them could be off by more than a part of 2e-6.
    """
    if not small.symmetric:
        return _asymmetric(small, count, highest)
    found = _found(small, count, asked or count, highest)
    z, X, change = found if highest else with_zeros(small, *found)
    order = np.argsort(-z if highest else z, kind="stable")
    pairs = finished(small, z[order], X[:, order])
    left = likely_error(small, pairs, change[order])
    missing = lost(pairs.z, left)
    if highest or not (len(missing) or _mixed(small, pairs)):
        return pairs
    try:
        z, X, noise = precise_modes(small, pairs.X)
        # Before round-off is named zero: the rigid motions are, and no other is one of them.
        refuse_lost(small, z, noise)
        precise = _sorted(finished(small, z, X, noise))
    except NoModes:
        if _freed(pairs.z, left, missing):
            return pairs
        raise
    return precise


def _found(small: Linearised, count: int, asked: int, highest: bool) -> tuple[Array, Array, Array]:
    """Return values, shapes and changes by Lanczos's method with a count, or by dense matrices.

    NoModes of large systems where the count shows that modes lack, or round-off hides it.
    """
    large = not is_small(small, count)
    found = None
    if highest and large:
        found = highest_of_all(small, count, asked)
    elif not highest and small.n_free > max(_DENSE_LOWEST, 3 * count + _ROOM):
        found = lowest(small, count, asked)
        if found is None and large and small.n_free > min(_CHEAP * count, _DENSE_MOST):
            found = lowest_of_all(small, count, asked)
    if found is not None:
        return found
    if small.n_free > _DENSE_MOST:
        raise NoModes(_UNCOUNTED)
    z, X = dense.undamped(small, count, highest)
    return (z, X, np.zeros(len(z))) if highest else sharpened(small, z, X)


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
    """Return modes where loads turn with the motion: growing ones first, of all up to WHOLE."""
    rigid = rigid_motions(small)
    if small.n_free <= WHOLE:
        z, error, X = dense.asymmetric(small, rigid)
    else:
        z, X = sparse.undamped(small, count, highest, rigid)
        error = np.full(len(z), EPS)
        warn_of_part()
    noise = ROUND_OFF * np.sqrt(error) * np.abs(z)
    order = np.argsort(-z.real, kind="stable") if highest else _first(z, noise)
    z, X, change = with_rigid(rigid, *each_sharpened(small, z[order[:count]], X[:, order[:count]]))
    pairs = finished(small, z, X)
    order = np.argsort(-z.real, kind="stable") if highest else _first(pairs.z, 0.0)
    order = order[:count]
    pairs = Eigenpairs(pairs.z[order], pairs.X[:, order], pairs.noise[order])
    refuse_lost(small, pairs.z, likely_error(small, pairs, change[order]))
    return pairs


def warn_of_part() -> None:
    """Warn of a large system whose motions have not all been searched for growing ones."""
    warnings.warn(
        "modes: motions may grow, and only those next to zero were searched for it, since there "
        f"are more than {WHOLE:,}. Use fewer elements, or look at parts of the scene alone.",
        StabilityWarning,
        stacklevel=2,
    )


def _first(z: Array, noise: Array | float) -> Array:
    """Return the order, (k,), of z = -s^2: growing motions, fastest first, others, decaying ones.

    Up to the noise z is real, or zero. Each kind goes by size. Vibrations that grow by less than
    WEAK of their frequency stand among vibrations: waves of single elements may.
    """
    s = np.sqrt(-z.astype(complex))
    s = np.where(s.imag < 0, -s, s)
    turns = np.abs(z.imag) > np.maximum(noise, 2.0 * WEAK * np.abs(z))
    growing, decaying = turns & (s.real > 0), turns & (s.real < 0)
    growing |= ~turns & (z.real < -np.asarray(noise))
    kind = np.where(growing, 0, np.where(decaying, 2, 1))
    return np.lexsort((np.where(growing, -np.abs(s.real), np.abs(s)), kind))


def with_rigid(rigid: Array, z: Array, X: Array, change: Array) -> tuple[Array, Array, Array]:
    """Return values, shapes and changes of values, rigid motions first."""
    none = np.zeros(rigid.shape[1])
    return np.append(none, z), np.hstack([rigid, X]), np.append(none, change)


def _freed(z: Array, noise: Array, missing: Array) -> bool:
    """Whether a load is so near its critical value that the `missing` modes vanish in round-off.

    Next to a critical load z passes through zero. Neighbouring z of beams without a load differ by
    a factor of 40 at most.
    """
    others = np.setdiff1d(np.flatnonzero(z != 0), missing)
    least = np.min(np.abs(z[others]), initial=np.inf)
    if not np.isfinite(least):
        return False
    small = np.abs(z[missing]) < _FREED * least
    return bool(np.all(small & (noise[missing] <= ALLOWED * least)))


def is_small(small: Linearised, count: int) -> bool:
    """Whether `count` modes are found faster with dense matrices."""
    size = _DENSE if small.D is None else _DENSE_DAMPED
    return small.n_free <= max(size, 3 * count + _ROOM)
