"""Fast features that steps may pass over unnoticed: pulses in time, transitions in the state.

**Pulses** of laws and of objectives. No run shows them: a method that controls its error does not
notice a pulse of 2 ms between two stages of a step of 50 ms, and two runs that both miss it agree.
So all functions that depend on time explicitly are sampled finely before any run: laws of loads and
drivers, forces and constraints of a user's own system, and observables at fixed states.

**Transitions** of forces in the state, such as that of dry friction. Within a transition forces
change much while the state changes little. A design derivative of a step contains the slopes of
forces at its time points: if these lie on both sides of a transition it contains nothing of the
jump between them, whatever the motion does, and runs agree on a wrong derivative. So forces are
sampled along the straight path between the states of the run, about the steps in which
accelerations change most suddenly, and ever more closely where the samples jump. The width of a
transition is its jump over its largest slope.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, NoReturn, final

import numpy as np

from ancfdae.equations import MechanicalSystem, PlannedSystem, Solution
from ancfdae.errors.kinds import AncfdaeError
from ancfdae.integrators.problem import InitialValueProblem
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.pulses import SAMPLES, Pulses, find_pulses
from ancfdae.sensitivity.observables.observable import Observable, States

# Number of sampling intervals of a system that is called once per time; laws of scenes take arrays.
_CALLS = 2**10
# Number of steps of the coarsest run of HHT-I3.
_LEAST = 64
# Most stops of a run.
_MOST = 200


def features(
    problem: InitialValueProblem, observables: Sequence[Observable], t_end: float
) -> Pulses:
    """Return the pulses of laws and observables of a problem, from fine samples up to `t_end`, s.

    Without pulses the result asks for no steps and has no stops.
    """
    system = problem.system
    count = SAMPLES if isinstance(system, PlannedSystem) else _CALLS
    t = np.linspace(0.0, t_end, count + 1)
    with np.errstate(all="ignore"):
        rows = [] if _timeless(system) else [find_pulses(t, system.over_time(t), _LEAST)]
    seen = [x for x in observables if any(leaf.names_time for leaf in x.leaves())]
    if seen:
        rows.append(find_pulses(t, _held(problem, seen, t), _LEAST))
    stops = sorted(set[float]().union(*(x.stops for x in rows)))
    return Pulses(max((x.steps for x in rows), default=0), tuple(stops[:_MOST]))


class _Untold:
    """A placeholder for the time that raises TypeError when it is used, and records that."""

    def __init__(self) -> None:
        self.asked = False

    def _ask(self, *_: object) -> NoReturn:
        self.asked = True
        raise TypeError

    def __getattr__(self, name: str) -> NoReturn:
        # NumPy looks for its own protocols in the entries of arrays, which does not count as use.
        if not name.startswith("__array"):
            self.asked = True
        raise AttributeError(name)

    @property  # type: ignore[misc]
    def __class__(self) -> type:
        """The class; a formula that uses isinstance asks for it."""
        self.asked = True
        return _Untold

    __eq__ = __ne__ = __lt__ = __le__ = __gt__ = __ge__ = __bool__ = __abs__ = _ask
    __neg__ = __pos__ = __float__ = __int__ = __complex__ = __index__ = __round__ = _ask
    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __pow__ = __rpow__ = _ask
    __truediv__ = __rtruediv__ = __floordiv__ = __rfloordiv__ = __mod__ = __rmod__ = _ask
    __divmod__ = __rdivmod__ = __str__ = __format__ = _ask


def _timeless(system: MechanicalSystem) -> bool:
    """Return whether no formula of a user's system uses the time."""
    time = _Untold()
    try:
        values = system.over_time(np.array([time], dtype=object))
    except Exception:  # noqa: BLE001 A formula may raise anything where it meets that time.
        return False
    # A formula that catches the exception has used the time, too.
    return np.asarray(values).dtype != object and not time.asked


