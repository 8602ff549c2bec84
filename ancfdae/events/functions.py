"""Functions of events and gaps along a run: values, rates in time, and partials.

They are observables. Runs with events also need their rates in time and, for impacts, the change of
the gradient of a gap with the motion.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, cast

import numpy as np

from ancfdae.equations import MechanicalSystem, Solution
from ancfdae.equations.complex_steps import at_values
from ancfdae.errors.kinds import InvalidInputError
from ancfdae.numerics.arrays import STEP, Array
from ancfdae.numerics.complex_step import scaled_derivative
from ancfdae.sensitivity.observables.expression import leaf_weights
from ancfdae.sensitivity.observables.observable import Leaf, Observable, States

# A gap is linear in the coordinates if its gradients differ by less than this, relative to the
# largest entry.
_SAME = 1e-14
# A sliding velocity is linear in velocities if it differs from its linear form by less than this,
# relative to its terms.
_LINEAR = 1e-10

#: Rows, (k, n_q), and rates at zero velocities, (k,), of a gap or of a sliding velocity at k times
#: and configurations of a system.
RowsOf = Callable[[MechanicalSystem, Array, Array], tuple[Array, Array]]


class AlongRun(NamedTuple):
    """Values and rates in time of an observable at the time points of a run, (k,) each.

    `size` is the sum of the magnitudes of its terms, to which their round-off is relative.
    """

    value: Array
    rate: Array
    size: Array


class Partials(NamedTuple):
    """Partials of an observable in one state: in time, q, v, lam, and, at fixed state, design."""

    t: float
    q: Array
    v: Array
    lam: Array
    b: Array


def along_run(
    system: MechanicalSystem, function: Observable, t_0: float, run: Solution
) -> AlongRun:
    """Return an observable along a phase that began at t_0, s."""
    states = States(t_0 + run.t, run.q, run.v, run.lam, run.degree)
    p = function.partials(system, states)
    on_t = in_time(system, function, states)
    rate, size = on_t, np.abs(on_t) * states.t
    for partial, x, change in ((p.q, run.q, run.v), (p.v, run.v, run.a)):
        if partial is not None:
            rate = rate + np.sum(partial * change, axis=1)
            size = size + np.abs(partial) @ _sizes(system, x)
    if p.lam is not None:
        size = size + np.abs(p.lam) @ np.max(np.abs(run.lam), axis=0, initial=0.0)
        if len(run.t) > 1:
            rate = rate + np.sum(p.lam * np.gradient(run.lam, run.t, axis=0), axis=1)
    return AlongRun(p.value, rate, size)


def _sizes(system: MechanicalSystem, x: Array) -> Array:
    """Return the largest magnitude along rows of x, (k, n_q), of each coordinate's vector, (n_q,).

    A coordinate that is zero because of the direction of the axes has the round-off of its vector.
    """
    largest, d = np.max(np.abs(x), axis=0, initial=0.0), system.vector_size
    whole = len(largest) // d * d
    of_vectors = np.max(largest[:whole].reshape(-1, d), axis=1, initial=0.0)
    return np.append(np.repeat(of_vectors, d), largest[whole:])


def at_end(
    system: MechanicalSystem, function: Observable, t: float, run: Solution
) -> tuple[float, Partials]:
    """Return value and partials of an observable in the last state of a run, at time t, s."""
    last = States(np.array([t]), run.q[-1:], run.v[-1:], run.lam[-1:])
    return partials(system, function, last)


def partials(
    system: MechanicalSystem, function: Observable, states: States
) -> tuple[float, Partials]:
    """Return value and partials of an observable in one state."""
    p = function.partials(system, states)
    sizes = (states.q, states.v, states.lam)
    q, v, lam = (
        np.zeros(x.shape[1]) if part is None else part[0]
        for part, x in zip((p.q, p.v, p.lam), sizes, strict=True)
    )
    on_t = float(in_time(system, function, states)[0])
    return float(p.value[0]), Partials(on_t, q, v, lam, p.b[0])


def gap_at(
    system: MechanicalSystem, gap: Observable, t: float, q: Array, *v: Array
) -> tuple[float, float, float, float]:
    """Return a gap in one state, its rate, and the magnitudes of the terms of gap and rate.

    The first velocities belong to the state. Further ones, such as velocities before an impact
    whose round-off remains, count only in the magnitude of the rate.
    """
    at = States(np.array([t]), q[None], v[0][None], np.zeros((1, system.n_lam)))
    g, p = partials(system, gap, at)
    size, speed = (np.abs(p.q) @ _sizes(system, x) for x in (q[None], np.array(v)))
    return g, float(p.q @ v[0] + p.t), float(size + abs(p.t) * t), float(speed + abs(p.t))


def in_time(system: MechanicalSystem, function: Observable, states: States) -> Array:
    """Return the partial of an observable in time, at fixed states and design, shape (k,)."""
    values = function.node_values(system, states)
    total = np.zeros(len(states.t))
    for leaf, weight in leaf_weights(values, np.ones(len(states.t))).items():
        total += weight * _leaf_in_time(system, cast(Leaf, leaf), states)
    return total


def _leaf_in_time(system: MechanicalSystem, leaf: Leaf, states: States) -> Array:
    def value(late: complex) -> Array:
        at = States(states.t + late, states.q, states.v, states.lam, states.degree)
        return np.asarray(leaf.leaf_value(system, at))

    if leaf.remembers:
        return np.zeros(len(states.t))
    if leaf.names_time:
        return np.imag(value(1j * STEP)) / STEP
    size = float(np.max(np.abs(states.t), initial=0.0)) or 1.0
    if np.array_equal(value(1e-3 * size), value(0.0)):
        return np.zeros(len(states.t))
    return scaled_derivative(value)


def gap_rows(system: MechanicalSystem, gap: Observable, t: Array, q: Array) -> tuple[Array, Array]:
    """Return g_q, (k, n_q), and g_t, (k,), of a gap at k configurations.

    The rate of the gap is g_q v + g_t. Raises InvalidInputError if the gap depends on velocities or
    multipliers.
    """
    states = States(t, q, np.zeros_like(q), np.zeros((len(t), system.n_lam)))
    p = gap.partials(system, states)
    for what, part in (("velocities", p.v), ("multipliers", p.lam)):
        if part is not None and np.any(part):
            rule = "must be a function of positions, time and design"
            raise InvalidInputError("Impact.gap", rule, f"one of {what}", "Use Switch or EndEvent.")
    q_rows = np.zeros_like(q) if p.q is None else p.q
    return q_rows, in_time(system, gap, states)


def sliding_rows(
    system: MechanicalSystem, sliding: Observable, t: Array, q: Array
) -> tuple[Array, Array]:
    """Return s_v, (k, n_q), and s(v = 0), (k,), of a sliding velocity at k configurations.

    The sliding velocity is s_v v + s(v = 0); InvalidInputError if it is not linear in v.
    """
    still = np.zeros_like(q)
    # Velocities that differ by coordinate, with the sizes of positions.
    other = np.cos(np.arange(q.shape[1])) * (np.max(np.abs(q), axis=1, initial=0.0) + 1)[:, None]
    lam = np.zeros((len(t), system.n_lam))
    p = sliding.partials(system, States(t, q, still, lam))
    moved = sliding.value(system, States(t, q, other, lam))
    rows = np.zeros_like(q) if p.v is None else p.v
    on_lam = p.lam is not None and np.any(p.lam)
    terms = np.abs(rows * other).sum(axis=1) + np.abs(p.value)
    off = moved - p.value - np.sum(rows * other, axis=1)
    if on_lam or np.any(np.abs(off) > _LINEAR * terms):
        rule, repair = "must be linear in velocities", "For example velocity(point, 0)."
        got = "one of multipliers" if on_lam else "one that is not"
        raise InvalidInputError("Impact.sliding", rule, got, repair)
    return rows, p.value


def rows_along(
    system: MechanicalSystem,
    rows_of: RowsOf,
    t: float,
    q: Array,
    along: tuple[Array, Array, Array],
) -> tuple[Array, Array]:
    """Return the derivatives along k directions of rows, (n_q, k), and of rates, (k,).

    `rows_of` returns g_q and g_t of a gap, or s_v and s_t of a sliding velocity. The directions are
    (t_b, q_b, b_b) of shapes (k,), (n_q, k) and (n_b, k).
    """
    t_b, q_b, b_b = along
    times = np.full(q_b.shape[1], t)

    def rows(late: Array, moved: Array) -> Array:
        g_q, g_t = rows_of(system, times + late, q + moved.T)
        return np.hstack([g_q, g_t[:, None]])

    # Directions of the size of the coordinates.
    sizes = np.max(np.abs(q_b), axis=0, initial=0.0) + np.abs(t_b)
    unit = np.where(sizes > 0, 1 / np.where(sizes > 0, sizes, 1.0), 0.0)
    step_t, step_q = t_b * unit, q_b * unit
    total = np.zeros((len(t_b), len(q) + 1))
    now = rows(0 * t_b, 0 * q_b)
    span = float(np.max(np.abs(q), initial=0.0)) or 1.0
    moved = (rows(x * span * step_t, x * span * step_q) for x in (0.01, -0.1, 0.3))
    size = np.max(np.abs(now), initial=0.0)
    if any(np.max(np.abs(x - now), initial=0.0) > _SAME * size for x in moved):
        found = scaled_derivative(lambda x: rows(x * step_t, x * step_q))
        total += found * np.where(sizes > 0, sizes, 0.0)[:, None]
    for i in range(system.n_b):
        if np.any(b_b[i]):
            total += np.outer(b_b[i], _rows_b(system, rows_of, t, q, i))
    return total[:, :-1].T, total[:, -1]


def _rows_b(system: MechanicalSystem, rows_of: RowsOf, t: float, q: Array, i: int) -> Array:
    """Return the derivative of (g_q, g_t) with respect to design variable i, shape (n_q + 1,)."""
    unit = np.eye(system.n_b)[i] * (abs(system.b[i]) or 1.0)

    def rows(x: float) -> Array:
        other = at_values(system, system.b + x * unit) if x else system
        g_q, g_t = rows_of(other, np.array([t]), q[None])
        return np.append(g_q[0], g_t)

    now = rows(0.0)
    beside = (rows(x) for x in (1e-3, -1e-2))
    if all(np.max(np.abs(x - now)) <= _SAME * np.max(np.abs(now)) for x in beside):
        return np.zeros_like(now)
    return np.asarray(scaled_derivative(rows) / (abs(system.b[i]) or 1.0))
