"""Fast features that steps may pass over without a trace: pulses of laws and of objectives.

No run can tell: a method that controls its error does not see a pulse of 2 ms between two stages of
a step of 50 ms, and two runs that both miss it agree. So everything that depends on time by itself
is sampled finely before any run: laws of loads and drives, forces and constraints of a system of
one's own, and observables with the states held. A function is followed by n steps if straight lines
between its values at n + 1 instants are within a share of its range everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ancfdae.equations import MechanicalSystem, PlannedSystem
from ancfdae.errors.kinds import AncfdaeError
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.numerics.arrays import Array
from ancfdae.sensitivity.observables.observable import Observable
from ancfdae.sensitivity.observables.states import States

# Intervals of the samples: laws of scenes are arrays at once, others are called once an instant.
_LAWS, _CALLS = 2**14, 2**10
# Numbers of steps, each a divisor of the samples, that may follow a function; the least one is what
# HHT-I3 begins with.
_STEPS = 64, 128, 256, 512, 1024, 2048
# Distance from a straight line, over the range, that counts as followed, and that begins a feature.
_FOLLOWED, _BEGINS = 0.2, 0.02
# Features may take this share of the time; more are no pulses, but a motion that is fast throughout
# and that error control meets everywhere. Each gives as many stops.
_SHARE, _PARTS = 0.3, 8
_MOST = 200


class Features(NamedTuple):
    """Fewest steps that follow what depends on time by itself, and stops around its pulses, s."""

    steps: int
    stops: tuple[float, ...]


def features(system: MechanicalSystem, observables: Sequence[Observable], t_end: float) -> Features:
    """Sample laws and observables; one without features asks for no steps and has no stops."""
    count = _LAWS if isinstance(system, PlannedSystem) else _CALLS
    t = np.linspace(0.0, t_end, count + 1)
    with np.errstate(all="ignore"):
        rows = [_features(t, system.over_time(t))]
    seen = [x for x in observables if any(leaf.names_time for leaf in x.leaves())]
    if seen:
        rows.append(_features(t, _held(system, seen, t)))
    stops = sorted(set(rows[0].stops).union(*(x.stops for x in rows)))
    return Features(max(x.steps for x in rows), tuple(stops[:_MOST]))


def _held(system: MechanicalSystem, observables: Sequence[Observable], t: Array) -> Array:
    """Return values of observables over time at the start with the sizes of a motion added."""
    problem = InitialValueProblem.of(system, float(t[-1]))
    first, scales = problem.initial, problem.scales
    held = first.q, first.v + scales.v, first.lam + scales.lam
    q, v, lam = (np.broadcast_to(x, (len(t), len(x))) for x in held)
    states = States(t, q, v, lam)
    columns = []
    for each in observables:
        try:
            columns.append(np.real(each.value(system, states)))
        except AncfdaeError:  # The run says so with the instant.
            continue
    return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))


def _features(t: Array, values: Array) -> Features:
    """Judge functions of time, the columns of values at equally spaced instants."""
    values = values[:, np.all(np.isfinite(values), axis=0)]
    ranges = np.ptp(values, axis=0)
    values = values[:, ranges > 1e-12 * np.max(np.abs(values), axis=0, initial=0.0)]
    if not values.size:
        return Features(0, ())
    values = values / np.ptp(values, axis=0)
    off = _off(values, _STEPS[0])
    if off.max() <= _FOLLOWED:
        return Features(0, ())
    steps = next((n for n in _STEPS[1:] if _off(values, n).max() <= _FOLLOWED), _STEPS[-1])
    # Lines of more steps leave the neighbourhood of a pulse.
    near = _off(values, max(steps // 4, _STEPS[0]))
    return Features(steps, _stops(t, near > _BEGINS))


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
