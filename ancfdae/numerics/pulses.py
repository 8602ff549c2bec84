"""Pulses in functions of time that steps may pass over, found in fine samples.

n steps follow a function if straight lines between its values at n + 1 times deviate from it by
less than a fraction of its range everywhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ancfdae.numerics.arrays import Array

# Number of intervals between the samples of a law.
SAMPLES = 2**14
# Numbers of steps, each a divisor of the samples, that may follow a function.
_STEPS = 8, 16, 32, 64, 128, 256, 512, 1024, 2048
# Deviations from a straight line, over the range, up to which a function counts as followed, and
# above which a pulse begins.
_FOLLOWED, _BEGINS = 0.2, 0.02
# Pulses may take at most _SHARE of the time; otherwise the motion is fast throughout, and error
# control resolves it. Stops divide each pulse into _PARTS parts.
_SHARE, _PARTS = 0.3, 8


class Pulses(NamedTuple):
    """Least number of steps that follow functions of time, and stops around their pulses, s."""

    steps: int
    stops: tuple[float, ...]


def find_pulses(t: Array, values: Array, least: int = _STEPS[0]) -> Pulses:
    """Return the pulses of functions of time, the columns of `values` at equidistant times t, s.

    There are at most SAMPLES + 1 times. Runs take at least `least` steps, one of `_STEPS`, whatever
    the functions are.
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
    # With more steps the lines would follow the flanks of a pulse.
    near = _off(values, max(steps // 4, least))
    return Pulses(steps, _stops(t, near > _BEGINS))


def _off(values: Array, steps: int) -> Array:
    """Return how far the columns of `values` deviate from straight lines over `steps`, (n_t,)."""
    each = (len(values) - 1) // steps
    known, share = values[::each], np.arange(each)[:, None, None] / each
    lines = (known[:-1] + share * np.diff(known, axis=0)).swapaxes(0, 1)
    gaps = np.abs(values[:-1].reshape(lines.shape) - lines).max(axis=2)
    return np.append(gaps.ravel(), 0.0)


def _stops(t: Array, inside: Array) -> tuple[float, ...]:
    """Return times, s, that divide every pulse; none if pulses take much of the time."""
    if inside.mean() > _SHARE:
        return ()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    stops = list[float]()
    for left, right in edges.reshape(-1, 2):
        ends = t[max(left - 1, 0)], t[min(right, len(t) - 1)]
        stops += np.linspace(*ends, _PARTS + 1).tolist()
    return tuple(stops)
