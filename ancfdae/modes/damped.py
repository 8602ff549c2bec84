"""Modes with damping.

**Damping proportional to stiffness**, D = tau K, as for one material free of stress, does not
change the shapes. A natural frequency omega, z = omega^2, has the exponents

    s^2 + tau z s + z = 0

If tau omega > 2 both are real: one near -1/tau, where the exponents of all stiff motions cluster,
and one near -tau omega^2. No method that starts from the matrices of s separates the exponents near
-1/tau; the natural frequencies do.

**Completeness.** Whether all exponents within a circle about zero have been found is proved by
counting them. By the argument principle det F(s), on the motions that joints leave free, turns N/2
times about zero along the upper half of the circle |s| = r, from r to -r, if N roots lie within:
roots come in conjugate pairs. Divided by the polynomial of the roots that were found,

    q(s) = det F(s) / prod (s - s_j)

turns (N - N_found)/2 times. If all are found q varies little, and a few points of the circle are
enough. Their distances grow by a factor: between equidistant points each interval could hide whole
turns.

Real roots near -1 over a retardation time are too many to be found one by one in large systems. If
M, D and K are symmetric F(s) gains or loses a negative eigenvalue at a real root, and Sylvester's
law of inertia counts negative eigenvalues: between two real s there are at least as many roots as
these counts differ by.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import scipy

from ancfdae.modes import dense, sparse
from ancfdae.modes.eigenpairs import (
    Eigenpairs,
    coincident,
    finished,
    half_gap,
    likely_error,
    noise_of,
    rigid_motions,
    undamped_part,
)
from ancfdae.modes.lanczos import Count
from ancfdae.modes.linearised import EPS, ROUND_OFF, Linearised
from ancfdae.modes.precise import ALLOWED, NoModes, refuse_lost
from ancfdae.modes.undamped import (
    each_sharpened,
    is_small,
    undamped,
    warn_of_part,
    with_rigid,
)
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.inertia import WHOLE, ConstrainedMatrix


def retardation_time(small: Linearised) -> float | None:
    """Return tau, s, with D = tau K to round-off of their entries, or None."""
    if small.D is None or not small.symmetric:
        return None
    pattern, root = small.system.pattern, np.sqrt(small.system.weights)
    sizes = root[pattern.rows] * root[pattern.columns]
    K, D = small.K / sizes, small.D / sizes
    squares = float(K @ K)
    if not squares:
        return None
    tau = float(K @ D) / squares
    left = float(np.max(np.abs(D - tau * K)))
    return tau if left <= ROUND_OFF * EPS * float(np.max(np.abs(D))) else None


def proportional_exponents(tau: float, z: Array, noise: Array) -> tuple[Array, Array, Array]:
    """Return the exponents s for D = tau K, their round-off, and the index of the shape of each.

    z = omega^2 with its round-off, shapes (n,). A rigid motion has s = 0 once; a vibration has the
    exponent with Im s > 0; real exponents come in pairs.
    """
    half, moves = 0.5 * tau * z, z != 0
    left = half**2 - z
    vibrates = left < 0
    root = np.sqrt(np.abs(left))
    # The larger of two real exponents has no cancellation, and their product is z.
    far = -half - np.copysign(root, half)
    near = z / np.where(far == 0, 1.0, far)
    first = np.where(vibrates, -half + 1j * root, near)
    creeps = np.flatnonzero(~vibrates & moves)
    number = np.concatenate([np.arange(len(z)), creeps])
    s = np.concatenate([first, far[creeps]])
    z, noise = z[number], noise[number]
    # ds = -(tau s + 1) dz / (2 s + tau z), and tau s + 1 = -s^2 / z; next to a double root ds is
    # the square root of the change (tau s + 1) dz.
    moved = np.abs(s) ** 2 / np.where(z == 0, 1.0, np.abs(z)) * noise
    slope = np.maximum(np.abs(2 * s + tau * z), np.sqrt(moved))
    return s, moved / np.where(slope == 0, 1.0, slope) + EPS * np.abs(s), number


# -- completeness ------------------------------------------------------------------------------


# Growth factor of the initial intervals of the half circle, and the largest number of intervals.
_GROWTH, _MOST = 1.5, 400
# Largest change of log q over an interval that is not halved.
_STEP = 1.0
# The circle passes through the widest gap of |s| up to _BEYOND times the last one, at most _BESIDE
# times |s| at the start of the gap: beyond it exponents may be unknown.
_BEYOND, _BESIDE = 1.2, 1.05
# Real s at which negative eigenvalues are counted: _PER_DECADE per decade, over _DECADES up to _FAR
# times the radius; and number of bisections of intervals with several roots.
_PER_DECADE, _DECADES, _FAR, _REFINED = 6, 7, 100.0, 4
# An eigenvalue counts as negative if it is below minus this times the diagonal.
_NEGATIVE = 1e-12


def all_found(small: Linearised, s: Array, n_zero: int, last: float) -> bool:
    """Return whether s, with Im s >= 0, has all vibrating roots with |s| up to `last`.

    `n_zero` further roots are zero. False, too, if round-off hides the answer.
    """
    r = _between(np.abs(s), last)
    real, pairs = s[s.imag == 0].real, s[s.imag > 0]
    if small.symmetric:
        counted = _real_roots(small, r * _FAR)
        real = counted if len(counted) > len(real) else real
    return _encloses(small, np.concatenate([np.zeros(n_zero), pairs, pairs.conj(), real]), r)


def none_vibrates_beyond(small: Linearised, s: Array, n_zero: int) -> bool:
    """Return whether exponents s contain all vibrations of a symmetric system.

    A count shows that all further exponents are real.
    """
    if not small.symmetric:
        return False
    assert small.D is not None
    real = len(_real_roots(small, _FAR * (small.largest(small.D) + small.size**0.5)))
    return 2 * small.n_free <= n_zero + 2 * int(np.sum(s.imag > 0)) + real


def _between(sizes: Array, last: float) -> float:
    """Return a radius just beyond `last`, in the widest gap of |s| next to it."""
    top = _BEYOND * last
    ends = np.sort(np.concatenate([[last, top], sizes[(sizes > last) & (sizes < top)]]))
    widest = int(np.argmax(ends[1:] / ends[:-1]))
    return float(ends[widest] * min(np.sqrt(ends[widest + 1] / ends[widest]), _BESIDE))


def _encloses(small: Linearised, roots: Array, r: float) -> bool:
    """Whether the circle |s| = r about zero encloses no roots of det F(s) but the given ones."""

    def log_q(angle: float) -> complex:
        s = r * np.exp(1j * angle)
        value = _measured(small, s).log_determinant()
        known = complex(np.sum(np.log((s - roots) / r)))
        return complex(np.nan, np.nan) if value is None else value - known

    lengths = _GROWTH ** np.arange(np.ceil(np.log(4 * small.n_free + 1) / np.log(_GROWTH)) + 1)
    angles = np.pi * np.append(0.0, np.cumsum(lengths) / np.sum(lengths))
    points = [(angle, log_q(angle)) for angle in angles]
    parts, turned, left = list(itertools.pairwise(points)), 0.0, _MOST
    while parts:
        begin, end = parts.pop()
        change = end[1] - begin[1]
        turn = float(np.angle(np.exp(1j * change.imag)))
        if abs(complex(change.real, turn)) <= _STEP:
            turned += turn
            continue
        left -= 1
        if not left or not np.isfinite(change):
            return False
        middle = 0.5 * (begin[0] + end[0])
        between = middle, log_q(middle)
        parts += [(begin, between), (between, end)]
    return round(turned / np.pi) == 0


def _real_roots(small: Linearised, far: float) -> Array:
    """Return rough values of real roots s in (-far, 0); 1/s. There are at least as many roots.

    Intervals with several roots are bisected a few times: the roots that cluster next to -1 over a
    retardation time stay in one interval.
    """

    def counted(sizes: Iterable[float]) -> list[tuple[float, int]]:
        """Return pairs of |s| and the number of negative eigenvalues; without uncertain counts."""
        counts = [(size, _measured(small, -size).below(_NEGATIVE)) for size in sizes]
        return [(size, count) for size, count in counts if count is not None]

    points = counted(far * np.logspace(-_DECADES, 0.0, _PER_DECADE * _DECADES + 1))
    for _ in range(_REFINED):
        crowded = [(a, b) for a, b in itertools.pairwise(points) if abs(a[1] - b[1]) > 1]
        points = sorted(points + counted((a[0] * b[0]) ** 0.5 for a, b in crowded))
    sizes, counts = (
        (np.array(x) for x in zip(*points, strict=True)) if points else (np.zeros(1),) * 2
    )
    return -np.repeat(np.sqrt(sizes[1:] * sizes[:-1]), np.abs(np.diff(counts)).astype(int))


def _measured(small: Linearised, s: complex) -> ConstrainedMatrix:
    """Return F(s), scaled by the diagonal of |s|^2 M + |s| |D| + |K|."""
    assert small.D is not None
    diagonal = small.system.pattern.diagonal
    M, D, K = (np.abs(x[diagonal]) for x in (small.M, small.D, small.K))
    size = abs(s)
    pattern = small.saddle.constrained
    return pattern.scaled(small.matrix(s), small.Phi_q, size**2 * M + size * D + K)


# -- modes -------------------------------------------------------------------------------------


# Largest number of independent motions for which dense matrices (half a minute) replace Arnoldi's
# method where it fails or may have missed a vibration.
_DENSE_CROWDED = 1500
# Arnoldi's method computes _MORE pairs more than requested, times the next number of _TIMES where
# pairs may be missing.
_MORE, _TIMES = 2, (1, 2, 4, 8, 16)
# Largest relative change of a vibration's exponent by inverse iteration; a larger change means that
# the iteration converged to another mode.
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
    """Return the first exponents s with Im s >= 0, or those farthest from zero, and their shapes.

    Raises NoModes if an exponent may have a relative error above 2e-6, or if a vibration below the
    last one may be missing.
    """
    tau = retardation_time(small)
    if tau is not None:
        pairs = _in_proportion(small, tau, count, highest)
        if np.all(_disproportion(small, tau, pairs) <= ALLOWED * np.abs(pairs.z)):
            return pairs
    rigid = rigid_motions(small)
    grows = not (highest or is_small(small, count)) and _may_grow(small)
    if not (is_small(small, count) or (grows and small.n_free <= WHOLE)):
        try:
            few = _of_large(small, count, highest, rigid)
        except scipy.sparse.linalg.ArpackError:
            if small.n_free > _DENSE_CROWDED:
                raise
            few = None
        if few is not None:
            if grows:
                warn_of_part()
            return few
        if small.n_free > _DENSE_CROWDED:
            raise _missing(small)
    s, X = dense.damped(small, rigid, _size(small, highest))
    if highest:
        return _highest(small, count, s, X)
    lowest = _lowest(small, count, rigid, s, X)
    if lowest is None or not _has_all_that_vibrate(small, 0, rigid, s, lowest):
        raise _missing(small)
    return lowest


def _may_grow(small: Linearised) -> bool:
    """Whether motions may grow; none does where K and the dissipation are positive definite."""
    assert small.D is not None
    if not small.is_symmetric(small.K):
        return True
    least, shifted = ROUND_OFF * EPS, small.D.copy()
    shifted[small.system.pattern.diagonal] += least * small.largest(small.D) * small.system.weights
    feeds = small.saddle.constrained.scaled(shifted, small.Phi_q, small.system.weights).negative()
    return feeds[0] > 0 or Count(small, -least * small.size).number > 0


def _missing(small: Linearised) -> NoModes:
    """Return the error for vibrations that may be missing; a gyroscopic D lets no motion creep."""
    assert small.D is not None
    gyroscopic = small.is_symmetric(small.D, sign=-1.0)
    return NoModes(_CROWDED if gyroscopic else small.words(_HIDDEN, _CROWDED))


def _of_large(small: Linearised, count: int, highest: bool, rigid: Array) -> Eigenpairs | None:
    """Return modes of a large system by Arnoldi's method; None if vibrations may be missing.

    Arnoldi's method finds the exponents nearest to a real shift, not those of least |s|, and fails
    where too many cluster next to -1 over a retardation time.
    """
    more = count + (0 if highest else rigid.shape[1])
    around = undamped(replace(small, D=None), more, highest)
    size = float(np.sqrt(np.max(np.abs(around.z))))
    if highest:
        return _highest(small, count, *sparse.damped(small, count, size, highest, rigid))
    # Dense matrices are faster than the largest numbers of vectors.
    for times in _TIMES if small.n_free > _DENSE_CROWDED else _TIMES[:3]:
        wanted = times * (count + _MORE)
        if wanted >= small.n_free:
            break
        try:
            s, X = sparse.damped(small, wanted, size, highest, rigid)
        except scipy.sparse.linalg.ArpackError:
            # More vectors separate exponents that coincide.
            continue
        pairs = _lowest(small, count, rigid, s, X)
        if pairs is not None and _has_all_that_vibrate(small, count, rigid, s, pairs):
            return pairs
    return None


def _size(small: Linearised, highest: bool) -> float:
    """Return the magnitude of s, in 1/s, at which dense matrices give most digits."""
    still = replace(small, D=None)
    z = np.abs(dense.undamped(still, small.n_free, highest)[0])
    largest = float(np.max(z))
    if highest:
        assert small.D is not None
        return max(largest**0.5, small.largest(small.D))
    moves = z[z > ROUND_OFF * EPS * largest]
    return float(np.min(moves, initial=largest)) ** 0.5 or 1.0


def _highest(small: Linearised, count: int, s: Array, X: Array) -> Eigenpairs:
    """Return the exponents farthest from zero with shapes, after inverse iteration."""
    order = np.argsort(-np.abs(s), kind="stable")[:count]
    return _checked(small, *each_sharpened(small, s[order], X[:, order]))


def _lowest(small: Linearised, count: int, rigid: Array, s: Array, X: Array) -> Eigenpairs | None:
    """Return the first modes, rigid ones too, after inverse iteration, or None.

    None if a vibration changed so much that it became another one.
    """
    order = _ranked(s, noise_of(small, s, X))[:count]
    # Before inverse iteration some modes grow by round-off and would displace vibrations.
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
    """Return normalised modes; raises NoModes if round-off changes one by too much."""
    pairs = finished(small, s, X)
    left = np.maximum(likely_error(small, pairs, change), _unsolved(small, pairs))
    refuse_lost(small, pairs.z, left)
    return pairs


def _has_all_that_vibrate(
    small: Linearised, count: int, rigid: Array, s: Array, pairs: Eigenpairs
) -> bool:
    """Whether the modes `pairs` contain all vibrations below the last one, proved by a count.

    The modes come from some of the exponents s by inverse iteration. If one of the first `count`
    modes only decays, all vibrations of the system must have been found.
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
    """Whether vibrations with coinciding exponents have linearly independent shapes."""
    for group in coincident(pairs):
        X = pairs.X[:, group]
        if len(group) > 1 and np.any(pairs.z[group].imag):
            gram = np.conj(X.T) @ small.times(small.M, X)
            if np.linalg.eigvalsh(gram)[0] < EPS**0.5:
                return False
    return True


