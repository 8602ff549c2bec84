"""Runs with events to a tolerance: HHT-I3 and Radau at fixed steps that are halved.

Three runs of each integrator that meet the same events predict the cost of a tolerance. Runs of the
cheaper integrator continue until its bars are below the tolerance. A bar is the difference of the
last two runs if differences of three runs fall with the order of the integrator, else a multiple of
differences (`bars.unresolved`). Nothing is extrapolated, because numbers of steps of short phases
are not halved exactly. The two integrators must agree within the bars, since each could damp waves
that the other one resolves.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, cast, final

import numpy as np

from ancfdae.equations import MechanicalSystem, PlannedSystem
from ancfdae.equations.derived import design_sizes
from ancfdae.equations.event_solution import EventSolution
from ancfdae.errors.kinds import InvalidInputError, ToleranceWarning
from ancfdae.events.calls import EventRun, states_of
from ancfdae.events.kinds import Mode
from ancfdae.events.objectives import at_times
from ancfdae.integrators.hht.method import HHT
from ancfdae.integrators.integrator import Integrator
from ancfdae.integrators.radau.method import Radau
from ancfdae.model.design import DesignVariable
from ancfdae.numerics.arrays import Array
from ancfdae.numerics.timing import stopwatch
from ancfdae.sensitivity.method import Gradient, GradientMethod, Trial, UnfinishedRunError
from ancfdae.sensitivity.objectives import Objective
from ancfdae.sensitivity.observables.observable import Observable
from ancfdae.studies.accuracy.bars import Estimate, falls, ratio, spread, unresolved
from ancfdae.studies.accuracy.search import (
    Found,
    ObservableEstimates,
    asked_for,
    estimates_of,
    norms,
    paired_norms,
    require_tolerance,
    with_bars,
)
from ancfdae.studies.events import gradients, reached

# Most work of a search, about as many microseconds; work of a step of HHT-I3 without coordinates
# and for each of them, of a step of a system that runs in Python, and of a step of Radau over it.
_MOST, _OF_A_STEP, _OF_A_COORDINATE, _IN_PYTHON, _OF_RADAU = 4e7, 4.0, 0.7, 1300.0, 8.0
# Number of runs of one integrator that are compared.
_COMPARED = 3
# Fraction of the tolerance at which runs aim; most bars by which two integrators may differ.
_AIM, _CONTRADICTS = 0.7, 3.0


class _Taken(NamedTuple):
    """A run: its number of steps without events, the wanted vectors, its events, and the result."""

    integrator: Integrator
    intended: int
    vectors: list[Array]
    happened: tuple[str, ...]
    result: object


class _Task(NamedTuple):
    """The task of a search: a run with any integrator, its wanted vectors, and their sizes."""

    run: EventRun
    measure: Callable[[EventRun], tuple[list[Array], EventSolution, object]]
    sizes: Callable[[Sequence[Array]], Sequence[float]]
    along: bool

    def relative(self, parts: Sequence[Array], of: Sequence[Array]) -> float:
        """Return the largest norm of vectors `parts`, relative to the sizes of vectors `of`."""
        pairs = zip(norms(parts), self.sizes(of), strict=True)
        return max((ratio(x, size) for x, size in pairs), default=0.0)


@final
class _Halvings:
    """Runs of one integrator, each with twice the steps of the run before."""

    def __init__(
        self, name: str, at: Callable[[float], Integrator], order: int, first: int, price: float
    ) -> None:
        self.name, self._at, self._order, self._price = name, at, order, price
        self.count, self.runs, self.taken, self.ordered = first, 0, list[_Taken](), False
        self.estimates, self.error = list[Estimate](), math.inf

    @property
    def work(self) -> float:
        """Estimated work of the next run, microseconds."""
        return self.count * self._price

    def setting(self, t_end: float) -> Integrator:
        """Return the integrator of the next run."""
        return self._at(t_end / self.count)

    def left(self, tolerance: float) -> float:
        """Estimated work of all runs up to one that reaches the tolerance, microseconds."""
        missing = _COMPARED - len(self.taken)
        if missing <= 0:
            order = self._order if self.ordered else 1
            missing = max(math.ceil(math.log2(self.error / (_AIM * tolerance)) / order), 1)
        return self.work * (2.0**missing - 1)

    def take(self, task: _Task) -> Trial:
        """Make and judge the next run; earlier runs with other events are discarded."""
        run, clock = replace(task.run, integrator=self.setting(task.run.t_end)), stopwatch()
        steps, count = 0, self.count
        self.count, self.runs = 2 * count, self.runs + 1
        try:
            vectors, solution, result = task.measure(run)
        except UnfinishedRunError:
            self.taken = []
        else:
            happened = tuple(f"{x.name}, {x.mode}" for x in solution.events)
            same = [each for each in self.taken if each.happened == happened]
            self.taken = [*same, _Taken(run.integrator, count, vectors, happened, result)]
            steps = sum(phase.statistics.steps for phase in solution.phases)
        self._judge(task)
        return Trial(run.integrator, steps, clock(), self.error)

    def _judge(self, task: _Task) -> None:
        """Estimate errors from the last three runs."""
        self.estimates, self.error, last = [], math.inf, self.taken[-_COMPARED:]
        if len(last) < _COMPARED:
            return
        counts, self.ordered = [each.intended for each in last], True
        for runs in zip(*(each.vectors for each in last), strict=True):
            d = np.diff(runs, axis=0)
            ordered = falls(np.linalg.norm(d, axis=1), counts, self._order)
            self.ordered = self.ordered and ordered
            bar = spread(d[-1], task.along) if ordered else unresolved(d, task.along)
            self.estimates.append(Estimate(runs[-1], bar))
        x, bars = ([each[k] for each in self.estimates] for k in (0, 1))
        self.error = task.relative(bars, x)

    def agrees(self, other: _Halvings, task: _Task) -> bool:
        """Return whether gaps to the estimates of `other` are at most three times the summed bars.

        Also true if many runs of `other` gave no estimates.
        """
        if not other.estimates:
            return other.runs >= 2 * _COMPARED
        x = [estimate.x for estimate in self.estimates]
        gaps = [own - estimate.x for own, estimate in zip(x, other.estimates, strict=True)]
        return task.relative(gaps, x) <= _CONTRADICTS * (other.error + self.error)

    @property
    def words(self) -> str:
        """A sentence that says from which runs the bars follow."""
        counts = ", ".join(str(each.intended) for each in self.taken[-_COMPARED:])
        how = "fall with its order" if self.ordered else "have no order, which bars allow for"
        return f"{self.name}: differences of runs with {counts} steps and the same events {how}"


def _search(task: _Task, tolerance: float) -> Found:
    """Run both integrators until one reaches the tolerance; warn if that is out of reach."""
    system = task.run.system
    compiled = isinstance(system, PlannedSystem)
    price = _OF_A_STEP + _OF_A_COORDINATE * system.n_q if compiled else _IN_PYTHON
    kinds = [
        _Halvings("HHT", lambda step: HHT(step, hht_alpha=-0.05), 2, 64, price),
        _Halvings("Radau", Radau, 5, 16, _OF_RADAU * price),
    ]
    trials, work = list[Trial](), 0.0
    while True:
        best, other = sorted(kinds, key=lambda kind: kind.error)
        within = best.error <= tolerance
        if within and best.agrees(other, task):
            break
        going = [kind for kind in kinds if work + kind.work <= _MOST]
        if within and other in going and not other.estimates:
            going = [other]
        if not going:
            within = False
            break
        kind = min(going, key=lambda each: each.left(tolerance))
        work += kind.work
        trials.append(kind.take(task))
    if not best.estimates:
        rule = "must be within reach: no three runs of HHT or Radau met the same events"
        got, repair = f"{len(trials)} runs", "Choose an integrator and a shorter t_end."
        raise InvalidInputError("tolerance", rule, got, repair)
    finest = best.taken[-1]
    why = f"{best.words}. {'' if within else 'The work of a search is used up.'}".rstrip()
    if not within:
        warnings.warn(f"tolerance {tolerance:g}: {why}", ToleranceWarning, stacklevel=5)
    return Found(best.estimates, finest.result, within, finest.integrator, why, tuple(trials))


def event_gradients_within(
    model: tuple[MechanicalSystem, float, object, Mapping[str, Mode] | None],
    objectives: Sequence[Objective],
    tolerance: float,
    design: tuple[Sequence[str | DesignVariable] | None, bool],
    method: GradientMethod | None,
    progress: bool,
) -> list[Gradient]:
    """Return values and gradients of a run with events with bars below the tolerance.

    `model` are the system, the end time, events and modes; `design` the variables, and whether the
    end time is one of them.
    """
    require_tolerance(tolerance)
    system, t_end, events, modes = model
    first = HHT(t_end / 64, hht_alpha=-0.05)
    run = EventRun.of(system, t_end, first, events, modes, design[0], progress, design[1])
    scale = np.append(design_sizes(system), [t_end] * design[1])

    def measure(run: EventRun) -> tuple[list[Array], EventSolution, object]:
        results = gradients(run, objectives, method)
        vectors = [x for each in results for x in (np.array([each.value]), each.gradient * scale)]
        return vectors, cast("EventSolution", results[0].event_solution), results

    found = _search(_Task(run, measure, paired_norms, False), tolerance)
    return with_bars(found, scale, tolerance)


def events_observed_within(
    model: tuple[MechanicalSystem, float, object, Mapping[str, Mode] | None],
    observables: Sequence[Observable] | None,
    at: Sequence[float] | Array | None,
    tolerance: float,
    progress: bool,
) -> ObservableEstimates:
    """Return observables of a run with events with bars below the tolerance, or the best."""
    require_tolerance(tolerance)
    system, t_end, events, modes = model
    run = EventRun.of(system, t_end, HHT(t_end / 64), events, modes, None, progress)
    wanted, times = asked_for(observables, at, system, t_end)

    def measure(run: EventRun) -> tuple[list[Array], EventSolution, object]:
        phased = run.phased()
        done, states = reached(phased), states_of(phased)
        return [at_times(x, states, times) for x in wanted], done, done

    found = _search(_Task(run, measure, norms, True), tolerance)
    return estimates_of(found, tolerance, times)
