"""Modes without damping, improved to full accuracy by inverse iteration.

The round-off of x^T K x itself decides which motions are rigid and which modes coincide, so neither
units nor stiff waves of the cross-section matter.

Modes of large symmetric pencils, from the lowest or the highest on, with a proof by counting.

Growing motions have z = -s^2 < 0, and may lie far below all slow vibrations: a column beyond its
critical load next to a strip of rubber. K - z M has a negative eigenvalue for each mode below z
(Sylvester). Counts at z that decrease by a factor, down to one below which there are no modes, show
how many growing motions each interval has. Lanczos's method with a shift at its lower end finds
these, one interval after the other from the lowest on, and then the other modes with a shift of
their own magnitude. Modes already found are deflated from the following Krylov spaces, so that each
space finds one copy or more of coinciding modes; it is repeated until the count agrees.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from ancfdae.errors.kinds import SingularMatrix, StabilityWarning
from ancfdae.modes import dense, sparse
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
from ancfdae.modes.lanczos import BETWEEN, NEAR_ZERO, Count, Lanczos, lowest, ritz
from ancfdae.modes.linearised import EPS, ROUND_OFF, Linearised
from ancfdae.modes.precise import ALLOWED, NoModes, lost, precise_modes, refuse_lost
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.inertia import WEAK, WHOLE

_SWEEPS = 2
# Distance of the shift from coinciding modes, over the distance between these.
_ASIDE = 16.0


def sharpened(small: Linearised, z: Array, X: Array) -> tuple[Array, Array, Array]:
    """Return modes of a symmetric pencil after inverse iteration on all shapes, and errors of z.

    From the change d of z in the last sweep the remaining error is d rho^2 / (1 - rho^2) or less,
    as components of shapes outside the block decrease by rho = (z - shift) / (top - shift) or more,
    where top is the largest z in the block. Far from zero a shift changes nothing, and proves
    nothing.

    Dense eigenvalues have the round-off of the largest one, in a thin beam far above the lowest;
    Ritz values have the round-off of the largest value in the block, which would hide a rigid
    motion.
    """
    change = np.full(len(z), np.inf)
    for _ in range(_SWEEPS):
        noise = float(np.max(small.round_off(small.K, X)))
        # A shift below all z, with the largest |z| as its magnitude, more if round-off requires it.
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
    """Return 1 - rho^2 of a sweep for each z, shape (k,); 1 where rho is unknown."""
    top = np.max(z)
    rho = (z - shift) / (top - shift)
    same = top - z <= ALLOWED * np.abs(top)
    return np.where(same | complete, 1.0, 1 - rho**2)


def each_sharpened(small: Linearised, z: Array, X: Array) -> tuple[Array, Array, Array]:
    """Return modes after inverse iteration F(z) y = F'(z) x on each shape, and last changes of z.

    F(z + dz) y = F'(z) (x + dz y) to first order: dz makes the component of this along y vanish.
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
    """Return the distance from each z to the shift of its iteration, shape (k,).

    Zero for modes that coincide with no other. At z of coinciding vibrations the nearest mode would
    displace the others.
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
    """Return the root of x^H (s^2 M + s D + K) x + 2 Re mu^H Phi_q x = 0 next to s, shape (k,).

    This Rayleigh quotient is stationary in x and mu: a violation of the constraints, left by
    solving next to an eigenvalue, has a second-order effect. With K symmetric and D gyroscopic the
    root is imaginary to round-off of the products, so that a steady mode does not appear to grow.
    """
    assert small.D is not None
    m = small.squares(X)
    d, k = (np.einsum("ij,ij->j", np.conj(X), small.times(A, X)) for A in (small.D, small.K))
    violation = small.system.constraint_pattern.dot(small.Phi_q, X)
    k = k + 2 * np.real(np.einsum("ij,ij->j", np.conj(small.multipliers(s, X)), violation))
    half = d / (2 * m)
    root = np.sqrt(half**2 - k / m)
    # The root of larger magnitude has no cancellation; the product of the two roots is k / m.
    far = -half - np.where(np.real(np.conj(half) * root) >= 0, root, -root)
    ends = far, k / m / np.where(far == 0, 1.0, far)
    return np.asarray(np.where(np.abs(ends[0] - s) <= np.abs(ends[1] - s), *ends))


# -- modes -------------------------------------------------------------------------------------


# Up to this many independent motions dense matrices are faster than ARPACK, and for the lowest
# modes faster than Lanczos's method with a count; damped motions have twice as many exponents, all
# of which dense methods find (docs/measurements.md, "Modes").
_DENSE, _DENSE_LOWEST, _DENSE_DAMPED = 300, 100, 120
# Largest number of motions for which dense matrices replace Lanczos's method where the count shows
# that it missed modes, and as a multiple of the modes asked for the number up to which they do so
# at once.
_DENSE_MOST, _CHEAP = 3000, 12
_UNCOUNTED = (
    "modes: more modes lie below the last one than were found, or round-off hides their number. "
    "Ask for another number of modes, or use fewer elements."
)
# ARPACK needs room for its basis.
_ROOM = 40
# Largest |z|, relative to the next one, of a mode whose stiffness a load counts as having removed.
_FREED = 1e-3


def undamped(small: Linearised, count: int, highest: bool, asked: int | None = None) -> Eigenpairs:
    """Return the lowest z = -s^2, or the highest, and their shapes.

    The first `asked` modes, by default all, and modes that coincide with them have full accuracy.
    NoModes if one of them may have a relative error above 2e-6.
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
        # Before round-off is set to zero: rigid motions have z = 0, and no other mode is rigid.
        refuse_lost(small, z, noise)
        precise = _sorted(finished(small, z, X, noise))
    except NoModes:
        if _freed(pairs.z, left, missing):
            return pairs
        raise
    return precise


