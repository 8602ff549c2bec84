"""Error bars from runs of one method that get finer and finer.

d_k = x_k - x_(k-1) are the differences of the runs, in norms of a whole vector (a gradient), and
r_k the ratios of their steps. Where steps do not resolve the waves that an objective sees, an error
is of the size of the differences with no order to it: the phase of a wave is as good as random in
every run. Where they do, it is d/(r^p - 1) (docs/theory/13-errors.md). The factors were set on the
scenes of calibration (`validation/tolerance/scenes.py`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ancfdae.numerics.arrays import Array

# Error over the last difference, or over a quarter of the one before if that is more, where waves
# are not resolved; and where there is one difference only.
_UNRESOLVED, _ALONE = 3.0, 4.1
# Error over d/(r^p - 1) of a number extrapolated by it; where differences fall with the order, d is
# also what extrapolating changes from run to run.
_EXTRAPOLATED = 1.5
# The same of a method of high order, not extrapolated, which falls with less than its order at
# first, and of one seen to fall with it.
HIGH_GRANTED, _HIGH_SEEN = 7.75, 2.5
# Share of that which is left at least of a number whose order is seen: more than the first term of
# an expansion is not known.
_TRUSTED = 0.1
# How far the order seen may be from that of the method, for the differences to be its error.
_NEAR = 0.6
# Part of a difference that another may be off, beside what the order makes of it, to be close; and
# errors over what extrapolating changes from run to run.
_CLOSE, _CHANGED = 0.2, 2.0
# Error over the difference of runs whose tolerance is tightened.
_TIGHTENED = 1.5
# Least size of a component, over the root mean square of all; where phases are random, so is each.
_SHARE, _EVEN = 0.5, 1.0
# Share of the instants, to either side, of which the largest error counts.
_NEIGHBOURS = 16


#: Where the estimated errors of the derivatives of HHT-I3 fall at this order or more, all measured
#: bars held. It is 1.996 to 2.03 where steps resolve all waves, 1.9 at most where bars failed
#: (docs/reports/error-bars).
RESOLVED_ORDER = 1.95
#: Estimated errors of derivatives above this have no order: the phase of a wave is off by as much,
#: in rad, and differences of runs are small by chance.
ORDERLESS = 0.5


# Roache's factors of safety of the grid convergence index: order assumed, and observed in the runs.
_ASSUMED, _OBSERVED = 3.0, 1.25
# Observed orders that bars of single numbers believe: outside the next one is taken.
_LEAST_ORDER, _MOST_ORDER = 0.5, 2.0
#: Elements are of second order or better (docs/reports/elements).
MESH_ORDER = 2


class Estimate(NamedTuple):
    """A vector and bars of its components."""

    x: Array
    bar: Array


def remainder(difference: Array, ratio: Array | float, order: Array | float) -> Array:
    """Return the error of a run from its difference to one whose step is `ratio` times as long.

    It has the shape of the difference. Richardson's extrapolation adds it: an error C h^p changes
    by (ratio^p - 1) times itself.
    """
    return np.asarray(difference / (ratio**order - 1))


def observed_order(before: Array | float, after: Array | float, ratio: Array | float) -> Array:
    """Return the order at which errors or differences fell while steps became shorter by a ratio.

    It has their shape. It is infinite where the error vanished, nan where both did.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.log2(np.divide(before, after)) / np.log2(ratio))


def ratio(x: float, size: float) -> float:
    """Return an error relative to a size; infinite relative to nothing."""
    return x / size if size else (np.inf if x else 0.0)


def convergence_bars(differences: Array, order: int | None) -> tuple[Array, Array]:
    """Return bars of the finest of two or three runs, each number for itself, and observed orders.

    Rows are differences of successive runs at halved steps, or on halved meshes.
    """
    size = np.abs(differences)
    unknown = np.full(size.shape[1], np.nan)
    if order is None:
        return size[-1], unknown
    if len(size) == 1:
        return _ASSUMED * remainder(size[-1], 2.0, order), unknown
    orders = observed_order(size[0], size[1], 2.0)
    # Two differences of zero: nothing changes, and the bar is zero at any order.
    p = np.clip(np.nan_to_num(orders, nan=_MOST_ORDER), _LEAST_ORDER, _MOST_ORDER)
    # The last difference may be small by chance, where the error changes its sign.
    return _OBSERVED * remainder(np.maximum(size[1], size[0] / 2.0**order), 2.0, p), orders