def _held(problem: InitialValueProblem, observables: Sequence[Observable], t: Array) -> Array:
    """Return values of observables over time at a fixed state, shape (n_t, n).

    The state is the start, with velocities and multipliers shifted by their scales.
    """
    first, scales = problem.initial, problem.scales
    held = first.q, first.v + scales.v, first.lam + scales.lam
    q, v, lam = (np.broadcast_to(x, (len(t), len(x))) for x in held)
    states = States(t, q, v, lam)
    columns = []
    for each in observables:
        try:
            columns.append(np.real(each.value(problem.system, states)))
        except AncfdaeError:  # The run reports it with the time.
            continue
    return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))


# -- transitions -------------------------------------------------------------------------------


# Most steps about which forces are sampled, intervals of each, and how often these are divided;
# intervals of a first check of a step, after which most steps are dismissed.
_LOOKED_AT: Final = 6
_INTERVALS: Final = 8
_DEPTH: Final = 9
_FIRST: Final = 4
# A step is sudden if its change of accelerations, less that of its neighbours, exceeds this times
# the median of the run.
_SUDDEN: Final = 4.0
# Least width of a resolved transition, in steps; steps per width that resolve its slope.
_RESOLVED: Final = 0.5
_PER_WIDTH: Final = 4.0
# Least fraction of a change that must lie in one interval of finer samples: for the change to be a
# jump, and for the interval to be divided again.
_JUMPS: Final = 0.125
_WITHIN: Final = 0.25


class Transition(NamedTuple):
    """Number of steps that resolve all transitions, and the change of state in the narrowest.

    The change is relative to the range of q or v over the run, whichever makes the forces jump.
    Zero steps and an infinite change if all transitions are resolved.
    """

    steps: int
    narrow: float


RESOLVED: Final = Transition(0, math.inf)


def passed_over(problem: InitialValueProblem, run: Solution, share: float) -> Transition:
    """Return the transitions that the steps of a run pass over.

    Their jumps exceed `share` times the accelerations. Beams alone make no transitions: their
    forces are polynomials of a low degree in the state.
    """
    system = problem.system
    count, root = len(run.t) - 1, np.sqrt(system.weights)
    if count < 4 or _smooth(system):
        return RESOLVED
    a = run.a * root
    sizes = np.linalg.norm(a, axis=1)
    rises = np.diff(a, axis=0)
    sudden = np.zeros(count)
    sudden[1:-1] = np.linalg.norm(rises[1:-1] - (rises[:-2] + rises[2:]) / 2, axis=1)
    least = np.maximum(share * np.maximum(sizes[:-1], sizes[1:]), _SUDDEN * np.median(sudden))
    looked_at = np.flatnonzero(sudden > least)
    if not looked_at.size:
        return RESOLVED
    solver, found = problem.accelerations, RESOLVED
    states = np.stack([run.q, run.v], axis=1)
    reach = [float(np.ptp(x * root, axis=0).max()) for x in (run.q, run.v)]

    def of(states: Array, t: float) -> Array:
        """Return the weighted accelerations of `states` at one time t, shape (len(states), n_q)."""
        rows = solver.rows_of(np.full(len(states), t), states[:, :, None])
        return np.asarray(rows[:, 0, : system.n_q] * root)

    for n in looked_at[np.argsort(sudden[looked_at])[-_LOOKED_AT:]]:
        path = _Path(of, states[n - 1 : n + 3], float(run.t[n] + run.t[n + 1]) / 2)
        least = share * float(sizes[n])
        with np.errstate(all="ignore"):
            if not path.seems_narrow(least):
                continue
            width, left, right = path.narrowest(least)
            if not width < _RESOLVED:
                continue
            jumps = path.jumps(left, right)
        kind = int(np.argmax(jumps))
        step = float(np.linalg.norm((states[n + 1, kind] - states[n, kind]) * root))
        narrow = width * step / reach[kind] if reach[kind] > 0 else math.inf
        steps = math.ceil(count * _PER_WIDTH / width)
        found = Transition(max(found.steps, steps), min(found.narrow, narrow))
    return found


