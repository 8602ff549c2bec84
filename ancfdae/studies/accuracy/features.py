"""Fast features that steps may pass over without a trace: pulses in time, transitions in the state.

**Pulses** of laws and of objectives. No run can tell: a method that controls its error does not see
a pulse of 2 ms between two stages of a step of 50 ms, and two runs that both miss it agree. So
everything that depends on time by itself is sampled finely before any run: laws of loads and
drives, forces and constraints of a system of one's own, and observables with the states held.

**Transitions** of forces in the state, such as the one of dry friction. Within a transition forces
change much while the state changes little. A derivative of a step has the slopes of forces at its
instants: where these lie on either side of a transition it knows nothing of the jump between them,
whatever the motion does, and runs agree on a wrong derivative. So forces are sampled along the
straight path between the states of the run, about the steps in which accelerations change most
suddenly, and ever more closely where the samples jump. The width of a transition is its jump over
its largest slope.
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

# Intervals of the samples of a system that is called once an instant; laws of scenes take arrays.
_CALLS = 2**10
# Steps of the coarsest run of HHT-I3.
_LEAST = 64
# Stops of a run.
_MOST = 200


def features(
    problem: InitialValueProblem, observables: Sequence[Observable], t_end: float
) -> Pulses:
    """Sample laws and observables; one without features asks for no steps and has no stops."""
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
    """A time that nobody may use: it notes that it was asked for anything, and raises TypeError."""

    def __init__(self) -> None:
        self.asked = False

    def _ask(self, *_: object) -> NoReturn:
        self.asked = True
        raise TypeError

    def __getattr__(self, name: str) -> NoReturn:
        # Arrays look for their own protocols in whatever they hold.
        if not name.startswith("__array"):
            self.asked = True
        raise AttributeError(name)

    @property  # type: ignore[misc]
    def __class__(self) -> type:
        """The class, of which a formula asks by isinstance."""
        self.asked = True
        return _Untold

    __eq__ = __ne__ = __lt__ = __le__ = __gt__ = __ge__ = __bool__ = __abs__ = _ask
    __neg__ = __pos__ = __float__ = __int__ = __complex__ = __index__ = __round__ = _ask
    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __pow__ = __rpow__ = _ask
    __truediv__ = __rtruediv__ = __floordiv__ = __rfloordiv__ = __mod__ = __rmod__ = _ask
    __divmod__ = __rdivmod__ = __str__ = __format__ = _ask


def _timeless(system: MechanicalSystem) -> bool:
    """Return whether nothing in a system of equations looks at the time."""
    time = _Untold()
    try:
        values = system.over_time(np.array([time], dtype=object))
    except Exception:  # noqa: BLE001 A formula may raise anything where it meets that time.
        return False
    # A formula that catches what is raised has asked.
    return np.asarray(values).dtype != object and not time.asked


def _held(problem: InitialValueProblem, observables: Sequence[Observable], t: Array) -> Array:
    """Return values of observables over time at the start with the sizes of a motion added."""
    first, scales = problem.initial, problem.scales
    held = first.q, first.v + scales.v, first.lam + scales.lam
    q, v, lam = (np.broadcast_to(x, (len(t), len(x))) for x in held)
    states = States(t, q, v, lam)
    columns = []
    for each in observables:
        try:
            columns.append(np.real(each.value(problem.system, states)))
        except AncfdaeError:  # The run says so with the instant.
            continue
    return np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))


# -- transitions -------------------------------------------------------------------------------


# Steps about which forces are sampled at most, intervals of each, and how often these are divided;
# intervals of a first look at a step, which most do not pass.
_LOOKED_AT: Final = 6
_INTERVALS: Final = 8
_DEPTH: Final = 9
_FIRST: Final = 4
# Change of accelerations in a step, less those of its neighbours, over the median of a run.
_SUDDEN: Final = 4.0
# Width of a transition that steps resolve, in steps; steps in a width that show its slope.
_RESOLVED: Final = 0.5
_PER_WIDTH: Final = 4.0
# Part of a jump that a closer look finds in one interval: of a jump, and of one to divide again.
_JUMPS: Final = 0.125
_WITHIN: Final = 0.25


class Transition(NamedTuple):
    """Steps that resolve all transitions, and the change of state within the narrowest.

    The change is relative to the size of q or v over the run, whichever makes the forces jump. No
    steps and infinite where all are resolved.
    """

    steps: int
    narrow: float


RESOLVED: Final = Transition(0, math.inf)


def passed_over(problem: InitialValueProblem, run: Solution, share: float) -> Transition:
    """Return the transitions that steps pass over whose jump exceeds a share of accelerations.

    Beams alone make no transitions: their forces are polynomials of a low degree in the state.
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
        """Return accelerations of `states` at one time t, (len(states), n_q): laws make no jump."""
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
    """Straight lines through four states of a run, parts of which are counted in steps.

    `of` returns the accelerations of states at the time `t`, times roots of masses.
    """

    of: Callable[[Array, float], Array]
    states: Array
    t: float

    def _at(self, parts: Array) -> Array:
        """Return the states at `parts` of the path, shape (len(parts), 2, n_q)."""
        n = np.minimum(parts.astype(int), len(self.states) - 2)
        share = (parts - n)[:, None, None]
        return np.asarray((1 - share) * self.states[n] + share * self.states[n + 1])

    def _rises(self, left: float, size: float, count: int) -> Array:
        """Return the changes of accelerations on `count` equal intervals, shape (count, n_q)."""
        return np.diff(self.of(self._at(np.linspace(left, left + size, count + 1)), self.t), axis=0)

    def jumps(self, left: float, right: float) -> list[float]:
        """Return how far accelerations change between two parts by q alone, and by v alone."""
        ends = self._at(np.array([left, right]))
        by_q, by_v = ends.copy(), ends.copy()
        by_q[:, 1], by_v[:, 0] = ends[:, 1].mean(axis=0), ends[:, 0].mean(axis=0)
        return [float(np.linalg.norm(np.diff(self.of(x, self.t), axis=0))) for x in (by_q, by_v)]

    def seems_narrow(self, least: float) -> bool:
        """Return whether a few intervals of the step in the middle may hold a jump."""
        first = _Seen.of(self._rises(1.0, 1.0, _FIRST), 1.0)
        if first.concentrated:
            return first.total > least
        if not first.most > least:
            return False
        left = 1.0 + first.k / _FIRST
        second = _Seen.of(self._rises(left, 1 / _FIRST, _FIRST), 1 / _FIRST)
        return not second.most < _JUMPS * first.most

    def narrowest(self, least: float) -> tuple[float, float, float]:
        """Return the width of the largest jump, in steps, and the parts that hold it.

        Infinite without a jump of the least size. Three steps are looked at: of a step alone half
        a kink looks like a jump.
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
    """Size and place of a jump in the changes of accelerations on equal intervals.

    The sum of the changes, the steepest slope, the largest change beside a smooth one, its place.
    """

    total: float
    slope: float
    most: float
    k: int

    @staticmethod
    def of(rises: Array, size: float) -> _Seen:
        """Judge the changes on intervals of a part of this size."""
        sizes = np.linalg.norm(rises, axis=1)
        # A slope and its change are those of smooth forces.
        change = np.median(np.diff(rises, axis=0), axis=0)
        rest = rises - np.arange(len(rises))[:, None] * change
        beside = np.linalg.norm(rest - np.median(rest, axis=0), axis=1)
        slope = float(sizes.max()) * len(rises) / size
        return _Seen(float(sizes.sum()), slope, float(beside.max()), int(np.argmax(beside)))

    @property
    def concentrated(self) -> bool:
        """Whether all changes happen within a small part of a step."""
        return self.total < _RESOLVED * self.slope