def _found(small: Linearised, count: int, asked: int, highest: bool) -> tuple[Array, Array, Array]:
    """Return z, shapes and changes of z by Lanczos's method with a count, or by dense matrices.

    NoModes for large systems where the count shows that modes are missing, or round-off hides it.
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
    """Whether modes with z = 0 may be, or contain, modes that are not rigid.

    `separated` leaves in rigid motions a component (sigma / z)^3 of a shape with eigenvalue z,
    which adds its square times z to theirs; and all shapes with z below sigma count as zero.
    """
    zero = pairs.z == 0
    if not np.any(zero):
        return False
    sigma = ROUND_OFF * float(np.max(floor(small, pairs.X[:, zero])))
    least = np.min(np.abs(pairs.z[~zero]), initial=np.inf)
    return bool(sigma > ALLOWED ** (1 / 6) * least)


def _sorted(pairs: Eigenpairs) -> Eigenpairs:
    """Return pairs by increasing z, some of which may since have been set to zero."""
    order = np.argsort(pairs.z, kind="stable")
    return Eigenpairs(pairs.z[order], pairs.X[:, order], pairs.noise[order])


def _asymmetric(small: Linearised, count: int, highest: bool) -> Eigenpairs:
    """Return modes for asymmetric K: growing ones first, of all motions up to WHOLE of them."""
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
    """Warn that not all motions of a large system were searched for growing ones."""
    warnings.warn(
        "modes: motions may grow, and only those next to zero were searched for it, since there "
        f"are more than {WHOLE:,}. Use fewer elements, or look at parts of the scene alone.",
        StabilityWarning,
        stacklevel=2,
    )


def _first(z: Array, noise: Array | float) -> Array:
    """Return the order, (k,), of z = -s^2: growing motions, fastest first, others, decaying ones.

    A z within `noise` of real, or of zero, counts as real, or zero. Each kind is sorted by |s|.
    Vibrations that grow by less than WEAK of their frequency are ranked as vibrations: waves of
    single elements may grow so.
    """
    s = np.sqrt(-z.astype(complex))
    s = np.where(s.imag < 0, -s, s)
    turns = np.abs(z.imag) > np.maximum(noise, 2.0 * WEAK * np.abs(z))
    growing, decaying = turns & (s.real > 0), turns & (s.real < 0)
    growing |= ~turns & (z.real < -np.asarray(noise))
    kind = np.where(growing, 0, np.where(decaying, 2, 1))
    return np.lexsort((np.where(growing, -np.abs(s.real), np.abs(s)), kind))


def with_rigid(rigid: Array, z: Array, X: Array, change: Array) -> tuple[Array, Array, Array]:
    """Return z, shapes and changes of z with the rigid motions, of z = 0, placed first."""
    none = np.zeros(rigid.shape[1])
    return np.append(none, z), np.hstack([rigid, X]), np.append(none, change)


def _freed(z: Array, noise: Array, missing: Array) -> bool:
    """Whether a load is so near its critical value that z of the `missing` modes is round-off.

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
    """Whether dense matrices find `count` modes faster than iterative methods do."""
    size = _DENSE if small.D is None else _DENSE_DAMPED
    return small.n_free <= max(size, 3 * count + _ROOM)


