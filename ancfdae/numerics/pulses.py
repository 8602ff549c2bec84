"""Fast features of functions of time that are sampled finely: pulses that steps may pass over.

A function is followed by n steps if straight lines between its values at n + 1 instants are within
a share of its range everywhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ancfdae.numerics.arrays import Array

# Intervals of the samples of a law, which takes arrays of instants.
SAMPLES = 2**14
# Numbers of steps, each a divisor of the samples, that may follow a function.
_STEPS = 8, 16, 32, 64, 128, 256, 512, 1024, 2048
# Distance from a straight line, over the range, that counts as followed, and that begins a feature.
_FOLLOWED, _BEGINS = 0.2, 0.02
# Features may take this share of the time; more are no pulses, but a motion that is fast throughout
# and that error control meets everywhere. Each gives as many stops.
_SHARE, _PARTS = 0.3, 8


class Pulses(NamedTuple):
    """Fewest steps that follow functions of time, and stops around their pulses, s."""

    steps: int
    stops: tuple[float, ...]


def find_pulses(t: Array, values: Array, least: int = _STEPS[0]) -> Pulses:
    """Judge functions of time, the columns of values at SAMPLES + 1 or fewer equidistant times.

    Runs take `least` steps, one of `_STEPS`, whatever the functions are.
    """
    values = values[:, np.all(np.isfinite(values), axis=0)]
    ranges = np.ptp(values, axis=0)
    values = values[:, ranges > 1e-12 * np.max(np.abs(values), axis=0, initial=0.0)]
    if not values.size:
        return Pulses(0, ())
    values = values / np.ptp(values, axis=0)
    off = _off(values, least)
    if off.max() <= _FOLLOWED:
        return Pulses(0, ())
    steps = next(
        (n for n in _STEPS if n > least and _off(values, n).max() <= _FOLLOWED), _STEPS[-1]
    )
    # Lines of more steps leave the neighbourhood of a pulse.
    near = _off(values, max(steps // 4, least))
    return Pulses(steps, _stops(t, near > _BEGINS))


def _off(values: Array, steps: int) -> Array:
    """Return the largest distance of the columns from straight lines at every instant."""
    each = (len(values) - 1) // steps
    known, share = values[::each], np.arange(each)[:, None, None] / each
    lines = (known[:-1] + share * np.diff(known, axis=0)).swapaxes(0, 1)
    gaps = np.abs(values[:-1].reshape(lines.shape) - lines).max(axis=2)
    return np.append(gaps.ravel(), 0.0)


def _stops(t: Array, inside: Array) -> tuple[float, ...]:
    """Return instants that part every feature; none where they take much of the time."""
    if inside.mean() > _SHARE:
        return ()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    stops = list[float]()
    for left, right in edges.reshape(-1, 2):
        ends = t[max(left - 1, 0)], t[min(right, len(t) - 1)]
        stops += np.linspace(*ends, _PARTS + 1).tolist()
    return tuple(stops)
