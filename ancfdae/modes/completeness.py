"""Whether all exponents within a circle about zero have been found, by counting them.

By the argument principle det F(s), on the motions that joints leave, turns N/2 times about zero
along the upper half of the circle |s| = r, from r to -r, where N roots lie within: roots come in
conjugate pairs. Over the polynomial of the roots that were found,

    q(s) = det F(s) / prod (s - s_j)

turns (N - N_found)/2 times. Where all are found q varies little, and a few points of the circle
are enough. Their distances grow by a factor: of equal ones each could hide whole turns.

Real roots near -1 over a retardation time are too many to be found one by one in large systems.
Where M, D and K are symmetric F(s) gains or loses a negative eigenvalue at a real root, and
Sylvester's law of inertia counts negative eigenvalues: between two real s there are at least as
many roots as these counts differ by.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from ancfdae.modes.linearised import Linearised
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.inertia import ConstrainedMatrix

# Each part of the half circle at first, over the one before, and how many parts there may be.
_GROWTH, _MOST = 1.5, 400
# Change of log q over a part that is not halved.
_STEP = 1.0
# The circle passes through the widest gap of sizes up to _BEYOND times the last one, no more than
# _BESIDE times the size where the gap begins: beyond it not all may be known.
_BEYOND, _BESIDE = 1.2, 1.05
# Real s at which negative eigenvalues are counted: _PER_DECADE for a factor of ten, over _DECADES
# up to _FAR times the size of interest; and how often intervals with several roots are halved.
_PER_DECADE, _DECADES, _FAR, _REFINED = 6, 7, 100.0, 4
# An eigenvalue counts as negative below minus this, relative to the diagonal.
_NEGATIVE = 1e-12


def all_found(small: Linearised, s: Array, n_zero: int, last: float) -> bool:
    """Whether s, with Im s >= 0, has all roots of size up to `last` that vibrate.

    `n_zero` roots beside them are zero. False, too, where round-off hides it.
    """
    r = _between(np.abs(s), last)
    real, pairs = s[s.imag == 0].real, s[s.imag > 0]
    if small.symmetric:
        counted = _real_roots(small, r * _FAR)
        real = counted if len(counted) > len(real) else real
    return _encloses(small, np.concatenate([np.zeros(n_zero), pairs, pairs.conj(), real]), r)


def none_vibrates_beyond(small: Linearised, s: Array, n_zero: int) -> bool:
    """Whether s has all roots that vibrate, of a symmetric system: all others are real."""
    if not small.symmetric:
        return False
    assert small.D is not None
    real = len(_real_roots(small, _FAR * (small.largest(small.D) + small.size**0.5)))
    return 2 * small.n_free <= n_zero + 2 * int(np.sum(s.imag > 0)) + real


def _between(sizes: Array, last: float) -> float:
    """Return a radius just beyond `last`, in the widest gap of the sizes next to it."""
    top = _BEYOND * last
    ends = np.sort(np.concatenate([[last, top], sizes[(sizes > last) & (sizes < top)]]))
    widest = int(np.argmax(ends[1:] / ends[:-1]))
    return float(ends[widest] * min(np.sqrt(ends[widest + 1] / ends[widest]), _BESIDE))


def _encloses(small: Linearised, roots: Array, r: float) -> bool:
    """Whether as many roots lie within the circle as there are among those given."""

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
    """Return about where real roots lie in (-far, 0): no more than there are.

    Intervals with several roots are halved: those that crowd next to -1 over a retardation time
    stay together.
    """

    def counted(sizes: Iterable[float]) -> list[tuple[float, int]]:
        """Return sizes with numbers of negative eigenvalues, where round-off does not hide them."""
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
    """Return F(s), measured against the diagonal of |s|^2 M + |s| |D| + |K|."""
    assert small.D is not None
    diagonal = small.system.pattern.diagonal
    M, D, K = (np.abs(x[diagonal]) for x in (small.M, small.D, small.K))
    size = abs(s)
    pattern = small.saddle.constrained
    return pattern.scaled(small.matrix(s), small.Phi_q, size**2 * M + size * D + K)