# Shift over the largest value searched; growth factor of intervals; largest |z| over the largest
# entry of K; and largest number of Krylov spaces for one interval.
_BELOW, _FACTOR, _FAR, _SPACES = 1.5, 4.0, 1e4, 100


@final
@dataclass(frozen=True)
class _Found:
    """Values and shapes, orthonormal in M, found so far; -z in place of z for the highest."""

    small: Linearised
    z: Array
    X: Array

    def extended(self, shift: float | None, count: int) -> tuple[_Found, float] | None:
        """Return the modes with `count` more next to a shift, and the next value, or None."""
        count = min(count, self.small.n_free - len(self.z))
        if count <= 0:
            return None
        space = Lanczos(self.small, shift, count, self.X)
        if not space.converge(count):
            return None
        z = space.z if shift is not None else -space.z
        X = space.X
        # A space of all remaining motions has no next value.
        beyond = float(z[count]) if len(z) > count else np.inf
        found = np.append(self.z, z[:count]), np.hstack([self.X, X])
        order = np.argsort(found[0], kind="stable")
        return _Found(self.small, found[0][order], found[1][:, order]), beyond

    def with_rigid(self, R: Array) -> _Found:
        """Return the modes with the rigid motions R, orthonormal in M, added."""
        z = np.einsum("ij,ij->j", R, self.small.times(self.small.K, R))
        return _Found(self.small, np.append(self.z, z), np.hstack([self.X, R]))

    def below(self, cut: float) -> int:
        """Return the number of values below `cut`."""
        return int(np.sum(self.z < cut))


def lowest_of_all(small: Linearised, count: int, asked: int) -> tuple[Array, Array, Array] | None:
    """Return the lowest z = -s^2 of symmetric K, increasing, with shapes and errors of z.

    None unless counts prove that none of the first `asked` is missing, nor any that coincides with
    them. Rigid motions are returned all together, with the next mode.
    """
    try:
        top, rigid = _sizes(small, count)
        least = rigid.shape[1] + 2
        if least > count:
            count, asked = least, least - 1
        grown = _growing(small, -top, count)
        if grown is None:
            return None
        found, cut = grown
        if len(found.z) < count:
            found = found.with_rigid(rigid)
            completed = _completed(found, -top, count, asked)
            if completed is None:
                return None
            found = completed
        return _as_pairs(found, cut)
    except SingularMatrix:
        return None


def highest_of_all(small: Linearised, count: int, asked: int) -> tuple[Array, Array, Array] | None:
    """Return the highest z of symmetric K, decreasing, shapes, and zero errors.

    None as in `lowest_of_all`.
    """
    found = _completed(_none(small), None, count, asked)
    if found is None:
        return None
    return -found.z, found.X, np.zeros(len(found.z))


