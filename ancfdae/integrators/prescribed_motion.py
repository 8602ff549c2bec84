"""Whether steps belong to the motion that joints prescribe (docs/theory/03-joints-and-loads.md).

Constraints have several solutions, and a long step can end at another one than the motion leads to.
The equation of a prescribed angle holds half a turn off as well: its root is checked at the start
(`refuse_opposite` of the assembly), and here after every step. Where constraints determine the
whole motion, n_lam = n_q, they may also close in another way (the crossed four-bar), or lock on the
way. Steps in which velocities change much are then followed in parts,

    Phi(t, q) = 0 from t_n to t_n+1 with q' = -Phi_q^-1 Phi_t as the guess.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy

from ancfdae.equations import MechanicalSystem
from ancfdae.equations.held import velocity_side
from ancfdae.kernels import finite, norm
from ancfdae.numerics.arrays import Array

# Largest turn in a step under error control, in rad: a step that long says little about a circle,
# and half a turn off is still three such steps away.
_TURN = 1.0
# Places in a step, as parts of it, at which the rate of the angle is looked at.
_PLACES = np.linspace(0.0, 1.0, 5)
# A step is followed if velocities change by more than this part of the sum of their sizes: a turn
# by 0.2 rad. On another branch velocities are others.
_CHANGE = 0.1
# A part of a step is taken if Newton's first correction is below this part of its length (then the
# second is below its square) and the ones after it shrink at least as fast; it is the shorter for
# not being taken, down to this share of the time to go.
_CURVED, _SHORTEST, _ITERATIONS = 0.1, 1e-9, 8
# Corrections below this part of the coordinates are round-off, or nothing.
_SMALL = 1e-11
# Places that differ by more than this part of the way are not the same.
_APART = 1e-3
_DENSE = 100


class Lost(NamedTuple):
    """The first of some instants at which a step ended elsewhere, and a remedy in words."""

    first: int
    remedy: str


class Rows(NamedTuple):
    """Instants, (k,), with coordinates and velocities, (k, n_q)."""

    t: Array
    q: Array
    v: Array


def lost(system: MechanicalSystem, rows: Rows, known: bool) -> Lost | None:
    """Check the steps between rows; at steps `known` before the run follow them, too.

    `first` counts from the second row. None if all are right.
    """
    t, q, _ = rows
    found = system.off_root(t[1:], q[1:])
    if found is not None:
        first, joint = found
        return Lost(first, _half_a_turn(system, joint, *t[first : first + 2].tolist()))
    if not known or system.n_lam != system.n_q or np.iscomplexobj(q):
        return None
    for k in _suspects(system, rows):
        reached, place = followed(system, float(t[k]), q[k], float(t[k + 1]))
        way = norm(q[k + 1] - q[k], system.weights)
        apart = max(_APART * way, 10 * _SMALL * norm(q[k], system.weights))
        if reached < t[k + 1]:
            return Lost(k, f"{locks(reached)} The step to t = {t[k + 1]:.6g} passed over it.")
        if norm(place - q[k + 1], system.weights) > apart:
            remedy = "they close in more than one way, and its step is too long to tell. Take steps"
            return Lost(k, f"At t = {t[k + 1]:.6g} {remedy} of {(t[k + 1] - t[k]) / 4:.2g} s.")
    return None


def locks(t: float) -> str:
    """Return in words that joints lock."""
    return f"The joints lock at t = {t:.6g}: from there they leave no motion that their laws ask."


def lock(system: MechanicalSystem, t: float, q: Array, end: float) -> str:
    """Return in words that the joints lock right behind t; nothing if they do not."""
    if system.n_lam != system.n_q or np.iscomplexobj(q) or not end > t:
        return ""
    reached, _ = followed(system, t, q, end)
    return locks(reached) if reached < end else ""


def turn_error(system: MechanicalSystem, t: float, h: float, order: int) -> float:
    """Return (turn / 1 rad)^order for the largest prescribed turn in a step of size h to t."""
    rate = float(np.max(system.turn_rate(t - h + h * _PLACES)))
    return (rate * h / _TURN) ** order


def followed(system: MechanicalSystem, t: float, q: Array, end: float) -> tuple[float, Array]:
    """Follow a motion that constraints determine; return the time reached, and the place."""
    h, least = end - t, _SHORTEST * (end - t)
    while t < end:
        h = min(h, end - t)
        later = end if h == end - t else t + h
        closed = _closed(system, t, q, later)
        if closed is not None:
            t, q, h = later, closed, 2 * h
        elif h <= least:
            break
        else:
            h /= 4
    return t, q


def _closed(system: MechanicalSystem, t: float, q: Array, end: float) -> Array | None:
    """Return q at `end` by Newton's method from the tangent, None if it is not surely near."""
    step = _solved(system, t, q, velocity_side(system, t, q))
    if step is None:
        return None
    step = (end - t) * step
    least = _SMALL * norm(q, system.weights)
    allowed = _CURVED * norm(step, system.weights)
    q = q + step
    for _ in range(_ITERATIONS):
        change = _solved(system, end, q, system.constraint(end, q))
        size = np.inf if change is None else norm(change, system.weights)
        if change is None or size > max(allowed, least):
            return None
        q, allowed = q - change, _CURVED * size
        if size <= least:
            return q
    return None


def _solved(system: MechanicalSystem, t: float, q: Array, side: Array) -> Array | None:
    """Return x with Phi_q x = side, None where Phi_q is singular."""
    matrix = system.constraint_pattern.csr(system.constraint_q(t, q))
    try:
        if system.n_q <= _DENSE:
            x = np.linalg.solve(matrix.toarray(), side)
        else:
            x = scipy.sparse.linalg.splu(matrix.tocsc()).solve(side)
    except (np.linalg.LinAlgError, RuntimeError):
        return None
    return x if finite(x) else None


def _suspects(system: MechanicalSystem, rows: Rows) -> list[int]:
    """Return the steps in which velocities change much."""
    weighted = np.sqrt(system.weights) * rows.v
    sizes = np.linalg.norm(weighted, axis=1)
    changes = np.linalg.norm(np.diff(weighted, axis=0), axis=1)
    return np.flatnonzero(changes > _CHANGE * (sizes[1:] + sizes[:-1])).tolist()


def _half_a_turn(system: MechanicalSystem, joint: str, begin: float, end: float) -> str:
    rate = float(np.max(system.turn_rate(begin + (end - begin) * _PLACES)))
    turns = f", which turns at {rate:.3g} rad/s," if rate > 0 else ""
    repair = f"{_TURN / rate:.2g} s or less" if rate > 0 else "a fraction of this size"
    return (
        f"Joint {joint!r}{turns} stands half a turn from the angle of its law at t = {end:.6g}: "
        f"its equation holds there as well. Take steps of {repair}, or rtol."
    )
