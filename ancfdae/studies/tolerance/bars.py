"""Error bars from runs of one method that get finer and finer.

d_k = x_k - x_(k-1) are the differences of the runs, in norms of a whole vector (a gradient). Where
steps do not resolve the waves that an objective sees, an error is of the size of the differences
with no order to it: the phase of a wave is as good as random in every run. Where they do, errors
fall with an order that can be seen, and be used (docs/theory/13-errors.md). The factors are those
with which all resolved and 94 % of the unresolved bars hold on the scenes of `validation/tolerance/scenes.py`, calibration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ancfdae.numerics.arrays import Array

# Error over the last difference, or over half the one before if that is more: where waves are not
# resolved, and where they are, when nothing is known yet of the order but the last fall.
_UNRESOLVED, _FALLEN = 3.0, 2.0
# The same where there is one difference only.
_ALONE = 4.5
# How far the order seen may be from that of the method, for the differences to be its error.
_NEAR = 0.6
# Least fall of the differences of extrapolated numbers, whose order is one higher at least.
_FALL = 3.0
# Error over the last difference, of extrapolated numbers, of a method of high order, and of one
# whose tolerance is tightened: runs of a few steps hardly differ.
_EXTRAPOLATED, _HIGH, _TIGHTENED = 0.5, 0.25, 1.5
# Of a vector's bar, the least share that each component has.
_SHARE = 0.5


class Estimate(NamedTuple):
    """A vector, bars of its components, and whether the runs converge in order."""

    x: Array
    bar: Array
    converges: bool


def halved(runs: Sequence[Array], order: int, resolved: bool) -> Estimate:
    """Judge runs whose steps were halved, two at least; `resolved` says that waves are."""
    d = np.diff(runs, axis=0)
    sizes = np.linalg.norm(d, axis=1)
    last = _spread(d[-1])
    before = _spread(d[-2]) if len(d) > 1 else last
    if not (resolved and _falls(sizes[-2:], order)):
        return Estimate(runs[-1], unresolved(d), False)
    if order > 2:
        return Estimate(runs[-1], _HIGH * np.maximum(last, before / 2**order), True)
    if _falls(sizes[-3:], order, 3):
        better = np.array(runs[1:]) + d / (2**order - 1)
        d = np.diff(better, axis=0)
        if _FALL * np.linalg.norm(d[-1]) <= np.linalg.norm(d[-2]):
            bar = _EXTRAPOLATED * np.maximum(_spread(d[-1]), _spread(d[-2]) / 2 ** (order + 2))
            return Estimate(better[-1], bar, True)
    return Estimate(runs[-1], _FALLEN * np.maximum(last, before / 2**order), True)


def unresolved(differences: Array) -> Array:
    """Return bars of a vector from the rows of differences of its runs, of which no order is known.

    The last difference may be small by chance, so the one before counts too.
    """
    last = _spread(differences[-1])
    if len(differences) == 1:
        return _ALONE * last
    return _UNRESOLVED * np.maximum(last, _spread(differences[-2]) / 2)


def tightened(runs: Sequence[Array]) -> Estimate:
    """Judge runs at tolerances ever tighter of a method that resolves all waves, two at least.

    The difference is about the error of the last run but one.
    """
    return Estimate(runs[-1], _TIGHTENED * _spread(runs[-1] - runs[-2]), True)


def _falls(sizes: Array, order: int, count: int = 2) -> bool:
    """Whether differences fall with the order of the method."""
    if len(sizes) < count or not np.all(sizes > 0):
        return False
    orders = np.log2(sizes[:-1] / sizes[1:])
    return bool(np.all(np.abs(orders - order) <= _NEAR))


def _spread(d: Array) -> Array:
    """Return sizes of components, none of which is small by chance."""
    share = _SHARE * float(np.linalg.norm(d)) / math.sqrt(d.size)
    return np.maximum(np.abs(d), share)
