"""First derivatives from real values alone: central differences, extrapolated (Ridders 1982).

Differences of steps h, h/c, h/c^2, ... have errors in even powers of h, which Neville's scheme
removes one by one. Truncation falls from row to row while round-off grows; the entry that changed
least against its neighbours is where they balance. With values good to eps it is good to about
1e-11, ten times better than a plain central difference at its best step.
"""

from collections.abc import Callable

import numpy as np

from ancfdae.numerics.arrays import Array

# Steps against arguments of the order of one.
_DIVISOR = 1.6
_STEPS = tuple(0.05 / _DIVISOR**k for k in range(6))


# Scales tried, in this order, and the change against the largest entry that is good enough.
_SCALES = tuple(4.0 ** (k * sign) for k in range(20) for sign in (1, -1)[: 1 + (k > 0)])
_GOOD = 1e-9
# Changes beyond this are round-off.
_RESOLVED = 1e-2


def real_derivative(f: Callable[[float], Array]) -> Array:
    """Return f'(0) of a function that varies over arguments of the order of one.

    Every entry of the array is extrapolated as long as that reduces its error.
    """
    return _extrapolated(f)[0]


def scaled_derivative(f: Callable[[float], Array]) -> Array:
    """Return f'(0) of a function that varies over arguments of any order, found by trial."""
    best, least, value = np.zeros(()), np.inf, np.max(np.abs(f(0.0)), initial=0.0)
    with np.errstate(all="ignore"):
        for scale in _SCALES:
            found, change = _extrapolated(lambda s, scale=scale: f(scale * s))  # type: ignore[misc]
            # Differences carry the round-off of values; where they drown in it nothing is known.
            error = np.max(change, initial=0.0) + np.finfo(float).eps * value
            size = np.max(np.abs(found), initial=0.0)
            if error < least * size:
                best, least = found / scale, error / size
            if least <= _GOOD:
                return best
    # Nothing but round-off at any scale is the derivative of a constant.
    return best if least < _RESOLVED else np.zeros_like(found)


def _extrapolated(f: Callable[[float], Array]) -> tuple[Array, Array]:
    """Return f'(0) and the last change of each entry."""
    before: list[Array] = []
    best, change = np.zeros(()), np.array(np.inf)
    for step in _STEPS:
        row = [(np.asarray(f(step)) - np.asarray(f(-step))) / (2 * step)]
        for k, old in enumerate(before):
            gain = _DIVISOR ** (2 * (k + 1))
            new = (gain * row[k] - old) / (gain - 1)
            moved = np.maximum(np.abs(new - row[k]), np.abs(new - old))
            best = np.where(moved < change, new, best)
            change = np.minimum(moved, change)
            row.append(new)
        before = row
    return best, change
