"""Error bars from a sequence of runs of one method with ever finer steps.

d_k = x_k - x_(k-1) are the differences of successive runs, in norms of a whole vector (a gradient),
and r_k the ratios of their steps. Where steps do not resolve the waves that an objective depends
on, the error is about as large as the differences and has no order: the phase of a wave is as good
as random in every run. Where steps resolve them, it is d/(r^p - 1) (docs/theory/13-errors.md). The
factors below were set on the scenes of calibration (`validation/tolerance/scenes.py`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ancfdae.numerics.arrays import Array

# Error bar over the last difference, or over a quarter of the one before if that is more, where
# waves are not resolved; and where there is one difference only.
_UNRESOLVED, _ALONE = 3.0, 4.1
# Error bar over d/(r^p - 1) of an extrapolated number; where differences fall with the order, d is
# the change of the extrapolated number from run to run if that is smaller.
_EXTRAPOLATED = 1.5
# Error bar over d/(r^p - 1) of a method of high order, not extrapolated, whose error falls with
# less than its order at first, and of one observed to fall with its order.
HIGH_GRANTED, _HIGH_SEEN = 7.75, 2.5
# Least factor by which an observed order reduces a bar: only the first term of the error expansion
# is known.
_TRUSTED = 0.1
# Largest difference of the observed order from the order of the method.
_NEAR = 0.6
# Largest relative deviation of a difference from its prediction by the order that counts as close;
# and error bar over the change of an extrapolated number from run to run.
_CLOSE, _CHANGED = 0.2, 2.0
# Error bar over the difference of two runs of which the second has a tighter tolerance.
_TIGHTENED = 1.5
# Least bar of a component over the root mean square of all; one where phases are random.
_SHARE, _EVEN = 0.5, 1.0
# A bar over time is the largest within 1/_NEIGHBOURS of the time points to either side.
_NEIGHBOURS = 16


#: Least order at which estimated errors of derivatives of HHT-I3 must fall for waves to count as
#: resolved; all measured bars then held. It is 1.996 to 2.03 where steps resolve all waves, 1.9 at
#: most where bars failed (docs/reports/error-bars).
RESOLVED_ORDER = 1.95
#: Estimated relative errors of derivatives above this have no order: the phase of a wave is wrong
#: by as many rad, and differences of runs are small by chance.
ORDERLESS = 0.5


# Roache's factors of safety of the grid convergence index: order assumed, and observed in the runs.
_ASSUMED, _OBSERVED = 3.0, 1.25
# Observed orders of single numbers are limited to this range.
_LEAST_ORDER, _MOST_ORDER = 0.5, 2.0
#: Order of the mesh error: elements are of second order or better (docs/reports/elements).
MESH_ORDER = 2


class Estimate(NamedTuple):
    """A vector x and error bars of its components, of the same shape."""

    x: Array
    bar: Array


def remainder(difference: Array, ratio: Array | float, order: Array | float) -> Array:
    """Return the error of a run from its difference to one whose step is `ratio` times as long.

    It has the shape of the difference. Richardson's extrapolation adds it: an error C h^p changes
    by (ratio^p - 1) times itself.
    """
    return np.asarray(difference / (ratio**order - 1))


def observed_order(before: Array | float, after: Array | float, ratio: Array | float) -> Array:
    """Return the order at which errors or differences fell while steps became shorter by `ratio`.

    It has the shape of `before`. It is infinite where the error vanished, NaN where both did.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.log2(np.divide(before, after)) / np.log2(ratio))


def ratio(x: float, size: float) -> float:
    """Return x / size; infinite for a size of zero unless x is zero, too."""
    return x / size if size else (np.inf if x else 0.0)


def convergence_bars(differences: Array, order: int | None) -> tuple[Array, Array]:
    """Return error bars of the finest of two or three runs, by component, and observed orders.

    Rows of `differences` are differences of successive runs at halved steps, or on halved meshes.
    If `order` is None, the bar is the last difference.
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
    """Return the estimate of a vector from two or more runs with ever more steps.

    `resolved` says that the steps resolve all waves, `along` that the vector holds values at
    increasing times. If `improved`, an observed order reduces the bars of the extrapolated vector.
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
    """Return whether the differences of three runs are in the ratio of the order, as vectors."""
    first, second = np.diff(runs, axis=0)
    powers = np.array(steps, dtype=float) ** -order
    foreseen = second * (powers[0] - powers[1]) / (powers[1] - powers[2])
    return bool(np.linalg.norm(first - foreseen) <= _CLOSE * np.linalg.norm(first))


def improved(runs: Sequence[Array], steps: Sequence[int], order: int) -> Estimate:
    """Return the extrapolated vector of three runs, with bars from the change of extrapolation.

    Unresolved waves change the extrapolated vector as much as they change a run.
    """
    ratios = np.array(steps[1:]) / np.array(steps[:-1])
    errors = remainder(np.diff(runs, axis=0), ratios[:, None], order)
    before, after = np.array(runs[1:]) + errors
    changed = np.maximum(spread(after - before), _TRUSTED * spread(errors[-1]))
    return Estimate(after, _CHANGED * changed)


def unresolved(differences: Array, along: bool = False) -> Array:
    """Return error bars of a vector, without an order, from the rows of differences of its runs.

    A difference may be small by chance: a component is therefore compared with the other
    components, and the last difference with a quarter of the one before, for halved steps.
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
    """Return whether two differences of runs at three numbers of steps fall with the order.

    If `faster`, they may also fall faster.
    """
    if not np.all(sizes > 0):
        return False
    powers = np.array(steps, dtype=float)[:, None] ** -(order + np.array([-_NEAR, _NEAR]))
    least, most = (powers[0] - powers[1]) / (powers[1] - powers[2])
    return bool(least <= sizes[0] / sizes[1] <= (math.inf if faster else most))


def spread(d: Array, along: bool = False, least: float = _SHARE) -> Array:
    """Return magnitudes of components of d, raised so that none is small by chance.

    With `along` d holds values at increasing times: its errors are waves that grow or die out, and
    each magnitude is the largest one nearby.
    """
    share = least * float(np.linalg.norm(d)) / math.sqrt(d.size)
    if along:
        wide = d.size // _NEIGHBOURS
        near = np.pad(np.abs(d), wide, mode="edge")
        return np.maximum(sliding_window_view(near, 2 * wide + 1).max(axis=1), share)
    return np.maximum(np.abs(d), share)