def _smooth(system: MechanicalSystem) -> bool:
    """Return whether forces and constraints of a system have no transitions."""
    plan = system.plan if isinstance(system, PlannedSystem) else None
    return plan is not None and not plan.moving and system.traits.constant_constraints


@final
@dataclass(frozen=True)
class _Path:
    """Straight lines through four successive states of a run, with the step number as parameter.

    `of` returns the accelerations of states at the fixed time `t`, times roots of masses.
    """

    of: Callable[[Array, float], Array]
    states: Array
    t: float

    def _at(self, parts: Array) -> Array:
        """Return states at parameters `parts` of the path, interpolated, (len(parts), 2, n_q)."""
        n = np.minimum(parts.astype(int), len(self.states) - 2)
        share = (parts - n)[:, None, None]
        return np.asarray((1 - share) * self.states[n] + share * self.states[n + 1])

    def _rises(self, left: float, size: float, count: int) -> Array:
        """Return the changes of accelerations on `count` equal intervals, shape (count, n_q)."""
        return np.diff(self.of(self._at(np.linspace(left, left + size, count + 1)), self.t), axis=0)

    def jumps(self, left: float, right: float) -> list[float]:
        """Return the change of accelerations between two parameters by q alone, and by v alone."""
        ends = self._at(np.array([left, right]))
        by_q, by_v = ends.copy(), ends.copy()
        by_q[:, 1], by_v[:, 0] = ends[:, 1].mean(axis=0), ends[:, 0].mean(axis=0)
        return [float(np.linalg.norm(np.diff(self.of(x, self.t), axis=0))) for x in (by_q, by_v)]

    def seems_narrow(self, least: float) -> bool:
        """Return whether a few intervals of the middle step may contain a jump above `least`."""
        first = _Seen.of(self._rises(1.0, 1.0, _FIRST), 1.0)
        if first.concentrated:
            return first.total > least
        if not first.most > least:
            return False
        left = 1.0 + first.k / _FIRST
        second = _Seen.of(self._rises(left, 1 / _FIRST, _FIRST), 1 / _FIRST)
        return not second.most < _JUMPS * first.most

    def narrowest(self, least: float) -> tuple[float, float, float]:
        """Return the width of the largest jump, in steps, and the interval that contains it.

        The width is infinite without a jump above `least`. Three steps are examined: within one
        step half a kink looks like a jump.
        """
        left, size, count = 0.0, 3.0, 3 * _INTERVALS
        seen = first = _Seen.of(self._rises(left, size, count), size)
        jump, slope = first.most, first.slope
        for depth in range(_DEPTH):
            left, size, count = left + seen.k * size / count, size / count, _INTERVALS
            whole, seen = seen.most, _Seen.of(self._rises(left, size, count), size)
            slope = max(slope, seen.slope)
            if depth == 0 and seen.most < _JUMPS * whole:
                # Smooth, or spread over some intervals.
                jump = first.total if first.concentrated else 0.0
            if not seen.most >= _WITHIN * whole:
                break
        width = jump / slope if least < jump < math.inf else math.inf
        return width, left, left + size


class _Seen(NamedTuple):
    """Size and position of a jump in the changes of accelerations on equal intervals.

    `total` is the sum of the changes, `slope` the steepest slope, `most` the largest change beyond
    a smooth one, `k` its interval.
    """

    total: float
    slope: float
    most: float
    k: int

    @staticmethod
    def of(rises: Array, size: float) -> _Seen:
        """Return the jump in the changes `rises` on intervals of a path of length `size`."""
        sizes = np.linalg.norm(rises, axis=1)
        # A slope and its change are those of smooth forces.
        change = np.median(np.diff(rises, axis=0), axis=0)
        rest = rises - np.arange(len(rises))[:, None] * change
        beside = np.linalg.norm(rest - np.median(rest, axis=0), axis=1)
        slope = float(sizes.max()) * len(rises) / size
        return _Seen(float(sizes.sum()), slope, float(beside.max()), int(np.argmax(beside)))

    @property
    def concentrated(self) -> bool:
        """Whether accelerations change within a small fraction of a step only."""
        return self.total < _RESOLVED * self.slope
