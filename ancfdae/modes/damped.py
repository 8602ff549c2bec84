"""Modes with damping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from ancfdae.modes import dense, proportional, sparse
from ancfdae.modes.completeness import all_found, none_vibrates_beyond
from ancfdae.modes.linearised import EPS, ROUND_OFF, Linearised
from ancfdae.modes.pairs import (
    Eigenpairs,
    coincident,
    finished,
    half_gap,
    likely_error,
    noise_of,
)
from ancfdae.modes.precise import ALLOWED, NoModes, refuse_lost
from ancfdae.modes.rigid import rigid_motions, undamped_part
from ancfdae.modes.sharpening import each_sharpened
from ancfdae.modes.undamped import is_small, undamped, with_rigid
from ancfdae.numerics.arrays import Array

# Up to this many independent motions dense matrices take over where Arnoldi's method fails or may
# have missed a vibration; some seconds.
_DENSE_CROWDED = 800
# Arnoldi's method looks for _MORE pairs than are asked for, and for that number times the next of
# _TIMES where some may be missing.
_MORE, _TIMES = 2, (1, 2, 4)
# Part of itself by which a vibration may move as it is sharpened; by more it became another one.
_MOVED = 1e-3
_HIDDEN = (
    "modes: lower vibrations than those found may be missing, among motions that creep. Shorten "
    "the retardation time of bodies that creep, use fewer elements, or pass damped=False."
)
_CROWDED = (
    "modes: lower vibrations than those found may be missing: exponents of the damped system "
    "coincide, or nearly so. Change the damping, the load or the design by more than a millionth "
    "of itself, ask for another number of modes, or pass damped=False."
)
_TINY = float(np.finfo(float).tiny)


def damped(small: Linearised, count: int, highest: bool) -> Eigenpairs:
    """Return the first exponents with Im s >= 0, or the farthest from zero, and their shapes.

    NoModes if one of them could be off by more than a part of 2e-6, or if a vibration below the
    last one may be missing.
    """
    tau = proportional.retardation_time(small)
    if tau is not None:
        pairs = _in_proportion(small, tau, count, highest)
        if np.all(_disproportion(small, tau, pairs) <= ALLOWED * np.abs(pairs.z)):
            return pairs
    rigid = rigid_motions(small)
    if not is_small(small, count):
        try:
            few = _of_large(small, count, highest, rigid)
        except scipy.sparse.linalg.ArpackError:
            if small.n_free > _DENSE_CROWDED:
                raise
            few = None
        if few is not None:
            return few
        if small.n_free > _DENSE_CROWDED:
            raise NoModes(small.words(_HIDDEN, _CROWDED))
    s, X = dense.damped(small, rigid, _size(small, highest))
    if highest:
        return _highest(small, count, s, X)
    lowest = _lowest(small, count, rigid, s, X)
    if lowest is None or not _has_all_that_vibrate(small, 0, rigid, s, lowest):
        raise NoModes(small.words(_HIDDEN, _CROWDED))
    return lowest


def _of_large(small: Linearised, count: int, highest: bool, rigid: Array) -> Eigenpairs | None:
    """Return modes by Arnoldi's method; None if vibrations may be missing.

    It finds exponents nearest to a real shift, not those of least |s|, and fails where too many
    crowd next to -1 over a retardation time.
    """
    more = count + (0 if highest else rigid.shape[1])
    around = undamped(replace(small, D=None), more, highest)
    size = float(np.sqrt(np.max(np.abs(around.z))))
    if highest:
        return _highest(small, count, *sparse.damped(small, count, size, highest, rigid))
    for times in _TIMES:
        try:
            s, X = sparse.damped(small, times * (count + _MORE), size, highest, rigid)
        except scipy.sparse.linalg.ArpackError:
            if times == 1:
                raise
            return None
        pairs = _lowest(small, count, rigid, s, X)
        if pairs is not None and _has_all_that_vibrate(small, count, rigid, s, pairs):
            return pairs
    return None


def _size(small: Linearised, highest: bool) -> float:
    """Return the size of the exponents that dense matrices are to give most digits; 1/s."""
    still = replace(small, D=None)
    z = np.abs(dense.undamped(still, small.n_free, highest)[0])
    largest = float(np.max(z))
    if highest:
        assert small.D is not None
        return max(largest**0.5, small.largest(small.D))
    moves = z[z > ROUND_OFF * EPS * largest]
    return float(np.min(moves, initial=largest)) ** 0.5 or 1.0


def _highest(small: Linearised, count: int, s: Array, X: Array) -> Eigenpairs:
    """Return the exponents farthest from zero, sharpened."""
    order = np.argsort(-np.abs(s), kind="stable")[:count]
    return _checked(small, *each_sharpened(small, s[order], X[:, order]))


def _lowest(small: Linearised, count: int, rigid: Array, s: Array, X: Array) -> Eigenpairs | None:
    """Return the first modes, sharpened, rigid ones too; None if a vibration became another one."""
    order = _ranked(s, noise_of(small, s, X))[:count]
    # Before they are sharpened some grow by round-off, which would take the place of others.
    lowest = np.argsort(np.where(s.imag, np.abs(s), np.inf))[: np.sum(s.imag > 0)]
    order = np.union1d(order, lowest[:count])
    sharp, X, change = each_sharpened(small, s[order], X[:, order])
    vibrates = s[order].imag > 0
    if np.any(vibrates & (np.abs(sharp - s[order]) > _MOVED * np.abs(sharp))):
        return None
    sharp, X, change = with_rigid(rigid, sharp, X, change)
    order = _ranked(sharp, noise_of(small, sharp, X))
    return _checked(small, sharp[order], X[:, order], change[order])


def _checked(small: Linearised, s: Array, X: Array, change: Array) -> Eigenpairs:
    """Return modes that round-off leaves as they are; NoModes if one is moved by too much."""
    pairs = finished(small, s, X)
    left = np.maximum(likely_error(small, pairs, change), _unsolved(small, pairs))
    refuse_lost(small, pairs.z, left)
    return pairs


def _has_all_that_vibrate(
    small: Linearised, count: int, rigid: Array, s: Array, pairs: Eigenpairs
) -> bool:
    """Whether modes have all vibrations below the last one, by a count of their own.

    The modes were sharpened from some of the exponents s. Where one of the first `count` modes only
    decays, no vibration at all may be missing.
    """
    vibrates = pairs.z.imag > 0
    n_zero = rigid.shape[1] + undamped_part(small, rigid).shape[1]
    decays = (pairs.z.imag == 0) & (pairs.z.real < 0)
    if np.any(decays[:count]) and not none_vibrates_beyond(small, s, n_zero):
        return False
    if not np.any(vibrates):
        return True
    last = float(np.max(np.abs(pairs.z[vibrates])))
    return _are_distinct(small, pairs) and all_found(small, s, n_zero, last)


def _are_distinct(small: Linearised, pairs: Eigenpairs) -> bool:
    """Whether vibrations that coincide have shapes that are independent."""
    for group in coincident(pairs):
        X = pairs.X[:, group]
        if len(group) > 1 and np.any(pairs.z[group].imag):
            gram = np.conj(X.T) @ small.times(small.M, X)
            if np.linalg.eigvalsh(gram)[0] < EPS**0.5:
                return False
    return True


def _in_proportion(small: Linearised, tau: float, count: int, highest: bool) -> Eigenpairs:
    """Return modes where D = tau K: of the undamped ones, and so exact to their digits.

    In either order they belong to as many of the lowest natural frequencies and of the highest: a
    vibration has |s| = omega; of real exponents the one near -1/tau falls with omega, and the other
    one grows.
    """
    still, n = replace(small, D=None), small.n_free
    ends = [] if highest else [undamped(still, min(count, n), False)]
    known = len(ends[0].z) if ends else 0
    if highest or (known < n and np.any(tau**2 * ends[0].z >= 4.0)):
        ends.append(undamped(still, min(count, n - known), True))
    z, noise = (np.concatenate([getattr(x, name) for x in ends]) for name in ("z", "noise"))
    s, noise, number = proportional.exponents(tau, z, noise)
    X = np.hstack([x.X for x in ends])[:, number].astype(complex)
    order = np.argsort(-np.abs(s), kind="stable") if highest else _ranked(s, noise)
    order = order[:count]
    return finished(small, s[order], X[:, order], noise[order])


def _disproportion(small: Linearised, tau: float, pairs: Eigenpairs) -> Array:
    """Return a bound of the error of each exponent, (count,), with what D - tau K adds to it.

    Beside stiff motions a dashpot on a soft one may pass for round-off of the matrices. Infinite
    for rigid motions that it slows down.
    """
    assert small.D is not None
    X, free = pairs.X, pairs.z == 0
    if np.any(free):
        left = np.linalg.norm(small.works(X[:, free].real, -tau, 1.0))
        if left > (ROUND_OFF * EPS) ** 2 * small.largest(small.D):
            return np.full(len(free), np.inf)
    added = np.einsum("ij,ij->j", np.conj(X), small.times(small.D - tau * small.K, X))
    slope = np.einsum("ij,ij->j", np.conj(X), small.times(small.D, X)) + 2 * pairs.z
    first = np.abs(pairs.z * added) / np.maximum(np.abs(slope), _TINY)
    return np.maximum(first, _unsolved(small, pairs))


def _unsolved(small: Linearised, pairs: Eigenpairs) -> Array:
    """Return a bound of the error of each exponent, (count,); 1/s, from residuals r of the modes.

    r = F(s) x + Phi_q^T mu is measured in A = |s|^2 M + |s| D + K: where M, D and K are positive
    definite, e with e^2 = r^H A^-1 r / x^H A x is the least change of the matrices, relative to
    the work of each term in any motion, with which s and x are exact. It moves s by
    e x^H A x / |x^H F'(s) x|; where matrices are symmetric and no other exponent is near, by the
    square of it over the distance of the next one.
    """
    bound, half = np.zeros(len(pairs.z)), half_gap(pairs.z, pairs.noise)
    # Beyond all that grows, where A is singular.
    least = 2.0 * float(np.max(pairs.z.real, initial=0.0))
    for j, (s, x) in enumerate(zip(pairs.z, pairs.X.T, strict=True)):
        if s == 0:
            continue
        A = small.matrix(max(abs(s), least)).real
        r = small.times(small.matrix(s), x)
        factors = small.saddle.factor(A, small.Phi_q)
        parts = np.stack([r.real, r.imag], axis=1)
        work = np.abs(np.sum(parts * small.solve(factors, parts)))
        whole = np.abs(np.vdot(x, small.times(A, x)))
        slope = np.abs(np.vdot(x, small.slope_times(s, x)))
        moved = np.sqrt(work * whole) / max(slope, _TINY)
        others = np.abs(pairs.z - s)
        gap = np.min(others[others > half + half[j]], initial=abs(s))
        bound[j] = moved * min(1.0, moved / gap) if small.symmetric else moved
    return bound


def _ranked(s: Array, noise: Array) -> Array:
    """Return the order of exponents: growing ones, fastest first, rigid, vibrating, decaying ones.

    Each kind by size. A body with internal damping has as many real exponents next to -1 over its
    retardation time as motions that do not vibrate: in front they would hide those that do.
    """
    growing, vibrates = s.real > ROUND_OFF * noise, np.abs(s.imag) > half_gap(s, noise)
    kind = np.where(growing, 0, np.where(s == 0, 1, np.where(vibrates, 2, 3)))
    return np.lexsort((np.where(growing, -s.real, np.abs(s)), kind))
