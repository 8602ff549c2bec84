"""Contacts between two time points at neither of which surfaces touch.

Between time points the motion follows the cubic through positions and velocities at both. The
velocities of the cubic bound the rate of a depth d, which is negative where surfaces are apart.
Their norms are at most the largest of v_n, 3 (q_n+1 - q_n)/h - v_n - v_n+1 and v_n+1 (its Bezier
points). With the bound L there is no contact between two points of the path a time s apart if

    d_1 + d_2 + L s < 0.

Otherwise the midpoint is evaluated (conservative advancement), down to a fraction 2^-_LEVELS of the
step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol, final

import numpy as np

from ancfdae.assembly.load_forces import LoadInput, MovingLoad
from ancfdae.model.loads.contact import ContactLoad
from ancfdae.numerics.arrays import Array

_LEVELS: Final = 12
# Bisections for the times at which a contact begins and ends, and number of points within it.
_HALVINGS, _PLACES = 40, 8
# Number of intervals of a step at which loads without a depth are evaluated.
_BLIND: Final = 16
# Largest number of vectors that are evaluated at once.
_ROOM: Final = 2**20
# Largest number of contacts of one packet whose impulses are computed.
_MOST: Final = 256


@final
@dataclass(frozen=True)
class Passed:
    """A contact between two time points: begin and end, s, and impulse on each group, (n,)."""

    begin: float
    end: float
    impulses: Array


class Grouped(Protocol):
    """Protocol of coordinates in groups (bodies, nodes), with the norms of forces on them."""

    def forces(self, Q: Array) -> Array:
        """Return the norm of the forces on each group, shape (k, n), for Q of shape (k, n_q)."""

    def of_coordinates(self, columns: Array) -> Array:
        """Return the groups to which coordinates of these indices, shape (k,), belong."""


class _Steps(NamedTuple):
    """Steps of the run with a contact each: time, size, and states at both ends.

    The states are the vectors U, their rates V and the signals of the load.
    """

    t: Array
    h: Array
    U: tuple[Array, Array]
    V: tuple[Array, Array]
    signals: tuple[Array, Array]

    def at(self, s: Array, which: Array | slice = slice(None)) -> tuple[Array, Array, Array]:
        """Return vectors, rates and signals at the fractions s of the steps `which`."""
        h, (U, U_1), (V, V_1), (x, x_1) = (
            self.h[which][:, None, None],
            *(tuple(y[which] for y in pair) for pair in (self.U, self.V, self.signals)),
        )
        part, rise = s[:, None, None], U_1 - U
        bend, twist = 3 * rise - h * (2 * V + V_1), h * (V + V_1) - 2 * rise
        place = U + part * (h * V + part * (bend + part * twist))
        return place, V + part * (2 * bend + 3 * part * twist) / h, x + s[:, None] * (x_1 - x)


def passed_contacts(
    load: MovingLoad, groups: Grouped, states: tuple[Array, Array, Array], F: Array
) -> Iterator[Passed]:
    """Yield contacts of a load between two time points at neither of which surfaces touch.

    `F` are the load's forces on the groups at the time points.
    """
    t, q, v = states
    if len(t) < 2:
        return
    if not isinstance(load.item.load, ContactLoad):
        yield from _blindly(load, groups, states, F)
        return
    item = load.item
    size = max(1, _ROOM // (len(item.own) * item.reference.size))
    for k in range(0, len(t) - 1, size):
        some = slice(k, k + size + 1)
        yield from _in_packet(item, groups, (t[some], q[some], v[some]), F[some])


def _in_packet(
    item: LoadInput, groups: Grouped, states: tuple[Array, Array, Array], F: Array
) -> Iterator[Passed]:
    t, q, v = states
    U, V = (item.by_copies(item.vectors.of(x)) for x in (q, v))
    signals = item.signals_of_copies(t)
    depth, h = item.depth(U, signals), np.diff(t)
    way = h[:, None, None, None]
    middle = 3 * np.diff(U, axis=0) - way * (V[:-1] + V[1:])
    rate = item.closing(U[:-1], np.stack([way * V[:-1], middle, way * V[1:]]), signals[:-1])
    apart = (depth[:-1] <= 0) & (depth[1:] <= 0) & (h[:, None] > 0)
    k, copy = np.nonzero(apart & (depth[:-1] + depth[1:] + rate > 0))
    idle = _idle(item, groups, depth, F, (U, V, signals))
    if not len(k) and not len(idle[0]):
        return
    free, k, copy = len(k), np.append(k, idle[0]), np.append(copy, idle[1])
    U_k, V_k, signals_k = ((x[k, copy], x[k + 1, copy]) for x in (U, V, signals))
    steps = _Steps(t[k], h[k], U_k, V_k, signals_k)
    bounds = rate[k, copy], depth[k, copy], depth[k + 1, copy]
    which, within = _touching(item, steps, tuple(x[:free] for x in bounds))  # type: ignore[arg-type]
    which = np.append(which, free + np.arange(len(idle[0])))
    within = np.concatenate([within, idle[2]])
    for begin in range(0, min(len(which), _MOST), _PLACES):
        some = slice(begin, begin + _PLACES)
        yield from _impulses(item, groups, steps, which[some], within[some], copy)


def _idle(
    item: LoadInput, groups: Grouped, depth: Array, F: Array, states: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """Return steps with contact without force at an end, copies, and three fractions of each.

    There is no force for example at the centre of a ball. The fractions are as in `_touching`. Of
    a body between two others the forces may add up to zero: each contact has a force there.
    """
    row, copy = np.nonzero(depth > 0)
    group = groups.of_coordinates(
        item.vectors.column[item.vectors.first[: -1 : item.reference.size]]
    )
    idle, last = F[row, group[copy]] == 0, len(depth) - 1
    row, copy = row[idle], copy[idle]
    if len(row):
        own = item.force(*(x[row, copy] for x in states))
        idle = ~np.any(np.real(own) != 0, axis=(1, 2))
        row, copy = row[idle], copy[idle]
    before = (row > 0) & (F[np.maximum(row - 1, 0), group[copy]] == 0)
    behind = (row < last) & (F[np.minimum(row + 1, last), group[copy]] == 0)
    parts = np.array([[0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    which = np.repeat([0, 1], [before.sum(), behind.sum()])
    steps = np.concatenate([row[before] - 1, row[behind]])
    return steps, np.concatenate([copy[before], copy[behind]]), parts[which]


def _touching(
    item: LoadInput, steps: _Steps, bounds: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    """Return the steps in which surfaces touch, and for each three fractions of it.

    Surfaces touch at the second fraction, and are apart at the first and the third one.
    """
    rate, first, last = bounds
    n = len(rate)
    which: Array = np.arange(n)
    s: Array = np.zeros(n)
    size = 1.0
    found = np.zeros(n, dtype=bool)
    parts = np.zeros((n, 3))
    for _ in range(_LEVELS):
        size /= 2
        U, _, signals = steps.at(s + size, which)
        middle = item.depth(U[:, None], signals[:, None])[:, 0]
        touch = (middle > 0) & ~found[which]
        found[which[touch]] = True
        parts[which[touch]] = s[touch, None] + size * np.arange(3)
        left = ~found[which]
        which, s, first, middle, last = (x[left] for x in (which, s, first, middle, last))
        far = rate[which] * size
        before, behind = first + middle + far >= 0, middle + last + far >= 0
        which = np.concatenate([which[before], which[behind]])
        s = np.concatenate([s[before], s[behind] + size])
        first = np.concatenate([first[before], middle[behind]])
        last = np.concatenate([middle[before], last[behind]])
        if not len(which):
            break
    chosen = np.flatnonzero(found)
    return chosen, parts[chosen]


def _impulses(
    item: LoadInput, groups: Grouped, steps: _Steps, which: Array, parts: Array, copy: Array
) -> Iterator[Passed]:
    """Yield the contacts in some steps with their impulses, by the force of the load."""
    begin, end = (_boundary(item, steps, which, parts[:, k], parts[:, 1]) for k in (0, 2))
    lasts, places = (end - begin) * steps.h[which], (np.arange(_PLACES) + 0.5) / _PLACES
    impulses = np.zeros((len(which), len(groups.forces(np.zeros(item.vectors.n_q)))))
    for place in places:
        s = begin + place * (end - begin)
        U, V, signals = steps.at(s, which)
        law = item.factors(steps.t[which] + s * steps.h[which], 0)[:, :1]
        F = np.zeros((len(which), len(item.own), *U.shape[1:]))
        F[np.arange(len(which)), copy[which]] = np.real(item.force(U, V, signals))
        Q = law * item.vectors.lift(F.reshape(len(which), -1, U.shape[2]))
        impulses += groups.forces(np.real(Q)) * lasts[:, None] / _PLACES
    for k, impulse in zip(range(len(which)), impulses, strict=True):
        t, h = steps.t[which[k]], steps.h[which[k]]
        yield Passed(float(t + begin[k] * h), float(t + end[k] * h), impulse)


def _boundary(item: LoadInput, steps: _Steps, which: Array, apart: Array, touch: Array) -> Array:
    """Return the fraction of each step, (k,), at which contact begins or ends, by bisection."""
    for _ in range(_HALVINGS):
        middle = (apart + touch) / 2
        U, _, signals = steps.at(middle, which)
        inside = item.depth(U[:, None], signals[:, None])[:, 0] > 0
        apart, touch = np.where(inside, apart, middle), np.where(inside, middle, touch)
    return touch


def _blindly(
    load: MovingLoad, groups: Grouped, states: tuple[Array, Array, Array], F: Array
) -> Iterator[Passed]:
    """Yield contacts within steps that have no contact force at their ends, found by sampling."""
    t, q, v = states
    h = np.diff(t)[:, None]
    free, impulses = (F[:-1] == 0) & (F[1:] == 0), np.zeros_like(F[1:])
    rise = np.diff(q, axis=0)
    bend, twist = 3 * rise - h * (2 * v[:-1] + v[1:]), h * (v[:-1] + v[1:]) - 2 * rise
    for s in np.arange(1, _BLIND) / _BLIND:
        place = q[:-1] + s * (h * v[:-1] + s * (bend + s * twist))
        speed = v[:-1] + s * (2 * bend + 3 * s * twist) / h
        force = groups.forces(load.force(place, speed, t[:-1] + s * h[:, 0]).real)
        impulses += h / _BLIND * np.where(free, force, 0.0)
    for k in np.flatnonzero(np.any(impulses > 0, axis=1)).tolist():
        yield Passed(float(t[k]), float(t[k + 1]), impulses[k])
