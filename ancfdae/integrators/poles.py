"""Steps that pass over a pole of M, Q or Phi_q (docs/theory/16-formulas.md).

A formula is infinite where one of its divisors vanishes, as 1/(1 - q) at q = 1. No motion leads
across a pole of order one or higher, but a step of finite length may. The divisors of formulas that
are recorded as operations (`MechanicalSystem.divisors`) are evaluated at the states of a run. In a
step over which one changes sign, or in which a square such as |r|^2 has its minimum, the place of
the zero is searched along the cubic through both ends. There

    |f(s + d) - f(s + D)| > 500 |f(s + D) - f(s + 100 D)|,    D = 1e-3,  d = 1e-6,

with s the time as a fraction of the step. Multiplied by 1e3 is the left side of a pole of order
one, by 1e-2 the right side of a smooth function, so that quotients whose numerator vanishes too,
and poles of lower order, which a motion can cross, do not count. Round-off of a numerator that
vanishes with its slope, as of (1 - cos y)/y^2, looks like a pole at d, but not closer to s, where
the numerator is zero.
"""

import numpy as np

from ancfdae.equations import MechanicalSystem
from ancfdae.integrators.recorder import Rows
from ancfdae.kernels import norm
from ancfdae.numerics.arrays import Array

# Distances from a zero, as fractions of the step, at which values are compared, least ratio of
# their differences at a pole, and round-off of values, relative to them. At the first distance a
# pole is _ABOVE times the value at a thousandth of the step.
_NEAR, _GROWTH, _ROUND_OFF, _ABOVE = (1e-9, 1e-6, 1e-3, 1e-1), 500.0, 1e-10, 10.0
# Largest value at the vertex of a parabola that may be zero, over the smaller and over the larger
# value at the ends of a step, and distance of the vertex from the middle, over half the step.
_DIP, _DEEP, _BESIDE = 0.5, 0.02, 1.5
# A divisor counts as zero below this fraction of its larger value at the ends; before, it must fall
# in proportion to the distance of neighbouring points, times _SLOW.
_ZERO, _SLOW = 1e-13, 8.0
# A step that moves coordinates by less than this part of their size is looked at on a longer path.
_SEEN = 1e-7
# Parts into which the interval of a zero is divided, and number of divisions.
_PARTS, _DIVISIONS = 128, 6


def passed_pole(system: MechanicalSystem, rows: Rows) -> tuple[int, str] | None:
    """Return the first step between `rows` that passes over a pole, and a message; or None."""
    if len(rows.t) < 2:
        return None
    rows, found = Rows(rows.t, rows.q.real, rows.v.real), list[tuple[int, str]]()
    at_ends, within = (system.divisors(*x) for x in (rows, _middles(rows)))
    for owner, x in at_ends.items():
        for k, which in np.argwhere(_may_vanish(x[:-1], within[owner], x[1:])).tolist():
            step = _widened(system, Rows(*(each[k : k + 2] for each in rows)))
            place = _zero(system, step, owner, which)
            if place is not None and _infinite(system, step, place):
                found.append((k, _words(step, owner, place)))
                break
    return min(found, default=None)


def _middles(rows: Rows) -> Rows:
    """Return the middles of the cubics through the ends of all steps between rows."""
    (t, q, v), (dt, _, dv) = (
        [(x[1:] + x[:-1]) / 2 for x in rows],
        [np.diff(x, axis=0) for x in rows],
    )
    return Rows(t, q - dt[:, None] * dv / 8, v)


def _may_vanish(begin: Array, middle: Array, end: Array) -> Array:
    """Return whether divisors may vanish between the ends of steps, shape (k, n).

    They change sign, or the parabola through the three values has a vertex in the step or near it
    that is far below the values at the ends.
    """
    sign = np.sign(begin)
    x, y, z = sign * begin, sign * middle, sign * end
    slope, bend = z - x, 2 * (x + z - 2 * y)
    with np.errstate(all="ignore"):
        vertex = np.where(np.abs(slope) < _BESIDE * bend, y - slope**2 / (4 * bend), np.inf)
    low = np.maximum(_DIP * np.minimum(x, z), _DEEP * np.maximum(x, z))
    return np.asarray((np.minimum(y, z) < 0) | (np.minimum(y, vertex) <= low))