def refined(
    runs: Sequence[Array],
    steps: Sequence[int],
    order: int,
    resolved: bool,
    along: bool = False,
    improved: bool = True,
) -> Estimate:
    """Judge runs of ever more steps, two at least; `resolved` says that waves are.

    With `along` a vector holds values at increasing instants. Where numbers are `improved`, bars
    are those of extrapolated ones, if the order is seen.
    """
    d, N = np.diff(runs, axis=0), np.array(steps, dtype=float)
    if not resolved:
        return Estimate(runs[-1], unresolved(d, along))
    ratios = N[1:] / N[:-1]
    powers, errors = ratios**order, remainder(d, ratios[:, None], order)
    size = spread(errors[-1], along)
    seen = len(d) > 1 and falls(np.linalg.norm(d[-2:], axis=1), N[-3:], order)
    if len(d) > 1:
        size = np.maximum(size, spread(errors[-2], along) / powers[-1])
    if order > 2:
        return Estimate(runs[-1], (_HIGH_SEEN if seen else HIGH_GRANTED) * size)
    better = np.array(runs[1:]) + errors
    if seen and improved:
        of_better = spread(better[-1] - better[-2], along) / (powers[-1] - 1)
        size = np.minimum(size, np.maximum(of_better, _TRUSTED * size))
    return Estimate(better[-1], _EXTRAPOLATED * size)


def closely(runs: Sequence[Array], steps: Sequence[int], order: int) -> bool:
    """Return whether the differences of three runs are, as vectors, what the order makes them."""
    first, second = np.diff(runs, axis=0)
    powers = np.array(steps, dtype=float) ** -order
    foreseen = second * (powers[0] - powers[1]) / (powers[1] - powers[2])
    return bool(np.linalg.norm(first - foreseen) <= _CLOSE * np.linalg.norm(first))


def improved(runs: Sequence[Array], steps: Sequence[int], order: int) -> Estimate:
    """Return the extrapolated number of three runs, and a bar of what extrapolating changes.

    What is left of waves changes it as much as they change a run.
    """
    ratios = np.array(steps[1:]) / np.array(steps[:-1])
    errors = remainder(np.diff(runs, axis=0), ratios[:, None], order)
    before, after = np.array(runs[1:]) + errors
    changed = np.maximum(spread(after - before), _TRUSTED * spread(errors[-1]))
    return Estimate(after, _CHANGED * changed)


def unresolved(differences: Array, along: bool = False) -> Array:
    """Return bars of a vector from the rows of differences of its runs, of which no order is known.

    A difference may be small by chance: that of a component beside those of the others, all of them
    beside what the order makes of the one before, where steps were halved.
    """
    last = spread(differences[-1], along, _EVEN)
    if len(differences) == 1:
        return _ALONE * last
    return _UNRESOLVED * np.maximum(last, spread(differences[-2], along, _EVEN) / 4)


def tightened(before: Array, after: Array, along: bool = False) -> Array:
    """Return error bars of `after`, by a method that resolves all waves.

    Its difference from `before`, a run at a looser tolerance, is about the error of `before`.
    """
    return _TIGHTENED * spread(after - before, along)


def falls(sizes: Array, steps: Sequence[int] | Array, order: int, faster: bool = False) -> bool:
    """Whether two differences of runs at three numbers of steps fall with the order, or faster."""
    if not np.all(sizes > 0):
        return False
    powers = np.array(steps, dtype=float)[:, None] ** -(order + np.array([-_NEAR, _NEAR]))
    least, most = (powers[0] - powers[1]) / (powers[1] - powers[2])
    return bool(least <= sizes[0] / sizes[1] <= (math.inf if faster else most))


def spread(d: Array, along: bool = False, least: float = _SHARE) -> Array:
    """Return sizes of components, none of which is small by chance.

    Errors over time are waves that grow or die out: those of values at increasing instants have the
    size of the largest nearby.
    """
    share = least * float(np.linalg.norm(d)) / math.sqrt(d.size)
    if along:
        wide = d.size // _NEIGHBOURS
        near = np.pad(np.abs(d), wide, mode="edge")
        return np.maximum(sliding_window_view(near, 2 * wide + 1).max(axis=1), share)
    return np.maximum(np.abs(d), share)