def _in_proportion(small: Linearised, tau: float, count: int, highest: bool) -> Eigenpairs:
    """Return modes where D = tau K, from the undamped modes, so exact to their digits.

    The farthest exponents s belong to the highest natural frequencies omega, the first ones to the
    lowest and, where motions are overdamped, to the highest too: a vibration has |s| = omega; of
    two real exponents the one near -1/tau decreases in size with omega, the one near -tau omega^2
    increases.
    """
    still, n = replace(small, D=None), small.n_free
    ends = [] if highest else [undamped(still, min(count, n), False)]
    known = len(ends[0].z) if ends else 0
    if highest or (known < n and np.any(tau**2 * ends[0].z >= 4.0)):
        ends.append(undamped(still, min(count, n - known), True))
    z, noise = (np.concatenate([getattr(x, name) for x in ends]) for name in ("z", "noise"))
    s, noise, number = proportional_exponents(tau, z, noise)
    X = np.hstack([x.X for x in ends])[:, number].astype(complex)
    order = np.argsort(-np.abs(s), kind="stable") if highest else _ranked(s, noise)
    order = order[:count]
    return finished(small, s[order], X[:, order], noise[order])


def _disproportion(small: Linearised, tau: float, pairs: Eigenpairs) -> Array:
    """Return a bound of the error of each exponent from assuming D = tau K, (count,); 1/s.

    Beside stiff motions a dashpot on a soft one may pass for round-off of the matrices. The bound
    is infinite for rigid motions that damping slows down.
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
    """Return a bound of the error of each exponent from the residual of its mode, (count,); 1/s.

    r = F(s) x + Phi_q^T mu is measured in A = |s|^2 M + |s| D + K. Where M, D and K are positive
    definite, e with e^2 = r^H A^-1 r / x^H A x is the smallest change of the matrices, relative to
    the work of each term in any motion, for which s and x are exact. It changes s by e x^H A x /
    |x^H F'(s) x|; where matrices are symmetric and no other exponent is near, by the square of that
    over the distance to the next exponent.
    """
    bound, half = np.zeros(len(pairs.z)), half_gap(pairs.z, pairs.noise)
    # Above the growth rates of all growing motions, at which A is singular.
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
    """Return the order of exponents: growing by growth rate, rigid, vibrating, decaying by |s|.

    A body with internal damping has as many real exponents next to -1 over its retardation time as
    motions that do not vibrate: placed first, they would hide the vibrations.
    """
    growing, vibrates = s.real > ROUND_OFF * noise, np.abs(s.imag) > half_gap(s, noise)
    kind = np.where(growing, 0, np.where(s == 0, 1, np.where(vibrates, 2, 3)))
    return np.lexsort((np.where(growing, -s.real, np.abs(s)), kind))