def _zero(system: MechanicalSystem, step: Rows, owner: str, which: int) -> float | None:
    """Return the fraction of a step at which a divisor vanishes on the cubic, or None."""
    low, high, size, allowed = 0.0, 1.0, 0.0, 1.0
    for _ in range(_DIVISIONS):
        s = np.linspace(low, high, _PARTS + 1)
        x = system.divisors(*_path(step, s))[owner][:, which]
        size = max(size, abs(x[0]), abs(x[-1]))
        changes = np.flatnonzero(np.sign(x[:-1]) * np.sign(x[1:]) < 0)
        k = int(np.argmin(np.abs(x)))
        first, last = (changes[0], changes[0] + 1) if len(changes) else (k - 1, k + 1)
        low, high, allowed = float(s[max(first, 0)]), float(s[min(last, _PARTS)]), allowed / _PARTS
        if not len(changes) and abs(x[k]) > _SLOW * max(allowed, _ZERO) * size:
            return None
    return (low + high) / 2


def _widened(system: MechanicalSystem, step: Rows) -> Rows:
    """Return a step in which coordinates move by more than their last digits: itself, or a longer.

    The longer one leads straight through the middle of a step so short that round-off hides the
    pole, as steps under error control become beside one.
    """
    w, middle = system.weights, Rows(*(each.mean(axis=0) for each in step))
    size, speed = norm(middle.q, w), norm(middle.v, w)
    if norm(step.q[1] - step.q[0], w) > _SEEN * size or not speed:
        return step
    half = _SEEN * size / speed * np.array([-1.0, 1.0])
    return Rows(middle.t + half, middle.q + half[:, None] * middle.v, np.tile(middle.v, (2, 1)))


def _path(step: Rows, s: Array) -> Rows:
    """Return states on the cubic of a step at fractions s of it; velocities are interpolated."""
    t, _, v = step
    times = t[0] + s * (t[1] - t[0])
    return Rows(times, step.cubic(times), v[0] + s[:, None] * (v[1] - v[0]))


def _infinite(system: MechanicalSystem, step: Rows, place: float) -> bool:
    """Return whether M, Q or Phi_q has a pole of order one or more at a fraction of a step."""
    for side in (-1.0, 1.0):
        for x in _values(system, _path(step, place + side * np.array(_NEAR))):
            _, rise, before = np.linalg.norm(np.diff(x, axis=0), axis=1)
            nearest, _, size, _ = np.linalg.norm(x, axis=1)
            high = rise > _GROWTH * max(before, _ROUND_OFF * size)
            if high and not nearest <= _ABOVE * size:
                return True
    return False


def _values(system: MechanicalSystem, rows: Rows) -> tuple[Array, ...]:
    """Return Q, M and Phi_q in k states, in units of the weights of coordinates, (k, n) each."""
    w, M, B = np.sqrt(system.weights), system.pattern, system.constraint_pattern
    states = list(zip(rows.t.tolist(), rows.q, rows.v, strict=True))
    return (
        np.array([system.force(*x) for x in states]) / w,
        np.array([system.mass(q) for _, q, _ in states]) / (w[M.rows] * w[M.columns]),
        np.array([system.constraint_q(t, q) for t, q, _ in states]) / w[B.columns],
    )


def _words(step: Rows, owner: str, place: float) -> str:
    begin, end = step.t.tolist()
    return (
        f"In the step from t = {begin:.6g} to {end:.6g} a divisor in {owner} vanishes, at about t "
        f"= {begin + place * (end - begin):.6g}; its formula is infinite there, and no motion "
        "leads across. Choose a smaller t_end, or a formula that is finite there."
    )
