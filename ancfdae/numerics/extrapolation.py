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


def real_derivative(f: Callable[[float], Array]) -> Array:
    """Return f'(0) of a function that varies over arguments of the order of one.

    Every entry of the array is extrapolated as long as that reduces its error.
    """
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
    return best
