"""The first zero of a function between the time points of a run, from its values and rates.

Within a step the function is the cubic through values and rates at both ends. A step in which the
function changes its sign has a zero; so has one whose cubic reaches beyond zero and returns, which
values at its ends alone do not show.
"""

import math
from typing import NamedTuple

import numpy as np

from ancfdae.numerics.arrays import Array

# Fractions of a step within which a position counts as its end.
_END = 1e-9
# A rate at the start of a run counts as round-off below this fraction of the largest rate.
_ROUND_OFF = 1e-10


class Crossing(NamedTuple):
    """A zero of a function: its time, s, the sign before it, and a later time of the other sign.

    `after` is infinite if no time point shows the other sign.
    """

    time: float
    side: float
    after: float


def first_crossing(
    t: Array, g: Array, rate: Array, direction: int, side: float | None, noise: Array, gap: bool
) -> Crossing | None:
    """Return the first zero at which g crosses in a direction; None if there is no crossing.

    `side` is the sign of g just after the start if an event has just happened there: its value is
    then round-off. Otherwise a zero at the first time point is no crossing: g is then on the side
    to which it moves. Values up to `noise`, (k,), are round-off: zero at the first time point, and
    open everywhere if g is a gap.
    """
    at_zero = abs(g[0]) <= noise[0]
    if at_zero and abs(rate[0]) <= _ROUND_OFF * np.max(np.abs(rate)):
        rate = np.append(0.0, rate[1:])
    sides = _sides(g, rate, side, at_zero)
    if gap:
        sides[np.abs(g) <= noise] = 1.0
    changed = sides[:-1] != sides[1:]
    hidden = (sides[:-1] * rate[:-1] < 0) & (sides[1:] * rate[1:] > 0) & ~changed
    for n in np.flatnonzero(changed | hidden).tolist():
        found = _in_step(t[n : n + 2], g[n : n + 2], rate[n : n + 2], direction, sides[n])
        if found is None and changed[n] and direction in (0, -sides[n]):
            # A value that is round-off at the start, and moves on to the other side at once.
            found = float(t[n] if n == 0 and side is not None else t[n + 1])
        if found is not None:
            before = float(-direction or sides[n])
            return Crossing(found, before, float(t[n + 1]) if sides[n + 1] != before else math.inf)
    return None


def _sides(g: Array, rate: Array, side: float | None, at_zero: bool) -> Array:
    """Return the signs of g at the time points, (k,); at a zero the side to which it moves."""
    sides, moves = np.sign(g), np.sign(rate)
    if side is not None:
        sides[0] = side
    elif at_zero:
        # If the rate is zero, too, the next sign counts.
        sides[0] = moves[0] or next(iter(sides[1:][sides[1:] != 0]), 1.0)
    for n in np.flatnonzero(sides == 0).tolist():
        sides[n] = moves[n] or (sides[n - 1] if n else 1.0)
    return sides


def _in_step(t: Array, g: Array, rate: Array, direction: int, side: float) -> float | None:
    """Return the first zero of the cubic in a step, s, at which g leaves its side; None without."""
    h = float(t[1] - t[0])
    slopes = h * rate
    rise = g[1] - g[0]
    cubic = np.array(
        [slopes[0] + slopes[1] - 2 * rise, 3 * rise - 2 * slopes[0] - slopes[1], slopes[0], g[0]]
    )
    size = np.max(np.abs(cubic))
    if not size > 0:
        return None
    roots = np.roots(cubic / size)
    places = np.sort(roots[np.abs(roots.imag) <= _END].real)
    places = np.clip(places[(places >= -_END) & (places <= 1 + _END)], 0.0, 1.0)
    steepness = np.polyval(np.polyder(cubic), places)
    wanted = steepness * direction > 0 if direction else steepness != 0
    # If the function has two zeros in the step, it leaves its side at one of them only.
    wanted &= (steepness * side < 0) | (direction * side > 0)
    good = places[wanted]
    return float(t[0] + good[0] * h) if len(good) else None