def _none(small: Linearised) -> _Found:
    return _Found(small, np.zeros(0), np.zeros((small.system.n_q, 0)))


def _sizes(small: Linearised, count: int) -> tuple[float, Array]:
    """Return the distance below zero of a shift for the lowest modes, and the rigid motions."""
    space = Lanczos(small, -NEAR_ZERO * small.size, count)
    space.converge(0)
    z, X = space.z[:count], space.X
    soft = np.abs(z) <= NEAR_ZERO * small.size
    R = rigid_motions(small) if np.any(soft) else X[:, :0]
    if R.size:
        # In one space with motions without stiffness the other modes have few digits.
        few = max(count - R.shape[1], 2)
        space = Lanczos(small, -NEAR_ZERO * small.size, few, R)
        space.converge(0)
        z = space.z[:few]
        X = np.hstack([X, R])
    noise = float(np.max(floor(small, X)))
    return max(_BELOW * float(np.max(np.abs(z))), noise / EPS**0.5), R


def _growing(small: Linearised, start: float, count: int) -> tuple[_Found, float] | None:
    """Return all modes below a negative start, or at least the first `count` of them, and a cut.

    All modes below the cut are known. None if counts cannot confirm this.
    """
    found, cuts = _none(small), [start]
    counts = [Count(small, start)]
    while counts[-1].number:
        cuts.append(_FACTOR * cuts[-1])
        if abs(cuts[-1]) > _FAR * small.size:
            return None
        counts.append(Count(small, cuts[-1]))
    cut = cuts[-1]
    for j in range(len(cuts) - 2, -1, -1):
        if len(found.z) >= count:
            break
        cut = cuts[j]
        for _ in range(_SPACES):
            lacking = counts[j].number - found.below(cut)
            if lacking <= 0:
                break
            more = found.extended(cuts[j + 1], lacking)
            if more is None:
                return None
            found = more[0]
        distance = float(np.min(np.abs(found.z - cut), initial=abs(cut)))
        if found.below(cut) != counts[j].number or not counts[j].is_certain(found.X, distance):
            return None
    below = found.z < cut
    return replace(found, z=found.z[below], X=found.X[:, below]), cut


def _completed(found: _Found, shift: float | None, count: int, asked: int) -> _Found | None:
    """Return at least `count` modes next to a shift, with those found, confirmed by a count."""
    lacking, beyond = count - len(found.z), np.inf
    for _ in range(_SPACES):
        more = found.extended(shift, lacking)
        if more is None:
            return None
        found, beyond = more[0], min(beyond, more[1])
        if len(found.z) == found.small.n_free:
            return found
        # The widest gap after the requested modes: a group of coinciding modes is not cut.
        ends = np.append(found.z[found.z < beyond], beyond)[asked - 1 :]
        if len(ends) < 2:
            return None
        size = np.abs(ends[1:]) + EPS**0.5 * abs(shift or 0.0)
        widest = int(np.argmax(np.diff(ends) / size))
        cut = ends[widest] + BETWEEN * (ends[widest + 1] - ends[widest])
        counted = Count(found.small, cut if shift is not None else -cut, shift is None)
        known = found.below(cut)
        if counted.is_certain(found.X[:, :known], cut - ends[widest]):
            lacking = counted.number - known
            if not lacking:
                return found
        elif counted.fails:
            return None
        else:  # All known modes coincide: the end of the group is searched.
            lacking = max(lacking, count)
    return None


def _as_pairs(found: _Found, cut: float) -> tuple[Array, Array, Array] | None:
    """Return z, shapes and changes of z by Ritz's method, separate for z below and above a cut."""
    parts = []
    for side in (found.z < cut, found.z >= cut):
        if np.any(side):
            better = ritz(found.small, found.X[:, side])
            if better is None:
                return None
            parts.append((*better, np.abs(better[0] - found.z[side])))
    z, X, change = (np.concatenate([part[k] for part in parts], axis=-1) for k in range(3))
    return z, X, change
