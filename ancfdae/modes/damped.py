"""Modes with damping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from ancfdae.modes import dense, proportional, sparse
from ancfdae.modes.linearised import EPS, ROUND_OFF, Linearised
from ancfdae.modes.pairs import Eigenpairs, finished, half_gap, likely_error, noise_of
from ancfdae.modes.precise import ALLOWED, refuse_lost
from ancfdae.modes.rigid import rigid_motions
from ancfdae.modes.sharpening import each_sharpened
from ancfdae.modes.undamped import is_small, undamped, with_rigid
from ancfdae.numerics.arrays import Array

# Up to this many independent motions dense matrices take over where Arnoldi's method fails; some
# seconds.
_DENSE_CROWDED = 400
_TINY = float(np.finfo(float).tiny)


def damped(small: Linearised, count: int, highest: bool) -> Eigenpairs:
    """Return the first exponents with Im s >= 0, or the farthest from zero, and their shapes.

    NoModes if one of them could be off by more than a part of 2e-6.
    """
    tau = proportional.retardation_time(small)
    if tau is not None:
        pairs = _in_proportion(small, tau, count, highest)
        if np.all(_disproportion(small, tau, pairs) <= ALLOWED * np.abs(pairs.z)):
            return pairs
    rigid = rigid_motions(small)
    s, X = _roots(small, count, highest, rigid)
    falling = np.argsort(-np.abs(s), kind="stable")
    order = (falling if highest else _ranked(s, noise_of(small, s, X)))[:count]
    if not highest:
        # Before they are sharpened some grow by round-off, which would take the place of others.
        order = np.union1d(order, np.argsort(np.where(s.imag, np.abs(s), np.inf))[:count])
    s, X, change = each_sharpened(small, s[order], X[:, order])
    if not highest:
        s, X, change = with_rigid(rigid, s, X, change)
        order = _ranked(s, noise_of(small, s, X))
        s, X, change = s[order], X[:, order], change[order]
    pairs = finished(small, s, X)
    left = np.maximum(likely_error(small, pairs, change), _unsolved(small, pairs))
    refuse_lost(small, pairs.z, left)
    return pairs


def _roots(small: Linearised, count: int, highest: bool, rigid: Array) -> tuple[Array, Array]:
    """Return exponents and shapes, to be sharpened, by the method that suits the size.

    Arnoldi's method does not part exponents that crowd next to -1 over a retardation time.
    """
    if is_small(small, count):
        return dense.damped(small, rigid)
    more = count + (0 if highest else rigid.shape[1])
    around = undamped(replace(small, D=None), more, highest)
    size = float(np.sqrt(np.max(np.abs(around.z))))
    try:
        return sparse.damped(small, count, size, highest, rigid)
    except scipy.sparse.linalg.ArpackError:
        if small.n_free > _DENSE_CROWDED:
            raise
        return dense.damped(small, rigid)


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
